"""Wave-number distributions of rough surfaces and their correlations of heights."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.kernels.math.rng import make_table_probabilities
from splits.kernels.rough_surface import realization as kernels

N_QUANTILES = 4097
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)


class HeightSpectrum(NamedTuple):
    """Distribution of wave numbers, in units of k0.

    Attributes
    ----------
    kernel_code : int
        Code of the distribution in the kernels.
    cdf : callable
        Cumulative distribution function of λ.
    density : callable
        Probability density of λ.
    mean_square : callable
        Mean of λ² below a band limit.
    correlation : callable
        Correlation of heights at a distance, without a band limit.
    """

    kernel_code: int
    cdf: Callable[[float], float]
    density: Callable[[np.ndarray], np.ndarray]
    mean_square: Callable[[float], float]
    correlation: Callable[[np.ndarray], np.ndarray]


def _correlate_exponential_printed(r: np.ndarray) -> np.ndarray:
    """Return ∫ J0(λr) (1 + λ²)^(−3/2) dλ = x (I0(x) K1(x) − I1(x) K0(x)) with x = r/2."""
    from scipy.special import i0e, i1e, k0e, k1e

    x = np.where(r > 0.0, 0.5 * r, 1.0)
    products = i0e(x) * k1e(x) - i1e(x) * k0e(x)
    return np.where(r > 0.0, x * products, 1.0)


def _exponential_cdf(limit: float) -> float:
    """Return 1 − 1/√(1 + λ²) without cancellation."""
    root = math.hypot(1.0, limit)
    return 1.0 if math.isinf(limit) else limit / root * (limit / (1.0 + root))


def _gaussian_mean_square(limit: float) -> float:
    if math.isinf(limit):
        return 4.0
    e = 0.25 * limit * limit
    band_fraction = -math.expm1(-e)
    return 4.0 * (1.0 - e * math.exp(-e) / band_fraction)


HEIGHT_SPECTRA = {
    "exponential": HeightSpectrum(
        kernels.EXPONENTIAL,
        _exponential_cdf,
        lambda k: k * (1.0 + k * k) ** -1.5,
        lambda limit: math.hypot(1.0, limit) - 1.0,
        lambda r: np.exp(-r),
    ),
    "exponential_printed": HeightSpectrum(
        kernels.EXPONENTIAL_AS_PRINTED,
        lambda limit: 1.0 if math.isinf(limit) else limit / math.hypot(1.0, limit),
        lambda k: (1.0 + k * k) ** -1.5,
        lambda limit: math.asinh(limit) * math.hypot(1.0 / limit, 1.0) - 1.0,
        _correlate_exponential_printed,
    ),
    "gaussian": HeightSpectrum(
        kernels.GAUSSIAN,
        lambda limit: -math.expm1(-0.25 * limit * limit),
        lambda k: 0.5 * k * np.exp(-0.25 * k * k),
        _gaussian_mean_square,
        lambda r: np.exp(-r * r),
    ),
}
CORRELATIONS = (*HEIGHT_SPECTRA, "spectrum")


def compute_quantiles(wave_number: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Return the quantile function of the density p(λ) λ, with p linear between nodes."""
    slope = np.diff(density) / np.diff(wave_number)

    def mass(interval: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Return ∫ p λ dλ from the start of an interval, exact for linear p."""
        step = upper - wave_number[interval]
        p, a = density[interval], wave_number[interval]
        return step * (
            p * a + step * (0.5 * (p + slope[interval] * a) + step * slope[interval] / 3.0)
        )

    intervals = np.arange(wave_number.size - 1)
    cumulative = np.concatenate([[0.0], np.cumsum(mass(intervals, wave_number[1:]))])
    target = make_table_probabilities(N_QUANTILES) * cumulative[-1]
    # Intervals without mass hold no quantiles except those at 0 and 1.
    interval = np.clip(
        np.searchsorted(cumulative, target, side="left") - 1, 0, wave_number.size - 2
    )
    first = np.flatnonzero(np.diff(cumulative) > 0.0)[0]
    interval = np.maximum(interval, first)
    low, high = wave_number[interval], wave_number[interval + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = cumulative[interval] + mass(interval, middle) < target
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def average_over_quantiles(
    table: np.ndarray, function: Callable[[np.ndarray], np.ndarray], pieces: int = 1
) -> float:
    """Return the mean of a function of a variate given by a piecewise linear quantile table."""
    n_intervals = (table.size - 1) * pieces
    x = (np.arange(n_intervals)[:, None] + 0.5 * (1.0 + _GAUSS_NODES)) / n_intervals
    # Includes the derivative of the probabilities of `make_table_probabilities`.
    weight = 2.0 * np.minimum(x, 1.0 - x) * _GAUSS_WEIGHTS / n_intervals
    nodes = np.linspace(0.0, 1.0, table.size)
    return float((weight * function(np.interp(x, nodes, table))).sum())


def average_bessel_j0(table: np.ndarray, distance: float) -> float:
    """Return the mean of J0(λ r), in intervals shorter than a period."""
    from scipy.special import j0

    max_spacing = float(np.diff(table).max())
    return average_over_quantiles(
        table, lambda k: j0(k * distance), 1 + int(max_spacing * distance / math.pi)
    )


def integrate_bessel_j0(
    density: Callable[[np.ndarray], np.ndarray], limit: float, distance: float
) -> float:
    """Return ∫ J0(λr) density dλ from 0 to the limit, in intervals shorter than a period."""
    from scipy.special import j0

    octaves = 2.0 ** np.arange(-3.0, max(math.log2(limit), -2.0) + 1.0)
    edges = [
        np.array([0.0]),
        octaves,
        np.arange(0.0, limit, 2.0 * math.pi / max(distance, 1e-300))[1:],
    ]
    edge = np.unique(np.minimum(np.concatenate([*edges, [limit]]), limit))
    half = 0.5 * np.diff(edge)[:, None]
    k = edge[:-1, None] + half * (1.0 + _GAUSS_NODES)
    return float((half * _GAUSS_WEIGHTS * j0(k * distance) * density(k)).sum())
