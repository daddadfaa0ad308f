"""Derivatives to parameters that change the paths: finite differences with common random numbers.

Two media that differ a little are sampled by almost the same paths, so that noise mostly cancels
(common random numbers; Glasserman & Yao 1992, Management Science 38, 884-908).  Four runs around
the value, or on one side where a range ends, leave an error of the fourth or third order of the
step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from splits.core.validation import InvalidValue, invalid
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.simulation.interpolation_bounds import bound_derivative_error
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate

FIRST_STEP_FRACTION = 0.25
"""First step relative to the value: larger steps have less noise, but more truncation error."""
MIN_FIRST_STEP = {INCIDENCE_KEY: 4.0, **dict.fromkeys(
    ("facetness", "sphericity", "roundness", "saturation", "liquid_water_content", "asymmetry",
     "ground", "bottom_albedo", "hematite_ratio"), 0.04,
), "single_scattering_albedo": 0.004}  # fmt: skip
"""Smallest first steps of parameters with a natural scale."""
FIRST_STEP_AT_ZERO = 0.01
"""First step of any other parameter where the value is 0."""
MAX_HALVINGS = 10
SQUARE_ROOT_ENDPOINTS = {
    "saturation": 0.0,
    "liquid_water_content": 0.0,
    "single_scattering_albedo": 1.0,
}
"""Ends of ranges near which reflectance depends on the square root of the distance: of the water in
narrow pores, of absorption.  Differences are taken in that root."""
MIN_CONVERGENCE_RATIO = 1.2
"""Smallest ratio of successive changes, as the step is halved, of a derivative that converges."""
STENCIL_OFFSETS = tuple(
    tuple(place + shift for place in (-2.0, -1.0, 1.0, 2.0))
    for shift in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0)
)
"""Stencil points in steps: around the value, or increasingly one-sided where a range ends."""

MediumEstimator = Callable[[Medium, float | str], SpectralEstimate]


def compute_finite_difference(
    estimator: MediumEstimator, medium: Medium, incidence: float | str, parameter: str
) -> tuple[Derivatives, int]:
    """Return derivatives with respect to a parameter, and the number of rays traced for them.

    The step is halved until the truncation error of the stencil is smaller than noise.  For
    one-sided stencils the error estimate of a single stencil is not sufficient, as reflectance may
    be singular within any step; the change of the derivative with the step is then included.

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
        Where no valid medium lies near this one, or reflectance has a square-root singularity here.
    """
    value = float(incidence) if parameter == INCIDENCE_KEY else get_parameter(medium, parameter)
    coordinate = _Coordinate.for_parameter(parameter, value)
    first_step = coordinate.choose_first_step(parameter)
    estimates: dict[float, SpectralEstimate] = {}
    best: Derivatives | None = None
    one_sided: list[Derivatives] = []
    last_error = invalid(parameter, value, "inside its range")
    for halving in range(MAX_HALVINGS + 1):
        step = first_step * 0.5**halving
        try:
            offsets, inputs = _make_stencil(medium, incidence, parameter, coordinate, step)
        except InvalidValue as error:
            last_error = error
            continue
        for x, perturbed in inputs.items():
            if x not in estimates:
                estimates[x] = estimator(*perturbed)
        derivatives = _differentiate(offsets, step, [estimates[x] for x in inputs])
        if sum(offsets) != 0.0:
            one_sided.append(derivatives)
            best = derivatives = _bound_step_error(one_sided)
            is_estimated = len(one_sided) > 1
        else:
            # One-sided stencils are compared by their errors only where there is no other.
            is_better = (
                best is None or one_sided or (derivatives.stderr**2).sum() < (best.stderr**2).sum()
            )
            best = derivatives if is_better else best
            one_sided, is_estimated = [], True
        if is_estimated and (derivatives.bias_bound**2).sum() < 0.5 * (derivatives.stderr**2).sum():
            break
    if best is None:
        raise last_error
    _check_convergence(parameter, value, best, one_sided)
    n_rays = sum(one.rays["rays"] for one in estimates.values())
    return coordinate.to_value_derivatives(best), n_rays


def _check_convergence(
    parameter: str, value: float, derivatives: Derivatives, one_sided_derivatives: list[Derivatives]
) -> None:
    """Check that a derivative does not grow each time the step is halved."""
    if len(one_sided_derivatives) < 3:
        return
    sizes = [float(np.sqrt((one.mean**2).sum())) for one in one_sided_derivatives[-3:]]
    noise = float(np.sqrt((derivatives.batch_deviations**2).sum()))
    if (
        min(sizes[1] / sizes[0], sizes[2] / sizes[1]) > MIN_CONVERGENCE_RATIO
        and sizes[2] - sizes[0] > 4.0 * noise
    ):
        hint = "reflectance has a square-root singularity there: choose a nearby value"
        raise invalid(f"jacobian ({parameter})", value, "where the derivative is finite", hint)


class _Coordinate(NamedTuple):
    """Coordinate in which differences are taken: the value, or the root of a distance.

    Attributes
    ----------
    start : float
        Coordinate of the value.
    endpoint : float
        Value from which the root counts.
    sign : float
        Direction from the endpoint; 0 where the coordinate is the value itself.
    """

    start: float
    endpoint: float
    sign: float

    @classmethod
    def for_parameter(cls, parameter: str, value: float) -> _Coordinate:
        """Return the coordinate for a parameter; at the endpoint it is the value itself."""
        keyword = parameter.rpartition(".")[2]
        endpoint = SQUARE_ROOT_ENDPOINTS.get(keyword)
        if endpoint is None or value == endpoint:
            return cls(value, 0.0, 0.0)
        return cls(abs(value - endpoint) ** 0.5, endpoint, 1.0 if endpoint == 0.0 else -1.0)

    def choose_first_step(self, parameter: str) -> float:
        """Return the first step of the coordinate."""
        keyword = parameter.rpartition(".")[2]
        size = self.start**2 if self.sign else abs(self.start)
        step = max(
            FIRST_STEP_FRACTION * size,
            MIN_FIRST_STEP.get(keyword, 0.0 if size else FIRST_STEP_AT_ZERO),
        )
        return float((size + step) ** 0.5 - self.start if self.sign else step)

    def to_value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return self.endpoint + self.sign * coordinate**2 if self.sign else coordinate

    def to_value_derivatives(self, derivatives: Derivatives) -> Derivatives:
        """Convert derivatives with respect to the coordinate to those with respect to the value."""
        rate = 1.0 / (2.0 * self.sign * self.start) if self.sign else 1.0
        return Derivatives(
            rate * derivatives.mean,
            rate * derivatives.batch_deviations,
            abs(rate) * derivatives.bias_bound,
        )


def _make_stencil(
    medium: Medium, incidence: float | str, parameter: str, coordinate: _Coordinate, step: float
) -> tuple[tuple[float, ...], dict[float, tuple[Medium, float | str]]]:
    """Return stencil points in steps, and the medium and incidence at each coordinate.

    Raises
    ------
    ValueError
        If no stencil is within the range of the parameter.
    """
    last_error = invalid(parameter, coordinate.to_value(coordinate.start), "inside its range")
    for offsets in STENCIL_OFFSETS:
        points = [coordinate.start + offset * step for offset in offsets]
        if coordinate.sign and min(points) < 0.0:
            continue
        values = map(coordinate.to_value, points)
        try:
            inputs = [_perturb_input(medium, incidence, parameter, value) for value in values]
        except InvalidValue as error:
            last_error = error
        else:
            return offsets, dict(zip(points, inputs, strict=True))
    raise last_error


def _perturb_input(
    medium: Medium, incidence: float | str, parameter: str, value: float
) -> tuple[Medium, float | str]:
    """Return the medium and the incidence for a value of a parameter, after checking it."""
    if parameter != INCIDENCE_KEY:
        return replace_parameter(medium, parameter, value), incidence
    if not 0.0 <= value < 90.0:
        raise invalid(INCIDENCE_KEY, value, "0 to below 90 degrees")
    return medium, value


def _differentiate(
    offsets: tuple[float, ...], step: float, estimates: Sequence[SpectralEstimate]
) -> Derivatives:
    """Return derivatives from runs at stencil points."""
    means = np.stack([one.mean[:2] for one in estimates])
    batch_deviations = np.stack([one.batch_deviations for one in estimates])
    fine, coarse = _compute_stencil_weights(offsets, step)
    mean, coarse_mean = (np.tensordot(weights, means, 1) for weights in (fine, coarse))
    noise = (np.tensordot(fine - coarse, batch_deviations, 1) ** 2).sum(axis=0)
    # The error of the lower-order rule, above noise, is proportional to the step squared; that of
    # the higher-order rule to its fourth power, or the third where the stencil is not symmetric.
    coarse_error = np.sqrt(np.maximum((coarse_mean - mean) ** 2 - noise, 0.0))
    size = np.abs(mean)
    relative_error = np.divide(coarse_error, size, out=np.ones_like(coarse_error), where=size > 0.0)
    is_symmetric = sum(offsets) == 0.0
    truncation_error = coarse_error * (relative_error if is_symmetric else np.sqrt(relative_error))
    # With truncation, the error of the theory is added.
    bounds = [np.maximum(one.interpolation_error[:2], one.interpolation_bound) for one in estimates]
    interpolation_error = bound_derivative_error(np.max(bounds, axis=0), mean)
    error_bound = np.hypot(np.minimum(truncation_error, coarse_error), interpolation_error)
    return Derivatives(
        mean[:, None], np.tensordot(fine, batch_deviations, 1)[:, :, None], error_bound[:, None]
    )


def _bound_step_error(one_sided_derivatives: Sequence[Derivatives]) -> Derivatives:
    """Return the last derivatives, with an error bound from their change with the step.

    If each halving changes them by 1/r of the previous change, the remaining error is 1/(r − 1) of
    the last one.
    """
    last = one_sided_derivatives[-1]
    if len(one_sided_derivatives) < 2:
        return last
    changes = [float(np.sqrt(((b.mean - a.mean) ** 2).sum()))
             for a, b in pairwise(one_sided_derivatives[-3:])]  # fmt: skip
    ratio = changes[0] / max(changes[-1], 1e-300) if len(changes) > 1 else 2.0
    factor = 1.0 / (min(max(ratio, MIN_CONVERGENCE_RATIO), 8.0) - 1.0)
    error_bound = factor * np.abs(last.mean - one_sided_derivatives[-2].mean)
    return last._replace(bias_bound=np.maximum(last.bias_bound, error_bound))


def _compute_stencil_weights(
    offsets: tuple[float, ...], step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the highest-order rule, and those of one of lower order."""
    points = np.array(offsets, dtype=float)
    fine = compute_difference_weights(points) / step
    coarse = np.zeros_like(fine)
    subset = [0, 3] if points.sum() == 0.0 else np.argsort(np.abs(points), kind="stable")[:3]
    coarse[subset] = compute_difference_weights(points[subset]) / step
    return fine, coarse


def compute_difference_weights(positions: np.ndarray) -> np.ndarray:
    """Return the weights whose sum is the derivative at 0 of the interpolating polynomial."""
    powers = np.vander(positions, increasing=True).T
    return np.linalg.solve(powers, np.eye(len(positions))[1])
