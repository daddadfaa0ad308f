"""Decomposition of a phase function into a narrow peak and a wide rest.

p(µ) = (1 − f) p_wide(µ) + f p_narrow(µ),   f p_narrow = max(p − base, 0)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline, inline_only
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import sample_azimuth, uniform
from splits.kernels.math.vectors import direction_around
from splits.kernels.optics.phase_function import (
    HENYEY_GREENSTEIN,
    TABLE,
    PhaseFunction,
    evaluate_phase_function,
    make_tabulated,
    sample_scattering_cosine,
)

PEAK_THRESHOLD_PER_SR = 20.0
"""Largest phase function (1/sr) without a peak: that of Henyey & Greenstein exceeds it for
g > 0.91."""
PEAK_BASE_PER_SR = 1.0
"""Phase function (1/sr) above which it belongs to the peak."""


class PhaseFunctionPeak(NamedTuple):
    """Narrow part of a phase function.

    Attributes
    ----------
    phase : PhaseFunction
        What is sampled: the peak alone for a table, otherwise the whole phase function.
    base : float
        Phase function (1/sr) above which it belongs to the peak.
    fraction : float
        Fraction of the scattered light in the peak, between 0 and 1.
    """

    phase: PhaseFunction
    base: float
    fraction: float


def separate_peak(phase: PhaseFunction) -> PhaseFunctionPeak | None:
    """Return the part of a phase function above `PEAK_BASE_PER_SR`.

    Returns
    -------
    PhaseFunctionPeak or None
        None if the phase function nowhere exceeds `PEAK_THRESHOLD_PER_SR`.
    """
    base, g = PEAK_BASE_PER_SR, abs(phase.g)
    if phase.kind == HENYEY_GREENSTEIN:
        highest = (1.0 + g) / (4.0 * math.pi * (1.0 - g) ** 2)
        if highest > PEAK_THRESHOLD_PER_SR:
            return PhaseFunctionPeak(phase, base, _integrate_above_base(g, base))
    elif phase.kind == TABLE and phase.density.max() > PEAK_THRESHOLD_PER_SR:
        excess, fraction = _subtract_base(phase, base)
        return PhaseFunctionPeak(excess, base, fraction)
    return None


def _integrate_above_base(g: float, base: float) -> float:
    """Return the light in a Henyey-Greenstein phase function above a base, for positive g."""
    near = 1.0 - g
    # p = (1 − g²)/(4π s³) with s² = 1 + g² − 2 g |µ|.
    squared = ((1.0 - g**2) / (4.0 * math.pi * base)) ** (2.0 / 3.0)
    width = min((squared - near**2) / (2.0 * g), 2.0)
    s = math.sqrt(near**2 + 2.0 * g * width)
    return (1.0 - g**2) / (2.0 * g) * (1.0 / near - 1.0 / s) - 2.0 * math.pi * base * width


def _subtract_base(phase: PhaseFunction, base: float) -> tuple[PhaseFunction, float]:
    """Return the part of a table above a base, normalized, and the light in it."""
    cosines, above = phase.cosines, phase.density - base
    left, right = above[:-1], above[1:]
    crossing = left * right < 0.0
    position = left[crossing] / (left - right)[crossing]
    crossing_cosines = (1.0 - position) * cosines[:-1][crossing] + position * cosines[1:][crossing]
    nodes = np.union1d(cosines, crossing_cosines)
    excess = np.maximum(np.interp(nodes, cosines, above), 0.0)
    excess[np.isin(nodes, crossing_cosines)] = 0.0
    fraction = 2.0 * math.pi * np.trapezoid(excess, nodes)
    return make_tabulated(nodes, excess), float(fraction)


@inline_only
def compute_wide_fraction(peak, phase, mu):
    """Return the wide part of a phase function at a cosine as a fraction of the whole."""
    return min(1.0, peak.base / max(evaluate_phase_function(phase, mu), peak.base))


@inline
def sample_peak_cosine(state, peak):
    """Sample the cosine of the scattering angle in the peak, by rejection from a whole function."""
    mu = sample_scattering_cosine(state, peak.phase)
    if peak.phase.kind == TABLE:
        return mu
    density = evaluate_phase_function(peak.phase, mu)
    while uniform(state) * density >= density - peak.base:
        mu = sample_scattering_cosine(state, peak.phase)
        density = evaluate_phase_function(peak.phase, mu)
    return mu


@inline_only
def sample_peak_direction(state, peak, d):
    """Sample the direction into which light along d is scattered in the peak."""
    mu = sample_peak_cosine(state, peak)
    c, s = sample_azimuth(state)
    return direction_around(d, Angle(mu, math.sqrt((1.0 - mu) * (1.0 + mu))), Angle(c, s))
