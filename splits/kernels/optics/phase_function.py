"""Phase functions and polarization of single scattering by small particles.

The phase function p(µ), µ = cosΘ the cosine of the scattering angle, is a density over directions:
2π ∫ p dµ = 1.  The scattering matrix of the normalized Stokes vector, with the scattering plane as
reference (`stokes.py`), is that of Rayleigh with a weaker polarization:

    m12/m11 = m21/m11 = −P (1 − µ²)/(1 + µ²)        m22/m11 = 1
    m33/m11 = m44/m11 = 2µ/(1 + µ²)                  m34 = m43 = 0

P = 1 with Rayleigh's phase function is Rayleigh scattering.  With any other phase function the
elements are a model and not a solution of Maxwell's equations: they give particles a Rayleigh-like
polarization as measured in sea water (Voss & Fry 1984, Appl.  Opt. 23, 4427), without the effect of
nonspherical particles on m22.  A matrix of this form maps every physical Stokes vector to a
physical one if m12² + m33² ≤ m11², that is P² (1 − µ²)² + 4µ² ≤ (1 + µ²)², which holds for P ≤ 1.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.compiler.jit import TINY, inline
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import sample_azimuth, uniform
from splits.kernels.math.vectors import direction_around

HENYEY_GREENSTEIN = 0
RAYLEIGH = 1
TABLE = 2

_ISOTROPIC_PER_SR = 0.25 / math.pi
_THIRD = 1.0 / 3.0


class PhaseFunction(NamedTuple):
    """Phase function and polarization of single scattering.

    Attributes
    ----------
    kind : int
        `HENYEY_GREENSTEIN`, `RAYLEIGH` or `TABLE`.
    g : float
        Mean cosine; the parameter of Henyey and Greenstein, in (−1, 1).
    max_polarization : float
        P in [0, 1]: the degree of linear polarization of unpolarized light scattered by 90
        degrees, the maximum over angles.
    cosines : float64[m]
        Nodes of a table, rising from −1 to 1; unused otherwise.
    density : float64[m]
        Phase function at the cosines (1/sr), linear in µ between them.
    cdf : float64[m]
        Probability of a smaller cosine, from 0 to 1.
    """

    kind: int
    g: float
    max_polarization: float
    cosines: np.ndarray
    density: np.ndarray
    cdf: np.ndarray


class PolarizationRatios(NamedTuple):
    """Ratios m12/m11 and m33/m11 = m44/m11 of the scattering matrix, see the module."""

    m12: float
    m33: float


def _make_analytic(kind: int, g: float, max_polarization: float) -> PhaseFunction:
    ends = np.array([-1.0, 1.0])
    isotropic = np.full(2, _ISOTROPIC_PER_SR)
    return PhaseFunction(
        kind, float(g), float(max_polarization), ends, isotropic, np.array([0.0, 1.0])
    )


def make_henyey_greenstein(g: float, max_polarization: float = 0.0) -> PhaseFunction:
    """Return the phase function of Henyey & Greenstein (1941, Astrophys. J. 93, 70)."""
    return _make_analytic(HENYEY_GREENSTEIN, g, max_polarization)


def make_rayleigh(max_polarization: float = 1.0) -> PhaseFunction:
    """Return Rayleigh's phase function."""
    return _make_analytic(RAYLEIGH, 0.0, max_polarization)


def make_tabulated(cosines: Any, values: Any, max_polarization: float = 0.0) -> PhaseFunction:
    """Return a phase function that is linear in µ between given values.

    Parameters
    ----------
    cosines : array_like
        Distinct numbers, in any order, including −1 and 1.
    values : array_like
        Phase function there, nonnegative, in any unit: it is normalized.
    max_polarization : float, optional
        See `PhaseFunction`.
    """
    order = np.argsort(np.asarray(cosines, dtype=float))
    mu = np.asarray(cosines, dtype=float)[order]
    y = np.asarray(values, dtype=float)[order]
    low, high, width = mu[:-1], mu[1:], np.diff(mu)
    cumulative = np.append(0.0, np.cumsum(0.5 * width * (y[:-1] + y[1:])))
    total = cumulative[-1]
    # ∫ µ y dµ over an interval, exact for y linear in µ.
    moments = width * ((2.0 * low + high) * y[:-1] + (low + 2.0 * high) * y[1:]) / 6.0
    g = float(moments.sum() / total)
    density = y / (2.0 * math.pi * total)
    return PhaseFunction(TABLE, g, float(max_polarization), mu, density, cumulative / total)


@inline
def _find_interval(nodes, x):
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
    i = _find_interval(cdf, u)
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
        return rayleigh_quantile(u)
    return table_quantile(phase.cosines, phase.density, phase.cdf, u)


@inline
def evaluate_phase_function(phase, mu):
    """Return the phase function at a cosine in [−1, 1], per steradian."""
    if phase.kind == HENYEY_GREENSTEIN:
        g = phase.g
        # 1 + g² − 2gµ as a sum of positive terms for either sign of g.
        near = 1.0 - abs(g)
        square = near * near + 2.0 * abs(g) * (1.0 - math.copysign(1.0, g) * mu)
        return _ISOTROPIC_PER_SR * (1.0 - g) * (1.0 + g) / (square * math.sqrt(square))
    if phase.kind == RAYLEIGH:
        return 0.75 * _ISOTROPIC_PER_SR * (1.0 + mu * mu)
    i = _find_interval(phase.cosines, mu)
    s = (mu - phase.cosines[i]) / (phase.cosines[i + 1] - phase.cosines[i])
    return (1.0 - s) * phase.density[i] + s * phase.density[i + 1]


@inline
def evaluate_polarization_ratios(phase, mu):
    """Return the `PolarizationRatios` at a cosine."""
    square = mu * mu
    per = 1.0 / (1.0 + square)
    return PolarizationRatios(
        -phase.max_polarization * (1.0 - mu) * (1.0 + mu) * per, 2.0 * mu * per
    )


@inline
def sample_phase_function(state, phase, d):
    """Sample the direction into which unpolarized light along d is scattered."""
    mu = sample_scattering_cosine(state, phase)
    c, s = sample_azimuth(state)
    return direction_around(d, Angle(mu, math.sqrt((1.0 - mu) * (1.0 + mu))), Angle(c, s))
