"""Size and shape statistics of prolate grains: attenuation, and distributions of hit grains.

The number of collisions per metre of a straight ray follows from the sizes and shapes present.
Grains that are hit are sampled from densities weighted by cross-section, so that both describe the
same medium (SPLITS section 4.3.3, SPLITSnow appendix A).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss

from splits.kernels.scene import make_table_probabilities

N_TABLE_POINTS = 1025
"""Number of probabilities at which quantile functions are tabulated."""

_PROBABILITIES = make_table_probabilities(N_TABLE_POINTS)
_N_PANELS = 128
_GAUSS_NODES, _GAUSS_WEIGHTS = (
    0.5 * (x + offset) for x, offset in zip(leggauss(12), (1.0, 0.0), strict=True)
)
"""Gauss-Legendre nodes and weights on (0, 1)."""
_TAIL_SIGMA = 9.0
"""Cutoff in standard deviations; the tails of a normal distribution hold less than 1e-18."""


def integrate_with_quantiles(
    density: Callable[[np.ndarray], np.ndarray],
    low: float,
    high: float,
    probability: np.ndarray | None = None,
) -> tuple[float, np.ndarray]:
    """Return ∫ density over [low, high] and its quantiles, nearly to machine precision.

    The integral is a Gauss-Legendre quadrature in panels.  Each quantile is found by Newton's
    method on the integral from the edge of its panel, without interpolation.

    Parameters
    ----------
    density : callable
        Positive, and smooth on the scale of a panel, 1/128 of the range; need not be normalized.
    low, high : float
        Limits of integration.
    probability : array_like, optional
        Probabilities of the quantiles, in [0, 1].
    """
    edges = np.linspace(low, high, _N_PANELS + 1)
    width = np.diff(edges)

    def mass(start: np.ndarray, length: np.ndarray) -> np.ndarray:
        return length * (
            density(start[:, np.newaxis] + length[:, np.newaxis] * _GAUSS_NODES) @ _GAUSS_WEIGHTS
        )

    def ratio(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)

    cumulative = np.concatenate([[0.0], np.cumsum(mass(edges[:-1], width))])
    total = float(cumulative[-1])
    u = np.atleast_1d(np.asarray([] if probability is None else probability, dtype=float))
    panel = np.clip(np.searchsorted(cumulative, total * u, side="right") - 1, 0, _N_PANELS - 1)
    target = total * u - cumulative[panel]
    start, width = edges[panel], width[panel]
    x = ratio(target, mass(start, width))
    for _ in range(10):
        residual = target - mass(start, x * width)
        x = np.clip(x + ratio(residual, width * density(start + x * width)), 0.0, 1.0)
    x = start + x * width
    return total, np.where(u <= 0.0, low, np.where(u >= 1.0, high, x))


def surface_to_volume_ratio(sphericity: np.ndarray | float) -> np.ndarray:
    """Return A(Ψ), the ratio of surface area to volume of a prolate spheroid of major axis 1.

    SPLITSnow Eq A.9 (SPLITS Eq 14): 3 (1 + asin(x)/(Ψ² x)) with x = √(1 − Ψ⁴); 6 for a sphere.

    Parameters
    ----------
    sphericity : array_like
        Inscribed-circle sphericity Ψ in (0, 1].
    """
    psi2 = np.square(np.asarray(sphericity, dtype=float))
    x2 = (1.0 - psi2) * (1.0 + psi2)
    x = np.sqrt(x2)
    # For nearly spherical grains asin(x)/x loses digits, and it is undefined at 0.
    safe = np.where(x2 < 1e-6, 1.0, x)
    ratio = np.where(x2 < 1e-6, 1.0 + x2 / 6.0 + 3.0 * x2**2 / 40.0, np.arcsin(safe) / safe)
    return 3.0 * (1.0 + ratio / psi2)


def compute_size_attenuation(smallest: float, largest: float) -> float:
    """Return K1 (1/m) for major axes uniform between two lengths (m).

    SPLITSnow Eqs A.6-A.7 with the sign of the logarithm corrected,
    K1 = (1/s_min − 1/s_max) / ln(s_max/s_min), written without cancellation; 1/s for one size.
    """
    r = np.log1p((largest - smallest) / smallest)
    return float(1.0 / smallest if r == 0.0 else -np.expm1(-r) / (r * smallest))


@cache
def compute_shape_attenuation(minimum: float, maximum: float, mean: float, sd: float) -> float:
    """Return K2, the mean of A(Ψ)/4 for a truncated normal sphericity (SPLITSnow Eq A.8)."""
    if sd == 0.0 or minimum == maximum:
        return float(surface_to_volume_ratio(minimum if minimum == maximum else mean)) / 4.0
    weighted, _ = _integrate_normal(surface_to_volume_ratio, minimum, maximum, mean, sd)
    norm, _ = _integrate_normal(np.ones_like, minimum, maximum, mean, sd)
    return weighted / norm / 4.0


def tabulate_hit_inverse_sizes(smallest: float, largest: float, weighting: str) -> np.ndarray:
    """Return the quantile function of the inverse major axis of hit grains (1/m).

    Parameters
    ----------
    smallest, largest : float
        Limits of the uniform distribution P(s) (m).
    weighting : {"cross_section", "uniform"}
        Density ∝ s⁻² P(s) (SPLITS Eq 25), or P(s) itself.

    Returns
    -------
    numpy.ndarray, shape (N_TABLE_POINTS,)
        Increasing, from 1/largest to 1/smallest.
    """
    if weighting == "uniform":
        return 1.0 / (largest - _PROBABILITIES * (largest - smallest))
    return 1.0 / largest + _PROBABILITIES * (1.0 / smallest - 1.0 / largest)


@cache
def tabulate_hit_sphericities(minimum: float, maximum: float, mean: float, sd: float) -> np.ndarray:
    """Return the quantile function of the sphericity of hit grains (SPLITS Eq 26).

    Density ∝ A(Ψ) times the normal density within [minimum, maximum].
    """
    return _tabulate_normal(surface_to_volume_ratio, minimum, maximum, mean, sd)


@cache
def tabulate_truncated_normal(minimum: float, maximum: float, mean: float, sd: float) -> np.ndarray:
    """Return the quantile function of a normal distribution truncated to [minimum, maximum]."""
    return _tabulate_normal(np.ones_like, minimum, maximum, mean, sd)


def _tabulate_normal(
    weight: Callable[[np.ndarray], np.ndarray],
    minimum: float,
    maximum: float,
    mean: float,
    sd: float,
) -> np.ndarray:
    """Return the quantile function of a weight times the truncated normal density."""
    if sd == 0.0 or minimum == maximum:
        return np.full(N_TABLE_POINTS, minimum if minimum == maximum else mean)
    _, score = _integrate_normal(weight, minimum, maximum, mean, sd, _PROBABILITIES)
    return np.clip(mean + sd * score, minimum, maximum)


def _integrate_normal(
    weight: Callable[[np.ndarray], np.ndarray],
    minimum: float,
    maximum: float,
    mean: float,
    sd: float,
    probability: np.ndarray | None = None,
) -> tuple[float, np.ndarray]:
    """Return the integral and the quantiles of a weight times the truncated normal density.

    They are those over the standard score.  In its units the quadrature resolves the peak however
    narrow it is between the limits; negligible tails are cut off.
    """

    def density(score: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * score**2) * weight(np.clip(mean + sd * score, minimum, maximum))

    with np.errstate(over="ignore"):
        low, high = np.divide([minimum - mean, maximum - mean], sd)
    limits = max(float(low), -_TAIL_SIGMA), min(float(high), _TAIL_SIGMA)
    return integrate_with_quantiles(density, *limits, probability)
