"""Decomposition of a phase function into a narrow peak and a wide rest.

    p(µ) = (1 − f) p_wide(µ) + f p_narrow(µ),   f p_narrow = max(p − limit, 0)

The sum is exact for any narrow part that nowhere exceeds p.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline_only
from splits.kernels.optics.phase_function import (
    HENYEY_GREENSTEIN,
    RAYLEIGH,
    PhaseFunction,
    evaluate_phase_function,
    make_tabulated,
)

PEAK_THRESHOLD_PER_SR = 20.0
"""Largest phase function (1/sr) without a peak: that of Henyey & Greenstein exceeds it for
g > 0.91."""
PEAK_BASE_PER_SR = 1.0
"""Phase function (1/sr) above which it belongs to the peak."""
N_PEAK_NODES = 64
"""Table nodes of the peak of a Henyey-Greenstein phase function."""


class PhaseFunctionPeak(NamedTuple):
    """Narrow part of a phase function.

    Attributes
    ----------
    phase : PhaseFunction
        Normalized, tabulated.
    fraction : float
        Fraction of the scattered light in the peak, between 0 and 1.
    """

    phase: PhaseFunction
    fraction: float


def separate_peak(phase: PhaseFunction) -> PhaseFunctionPeak | None:
    """Return the part of a phase function above `PEAK_BASE_PER_SR`.

    Returns
    -------
    PhaseFunctionPeak or None
        None if the phase function nowhere exceeds `PEAK_THRESHOLD_PER_SR`.
    """
    cosines, density = phase.cosines, phase.density
    if phase.kind == HENYEY_GREENSTEIN:
        cosines, density = _tabulate_peak(phase.g)
    if phase.kind == RAYLEIGH or density.max() <= PEAK_THRESHOLD_PER_SR:
        return None
    above = density - PEAK_BASE_PER_SR
    left, right = above[:-1], above[1:]
    crossing = left * right < 0.0
    position = left[crossing] / (left - right)[crossing]
    crossing_cosines = (1.0 - position) * cosines[:-1][crossing] + position * cosines[1:][crossing]
    nodes = np.union1d(cosines, crossing_cosines)
    excess = np.maximum(np.interp(nodes, cosines, above), 0.0)
    excess[np.isin(nodes, crossing_cosines)] = 0.0
    fraction = 2.0 * math.pi * np.trapezoid(excess, nodes)
    return PhaseFunctionPeak(make_tabulated(nodes, excess, phase.max_polarization), float(fraction))


def _tabulate_peak(g: float) -> tuple[np.ndarray, np.ndarray]:
    """Return cosines and Henyey-Greenstein densities, dense above `PEAK_BASE_PER_SR`."""
    near = 1.0 - abs(g)
    highest = (1.0 + abs(g)) / (4.0 * math.pi * near**2)
    if highest <= PEAK_BASE_PER_SR:
        return np.array([-1.0, 1.0]), np.full(2, highest)
    # p = highest (1 + 2 |g| (1 − |µ|)/near²)^(−3/2), from the peak outwards.
    density = np.geomspace(highest, PEAK_BASE_PER_SR, N_PEAK_NODES)
    one_minus_cosine = near**2 * ((highest / density) ** (2.0 / 3.0) - 1.0) / (2.0 * abs(g))
    cosines = np.append(-1.0, 1.0 - one_minus_cosine[::-1])
    density = np.append(density[-1], density[::-1])
    return (cosines, density) if g > 0.0 else (-cosines[::-1], density[::-1])


@inline_only
def compute_wide_fraction(peak, phase, mu):
    """Return the wide part of a phase function at a cosine as a fraction of the whole."""
    narrow = evaluate_phase_function(peak.phase, mu)
    return (
        1.0 if narrow == 0.0 else 1.0 - peak.fraction * narrow / evaluate_phase_function(phase, mu)
    )
