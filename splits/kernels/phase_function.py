"""Sampling and evaluation of phase functions and scattering matrices of small particles.

`splits.kernels.scattering_matrix` defines them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.arithmetic import Angle, direction_around
from splits.kernels.compiler.jit import TINY, inline, inline_only
from splits.kernels.rng import sample_azimuth, uniform
from splits.kernels.scattering_matrix import (
    HENYEY_GREENSTEIN,
    ISOTROPIC_PER_SR,
    M12,
    M22,
    M33,
    M34,
    M44,
    RAYLEIGH,
    TABLE,
    PhaseFunction,
    ScatteringRatios,
    make_tabulated,
)

_THIRD = 1.0 / 3.0
_FOUR_THIRDS = 4.0 / 3.0


@inline
def find_interval(nodes, x):
    """Return the index i of the interval of nodes that contains x, nodes[i] ≤ x, or 0."""
    low = 0
    high = nodes.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= x:
            low = middle
        else:
            high = middle
    return low


@inline
def henyey_greenstein_quantile(g, u):
    """Return the quantile u of the cosine of Henyey & Greenstein.

    With t = 2u − 1, µ = [t + g (3 + t²)/2 + g² t + g³ (t² − 1)/2]/(1 + g t)², which is Witt 1977
    (Astrophys.  J.  Suppl. 35, 1) with g divided out.  Written for 1 − µ, the sums have positive
    terms only: no digit is lost at g = 0 or near ±1.
    """
    v = 1.0 - u
    a = (1.0 - g) * v
    b = (1.0 + g) * u
    per = 1.0 / (a + b)
    return max(1.0 - 2.0 * (1.0 - g) * (a * per) * ((v + b) * per), -1.0)


@inline
def rayleigh_quantile(u):
    """Return the quantile u of the cosine of Rayleigh's phase function.

    µ³ + 3µ = 8u − 4 by Cardano, from the larger of the two cube roots, whose product is 1.
    """
    b = 4.0 * u - 2.0
    w = (abs(b) + math.sqrt(b * b + 1.0)) ** _THIRD
    return math.copysign(min(w - 1.0 / w, 1.0), b)


@inline
def table_quantile(cosines, density, cdf, u):
    """Return the quantile u of the cosine of a tabulated phase function.

    A fraction v of the probability of an interval lies within the fraction s of its width,
    v (y₀ + y₁) = 2 y₀ s + (y₁ − y₀) s²; the root in [0, 1] is written without differences.
    """
    i = find_interval(cdf, u)
    v = (u - cdf[i]) / (cdf[i + 1] - cdf[i])
    y0, y1 = density[i], density[i + 1]
    root = math.sqrt((1.0 - v) * y0 * y0 + v * y1 * y1)
    s = min(v * (y0 + y1) / max(y0 + root, TINY), 1.0)
    return (1.0 - s) * cosines[i] + s * cosines[i + 1]


@inline
def sample_scattering_cosine(state, phase):
    """Sample the cosine of the scattering angle."""
    u = uniform(state)
    if phase.kind == HENYEY_GREENSTEIN:
        return henyey_greenstein_quantile(phase.g, u)
    if phase.kind == RAYLEIGH:
        fraction = phase.dipole_fraction
        if u < fraction:
            return rayleigh_quantile(u / fraction)
        return 2.0 * (u - fraction) / (1.0 - fraction) - 1.0
    return table_quantile(phase.cosines, phase.density, phase.cdf, u)


@inline
def evaluate_phase_function(phase, mu):
    """Return the phase function at a cosine in [−1, 1], per steradian."""
    if phase.kind == HENYEY_GREENSTEIN:
        g = phase.g
        # 1 + g² − 2gµ as a sum of positive terms for either sign of g.
        near = 1.0 - abs(g)
        square = near * near + 2.0 * abs(g) * (1.0 - math.copysign(1.0, g) * mu)
        return ISOTROPIC_PER_SR * (1.0 - g) * (1.0 + g) / (square * math.sqrt(square))
    if phase.kind == RAYLEIGH:
        fraction = phase.dipole_fraction
        dipole = 0.75 * ISOTROPIC_PER_SR * (1.0 + mu * mu)
        return fraction * dipole + (1.0 - fraction) * ISOTROPIC_PER_SR
    i = find_interval(phase.cosines, mu)
    s = (mu - phase.cosines[i]) / (phase.cosines[i + 1] - phase.cosines[i])
    return (1.0 - s) * phase.density[i] + s * phase.density[i + 1]


@inline
def evaluate_scattering_ratios(phase, mu):
    """Return the `ScatteringRatios` at a cosine."""
    if phase.kind == TABLE:
        i = find_interval(phase.cosines, mu)
        s = (mu - phase.cosines[i]) / (phase.cosines[i + 1] - phase.cosines[i])
        below, above = (1.0 - s), s
        density = below * phase.density[i] + above * phase.density[i + 1]
        if density <= 0.0:
            return ScatteringRatios(0.0, 0.0, 0.0, 0.0, 0.0)
        below, above = below / density, above / density
        low, high = phase.elements[i], phase.elements[i + 1]
        return ScatteringRatios(
            below * low[M12] + above * high[M12],
            below * low[M22] + above * high[M22],
            below * low[M33] + above * high[M33],
            below * low[M34] + above * high[M34],
            below * low[M44] + above * high[M44],
        )
    fraction = phase.dipole_fraction
    unpolarized = _FOUR_THIRDS * (1.0 - fraction)
    per = 1.0 / (fraction * (1.0 + mu * mu) + unpolarized)
    m33 = 2.0 * fraction * mu * per
    return ScatteringRatios(
        -fraction * (1.0 - mu) * (1.0 + mu) * per,
        1.0 - unpolarized * per,
        m33,
        0.0,
        phase.circular_ratio * m33,
    )


@inline
def sample_phase_function(state, phase, d):
    """Sample the direction into which unpolarized light along d is scattered."""
    mu = sample_scattering_cosine(state, phase)
    c, s = sample_azimuth(state)
    return direction_around(d, Angle(mu, math.sqrt((1.0 - mu) * (1.0 + mu))), Angle(c, s))


# --------------------------------------------------------------------------------------------------
# Decomposition of a phase function into a narrow peak and a wide rest.
#
# p(µ) = (1 − f) p_wide(µ) + f p_narrow(µ),   f p_narrow = max(p − base, 0)

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
