"""Size and shape statistics of prolate grains: attenuation, and what rays strike.

The number of grains that a straight ray meets per metre follows from the sizes and shapes
present; the grains that it strikes are drawn from densities weighted by cross-section, so that
both belong to one and the same medium (SPLITS section 4.3.3, SPLITSnow appendix A).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy import integrate, stats

from splits.transport.rng import table_probabilities

TABLE_POINTS = 1025
"""Probabilities at which quantile functions are tabulated."""

_PROBABILITIES = table_probabilities(TABLE_POINTS)
_GAUSS_LEGENDRE = np.polynomial.legendre.leggauss(200)


def surface_to_volume(sphericity: np.ndarray | float) -> np.ndarray:
    """Return A(Ψ), surface area over volume of a prolate spheroid of major axis 1.

    SPLITSnow Eq A.9 (SPLITS Eq 14): 3 (1 + asin(x)/(Ψ² x)) with x = √(1 − Ψ⁴); 6 for a sphere.

    Parameters
    ----------
    sphericity : array_like
        Inscribed-circle sphericity Ψ in (0, 1].
    """
    psi2 = np.square(np.asarray(sphericity, dtype=float))
    x2 = (1.0 - psi2) * (1.0 + psi2)
    x = np.sqrt(x2)
    # asin(x)/x loses its digits, and at 0 its value, for nearly spherical grains.
    safe = np.where(x2 < 1e-6, 1.0, x)
    ratio = np.where(x2 < 1e-6, 1.0 + x2 / 6.0 + 3.0 * x2**2 / 40.0, np.arcsin(safe) / safe)
    return 3.0 * (1.0 + ratio / psi2)


def size_attenuation(smallest: float, largest: float) -> float:
    """Return K1 in 1/m for major axes uniform between two lengths in m.

    SPLITSnow Eqs A.6-A.7 with the sign of the logarithm corrected,
    K1 = (1/s_min − 1/s_max) / ln(s_max/s_min), written without cancellation; 1/s for one size.
    """
    r = np.log1p((largest - smallest) / smallest)
    return float(1.0 / smallest if r == 0.0 else -np.expm1(-r) / (r * smallest))


@cache
def shape_attenuation(minimum: float, maximum: float, mean: float, sd: float) -> float:
    """Return K2 for a sphericity normal within limits: the mean of A(Ψ)/4 (SPLITSnow Eq A.8)."""
    if sd == 0.0 or minimum == maximum:
        return float(surface_to_volume(_fixed(minimum, maximum, mean))) / 4.0
    # Over the normal's probability, not over Ψ: no peak is too narrow to be seen.
    x, w = _GAUSS_LEGENDRE
    psi = _truncated(minimum, maximum, mean, sd).ppf(0.5 * (x + 1.0))
    return float(0.5 * w @ surface_to_volume(psi)) / 4.0


def struck_inverse_sizes(smallest: float, largest: float, weighting: str) -> np.ndarray:
    """Return the quantile function of the inverse major axis of struck grains (1/m).

    Parameters
    ----------
    smallest, largest : float
        Limits of the uniform distribution P(s), in m.
    weighting : {"attenuation", "uniform"}
        Density ∝ s⁻² P(s) (SPLITS Eq 25), or P(s) itself.

    Returns
    -------
    numpy.ndarray, shape (TABLE_POINTS,)
        Increasing, from 1/largest to 1/smallest.
    """
    if weighting == "uniform":
        return 1.0 / (largest - _PROBABILITIES * (largest - smallest))
    return 1.0 / largest + _PROBABILITIES * (1.0 / smallest - 1.0 / largest)


@cache
def struck_sphericities(minimum: float, maximum: float, mean: float, sd: float) -> np.ndarray:
    """Return the quantile function of the sphericity of struck grains (SPLITS Eq 26).

    Density ∝ A(Ψ) times the normal density within [minimum, maximum].
    """
    if sd == 0.0 or minimum == maximum:
        return np.full(TABLE_POINTS, _fixed(minimum, maximum, mean))
    normal = _truncated(minimum, maximum, mean, sd)
    # Integrate A(Ψ) over the normal's probability, not over Ψ: a narrow peak between far limits
    # is then as well resolved as a wide one.
    u = table_probabilities(64 * (TABLE_POINTS - 1) + 1)
    psi = normal.ppf(u)
    cumulative = integrate.cumulative_trapezoid(surface_to_volume(psi), u, initial=0.0)
    return np.interp(_PROBABILITIES, cumulative / cumulative[-1], psi)


@cache
def truncated_normal(minimum: float, maximum: float, mean: float, sd: float) -> np.ndarray:
    """Return the quantile function of a normal distribution within [minimum, maximum]."""
    if sd == 0.0 or minimum == maximum:
        return np.full(TABLE_POINTS, _fixed(minimum, maximum, mean))
    return _truncated(minimum, maximum, mean, sd).ppf(_PROBABILITIES)


def _fixed(minimum: float, maximum: float, mean: float) -> float:
    return minimum if minimum == maximum else mean


def _truncated(minimum: float, maximum: float, mean: float, sd: float):
    return stats.truncnorm((minimum - mean) / sd, (maximum - mean) / sd, loc=mean, scale=sd)
