"""Derivatives to what changes the paths: differences of runs that share their random numbers.

Two media that differ a little are met by almost the same paths, so that noise mostly cancels
(common random numbers; Glasserman & Yao 1992, Management Science 38, 884-908).  Four runs around
the value, or on one side where a range ends, leave an error of the fourth or third order of the
step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splits.checks import refuse
from splits.instruments.estimators import Estimate
from splits.instruments.shared_paths import Slopes
from splits.media.parameters import INCIDENCE, value_of, with_value
from splits.media.turbid import Medium

STEP = 0.25
"""First step, as a part of the value: noise falls with the step, until the rule is off by more."""
LEAST_STEP = {INCIDENCE: 4.0, **dict.fromkeys(
    ("facetness", "sphericity", "roundness", "saturation", "liquid_water_content", "asymmetry",
     "ground", "bottom_albedo", "hematite_ratio"), 0.04,
), "single_scattering_albedo": 0.004}  # fmt: skip
"""Least first steps, of what has a scale of its own."""
FROM_ONE = ("single_scattering_albedo",)
"""What counts from 1: near 1 reflectance goes as the root of what is absorbed, 1 − ω."""
AT_ZERO = 0.01
"""First step of any other where the value is 0."""
HALVINGS = 10
OFFSETS = tuple(
    tuple(place + shift for place in (-2.0, -1.0, 1.0, 2.0))
    for shift in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0)
)
"""Places of runs in steps: around the value, or more and more on one side where a range ends."""

Measure = Callable[[Medium, float | str], Estimate]


class Differences(NamedTuple):
    """Derivatives of reflected and transmitted shares to one parameter.

    Attributes
    ----------
    parameter : str
    slopes : Slopes
    rays : int
        That they took.
    """

    parameter: str
    slopes: Slopes
    rays: int


def difference(
    measure: Measure, medium: Medium, incidence: float | str, parameter: str
) -> Differences:
    """Return derivatives to a parameter.

    The step is halved until the rule is off by less than noise is.  Where a range ends, what a rule
    says of itself is not enough, as reflectance may bend there within any step: how far the value
    still moves with the step counts, too.

    Parameters
    ----------
    measure : callable
        Takes a medium and an incidence, returns an estimate from the same random numbers each time.
    medium : Medium
    incidence : float or "diffuse"
    parameter : str

    Raises
    ------
    ValueError
        Where no medium near this one can be.
    """
    at_beam = parameter == INCIDENCE
    value = float(incidence) if at_beam else value_of(medium, parameter)
    own = parameter.rpartition(".")[2]
    size = 1.0 - value if own in FROM_ONE else abs(value)
    step = max(STEP * size, LEAST_STEP.get(own, 0.0 if size else AT_ZERO))
    known: dict[float, Estimate] = {}
    best: Slopes | None = None
    before: Slopes | None = None
    for _ in range(HALVINGS + 1):
        points = _points(medium, incidence, parameter, value, step)
        if isinstance(points, ValueError):
            refusal = points
        else:
            for x, scene in points.scenes.items():
                if x not in known:
                    known[x] = measure(*scene)
            slopes = _slopes(points.offsets, step, [known[x] for x in points.scenes])
            one_sided = sum(points.offsets) != 0.0
            settled = not one_sided
            if one_sided and before is not None:
                slopes = _moved_by(slopes, before)
                settled = True
            if best is None or one_sided or (slopes.stderr**2).sum() < (best.stderr**2).sum():
                best = slopes
            before = slopes
            if settled and (slopes.missed**2).sum() < 0.5 * (slopes.stderr**2).sum():
                break
        step *= 0.5
    if best is None:
        raise refusal
    return Differences(parameter, best, sum(one.rays for one in known.values()))


class _Points(NamedTuple):
    """Places of runs in steps, and the medium and incidence at each, by the parameter's value."""

    offsets: tuple[float, ...]
    scenes: dict[float, tuple[Medium, float | str]]


def _points(
    medium: Medium, incidence: float | str, parameter: str, value: float, step: float
) -> _Points | ValueError:
    """Return where to measure, or why that cannot be."""
    refusal = ValueError()
    for offsets in OFFSETS:
        values = [value + offset * step for offset in offsets]
        try:
            return _Points(offsets, {x: _scene(medium, incidence, parameter, x) for x in values})
        except ValueError as error:
            refusal = error
    return refusal


def _scene(
    medium: Medium, incidence: float | str, parameter: str, value: float
) -> tuple[Medium, float | str]:
    """Return the medium and the incidence where a parameter has a value, or refuse that."""
    if parameter != INCIDENCE:
        return with_value(medium, parameter, value), incidence
    if not 0.0 <= value < 90.0:
        raise refuse(INCIDENCE, value, "0 to below 90 degrees")
    return medium, value


def _slopes(offsets: tuple[float, ...], step: float, found: Sequence[Estimate]) -> Slopes:
    """Return derivatives from runs at places in steps."""
    means = np.stack([one.mean[:2] for one in found])
    groups = np.stack([one.groups for one in found])
    fine, coarse = _rules(offsets, step)
    mean, plain = (np.tensordot(rule, means, 1) for rule in (fine, coarse))
    noise = (np.tensordot(fine - coarse, groups, 1) ** 2).sum(axis=0)
    # What the plainer rule is off by, beyond noise, goes as the step squared.  What this one is off
    # by goes as its fourth power, or the third where the places are not even on both sides.
    off = np.sqrt(np.maximum((plain - mean) ** 2 - noise, 0.0))
    size = np.abs(mean)
    part = np.divide(off, size, out=np.ones_like(off), where=size > 0.0)
    rule = off * (part if sum(offsets) == 0.0 else np.sqrt(part))
    bias = np.clip(8.0 * np.max([one.bias[:2] for one in found], axis=0), 0.0, 1.0)
    missed = np.hypot(np.minimum(rule, off), bias * size)
    return Slopes(mean[:, None], np.tensordot(fine, groups, 1)[:, :, None], missed[:, None])


def _moved_by(slopes: Slopes, before: Slopes) -> Slopes:
    """Return derivatives with half of what they moved, beyond noise, in what they may miss."""
    noise = ((slopes.groups - before.groups) ** 2).sum(axis=0)
    moved = np.sqrt(np.maximum((slopes.mean - before.mean) ** 2 - noise, 0.0))
    return slopes._replace(missed=np.maximum(slopes.missed, 0.5 * moved))


def _rules(offsets: tuple[float, ...], step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the most exact rule, and those of one of lower order."""
    places = np.array(offsets, dtype=float)
    fine = _weights(places) / step
    coarse = np.zeros_like(fine)
    few = [0, 3] if places.sum() == 0.0 else np.argsort(np.abs(places), kind="stable")[:3]
    coarse[few] = _weights(places[few]) / step
    return fine, coarse


def _weights(places: np.ndarray) -> np.ndarray:
    """Return the weights whose sum is the derivative at 0 of the polynomial through places."""
    powers = np.vander(places, increasing=True).T
    wanted = np.zeros(len(places))
    wanted[1] = 1.0
    found: np.ndarray = np.linalg.solve(powers, wanted)
    return found
