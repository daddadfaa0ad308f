"""Derivatives to what changes the paths: differences of runs that share their random numbers.

Two media that differ a little are met by almost the same paths, so that noise mostly cancels
(common random numbers; Glasserman & Yao 1992, Management Science 38, 884-908).  Four runs around
the value, or on one side where a range ends, leave an error of the fourth or third order of the
step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.simulation.estimators import SpectralEstimate
from splits.simulation.path_tally import Derivatives

FIRST_STEP_FRACTION = 0.25
"""First step, as a part of the value: noise falls with the step, until the rule is off by more."""
MIN_FIRST_STEP = {INCIDENCE_KEY: 4.0, **dict.fromkeys(
    ("facetness", "sphericity", "roundness", "saturation", "liquid_water_content", "asymmetry",
     "ground", "bottom_albedo", "hematite_ratio"), 0.04,
), "single_scattering_albedo": 0.004}  # fmt: skip
"""Least first steps, of what has a scale of its own."""
FIRST_STEP_AT_ZERO = 0.01
"""First step of any other where the value is 0."""
MAX_HALVINGS = 10
SQUARE_ROOT_ENDPOINTS = {
    "saturation": 0.0,
    "liquid_water_content": 0.0,
    "single_scattering_albedo": 1.0,
}
"""Ends of ranges near which light goes as a root: of the water in narrow pores, of what absorbs.
Differences are taken in the root of the distance from there."""
MIN_CONVERGENCE_RATIO = 1.2
"""Ratio of two moves, as the step is halved, below which a derivative does not settle."""
STENCIL_OFFSETS = tuple(
    tuple(place + shift for place in (-2.0, -1.0, 1.0, 2.0))
    for shift in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0)
)
"""Places of runs in steps: around the value, or more and more on one side where a range ends."""

MediumEstimator = Callable[[Medium, float | str], SpectralEstimate]


class FiniteDifference(NamedTuple):
    """Derivatives of reflected and transmitted shares to one parameter.

    Attributes
    ----------
    parameter : str
    derivatives : Derivatives
    n_rays : int
        That they took.
    """

    parameter: str
    derivatives: Derivatives
    n_rays: int


def compute_finite_difference(
    estimator: MediumEstimator, medium: Medium, incidence: float | str, parameter: str
) -> FiniteDifference:
    """Return derivatives to a parameter.

    The step is halved until the rule is off by less than noise is.  Where a range ends, what a rule
    says of itself is not enough, as reflectance may bend there within any step: how far the value
    still moves with the step counts, too.

    Parameters
    ----------
    estimator : callable
        Takes a medium and an incidence, returns an estimate from the same random numbers each time.
    medium : Medium
    incidence : float or "diffuse"
    parameter : str

    Raises
    ------
    ValueError
        Where no medium near this one can be, or reflectance goes as a root from this value on.
    """
    value = float(incidence) if parameter == INCIDENCE_KEY else get_parameter(medium, parameter)
    way = _Coordinate.for_parameter(parameter, value)
    step = way.choose_first_step(parameter)
    known: dict[float, SpectralEstimate] = {}
    best: Derivatives | None = None
    one_sided: list[Derivatives] = []
    refusal = ValueError()
    for _ in range(MAX_HALVINGS + 1):
        points = _make_stencil(medium, incidence, parameter, way, step)
        step *= 0.5
        if isinstance(points, ValueError):
            refusal = points
            continue
        for x, scene in points.inputs.items():
            if x not in known:
                known[x] = estimator(*scene)
        slopes = _differentiate(points.offsets, 2.0 * step, [known[x] for x in points.inputs])
        if sum(points.offsets) != 0.0:
            one_sided.append(slopes)
            best = slopes = _bound_step_error(one_sided)
            settled = len(one_sided) > 1
        else:
            # Of one side there may be better only where there is nothing else.
            better = best is None or one_sided or (slopes.stderr**2).sum() < (best.stderr**2).sum()
            best = slopes if better else best
            one_sided, settled = [], True
        if settled and (slopes.bias_bound**2).sum() < 0.5 * (slopes.stderr**2).sum():
            break
    if best is None:
        raise refusal
    _check_convergence(parameter, value, best, one_sided)
    rays = sum(one.n_rays for one in known.values())
    return FiniteDifference(parameter, way.to_value_derivatives(best), rays)


def _check_convergence(
    parameter: str, value: float, derivatives: Derivatives, one_sided_derivatives: list[Derivatives]
) -> None:
    """Refuse a derivative that grows as often as the step is halved."""
    if len(one_sided_derivatives) < 3:
        return
    sizes = [float(np.sqrt((one.mean**2).sum())) for one in one_sided_derivatives[-3:]]
    noise = float(np.sqrt((derivatives.batch_deviations**2).sum()))
    if (
        min(sizes[1] / sizes[0], sizes[2] / sizes[1]) > MIN_CONVERGENCE_RATIO
        and sizes[2] - sizes[0] > 4.0 * noise
    ):
        hint = "light goes as a root there: ask for it a little away"
        raise invalid(f"jacobian ({parameter})", value, "where the derivative is finite", hint)


class _Coordinate(NamedTuple):
    """The coordinate in which differences are taken: the value, or a root from an end on.

    Attributes
    ----------
    start : float
        Coordinate of the value.
    endpoint : float
        Value from which the root counts.
    sign : float
        Of the way from there; 0 where the coordinate is the value itself.
    """

    start: float
    endpoint: float
    sign: float

    @classmethod
    def for_parameter(cls, parameter: str, value: float) -> _Coordinate:
        """Return the coordinate for a parameter; at the very end it is the value itself."""
        own = parameter.rpartition(".")[2]
        end = SQUARE_ROOT_ENDPOINTS.get(own)
        if end is None or value == end:
            return cls(value, 0.0, 0.0)
        return cls(abs(value - end) ** 0.5, end, 1.0 if end == 0.0 else -1.0)

    def choose_first_step(self, parameter: str) -> float:
        """Return the step of the coordinate to begin with."""
        own = parameter.rpartition(".")[2]
        size = self.start**2 if self.sign else abs(self.start)
        step = max(
            FIRST_STEP_FRACTION * size, MIN_FIRST_STEP.get(own, 0.0 if size else FIRST_STEP_AT_ZERO)
        )
        return float((size + step) ** 0.5 - self.start if self.sign else step)

    def to_value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return self.endpoint + self.sign * coordinate**2 if self.sign else coordinate

    def to_value_derivatives(self, derivatives: Derivatives) -> Derivatives:
        """Return derivatives to the value of those to the coordinate."""
        rate = 1.0 / (2.0 * self.sign * self.start) if self.sign else 1.0
        return Derivatives(
            rate * derivatives.mean,
            rate * derivatives.batch_deviations,
            abs(rate) * derivatives.bias_bound,
        )


class _Stencil(NamedTuple):
    """Places of runs in steps, and the medium and incidence at each coordinate."""

    offsets: tuple[float, ...]
    inputs: dict[float, tuple[Medium, float | str]]


def _make_stencil(
    medium: Medium, incidence: float | str, parameter: str, coordinate: _Coordinate, step: float
) -> _Stencil | ValueError:
    """Return where to measure, or why that cannot be."""
    refusal = ValueError()
    for offsets in STENCIL_OFFSETS:
        places = [coordinate.start + offset * step for offset in offsets]
        if coordinate.sign and min(places) < 0.0:
            continue
        try:
            return _Stencil(
                offsets,
                {
                    x: _perturb_input(medium, incidence, parameter, coordinate.to_value(x))
                    for x in places
                },
            )
        except ValueError as error:
            refusal = error
    return refusal


def _perturb_input(
    medium: Medium, incidence: float | str, parameter: str, value: float
) -> tuple[Medium, float | str]:
    """Return the medium and the incidence where a parameter has a value, or refuse that."""
    if parameter != INCIDENCE_KEY:
        return replace_parameter(medium, parameter, value), incidence
    if not 0.0 <= value < 90.0:
        raise invalid(INCIDENCE_KEY, value, "0 to below 90 degrees")
    return medium, value


def _differentiate(
    offsets: tuple[float, ...], step: float, estimates: Sequence[SpectralEstimate]
) -> Derivatives:
    """Return derivatives from runs at places in steps."""
    means = np.stack([one.mean[:2] for one in estimates])
    groups = np.stack([one.batch_deviations for one in estimates])
    fine, coarse = _compute_stencil_weights(offsets, step)
    mean, plain = (np.tensordot(rule, means, 1) for rule in (fine, coarse))
    noise = (np.tensordot(fine - coarse, groups, 1) ** 2).sum(axis=0)
    # What the plainer rule is off by, beyond noise, goes as the step squared.  What this one is off
    # by goes as its fourth power, or the third where the places are not even on both sides.
    off = np.sqrt(np.maximum((plain - mean) ** 2 - noise, 0.0))
    size = np.abs(mean)
    part = np.divide(off, size, out=np.ones_like(off), where=size > 0.0)
    rule = off * (part if sum(offsets) == 0.0 else np.sqrt(part))
    bias = np.clip(
        8.0 * np.max([one.interpolation_error[:2] for one in estimates], axis=0), 0.0, 1.0
    )
    missed = np.hypot(np.minimum(rule, off), bias * size)
    return Derivatives(mean[:, None], np.tensordot(fine, groups, 1)[:, :, None], missed[:, None])


def _bound_step_error(one_sided_derivatives: Sequence[Derivatives]) -> Derivatives:
    """Return the last of some derivatives, with what it may miss by how it moved with the step.

    Where each halving moves it by 1/r of the move before, it is off by 1/(r − 1) of the last one.
    """
    last = one_sided_derivatives[-1]
    if len(one_sided_derivatives) < 2:
        return last
    moves = [float(np.sqrt(((b.mean - a.mean) ** 2).sum()))
             for a, b in pairwise(one_sided_derivatives[-3:])]  # fmt: skip
    ratio = moves[0] / max(moves[-1], 1e-300) if len(moves) > 1 else 2.0
    part = 1.0 / (min(max(ratio, MIN_CONVERGENCE_RATIO), 8.0) - 1.0)
    moved = part * np.abs(last.mean - one_sided_derivatives[-2].mean)
    return last._replace(bias_bound=np.maximum(last.bias_bound, moved))


def _compute_stencil_weights(
    offsets: tuple[float, ...], step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the most exact rule, and those of one of lower order."""
    places = np.array(offsets, dtype=float)
    fine = _compute_difference_weights(places) / step
    coarse = np.zeros_like(fine)
    few = [0, 3] if places.sum() == 0.0 else np.argsort(np.abs(places), kind="stable")[:3]
    coarse[few] = _compute_difference_weights(places[few]) / step
    return fine, coarse


def _compute_difference_weights(positions: np.ndarray) -> np.ndarray:
    """Return the weights whose sum is the derivative at 0 of the polynomial through places."""
    powers = np.vander(positions, increasing=True).T
    wanted = np.zeros(len(positions))
    wanted[1] = 1.0
    found: np.ndarray = np.linalg.solve(powers, wanted)
    return found
