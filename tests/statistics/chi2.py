"""How tests draw samples from kernels and how they judge families of comparisons.

A family of comparisons fails when its worst member is less likely than 1 % for the family as a
whole (Šidák): one comparison among n may then have p as low as 1 − 0.99^(1/n).
"""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba import njit
from scipy import stats

from splits.transport.rng import start_stream

SIGNIFICANCE = 0.01
NEEDS_JIT = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow without compiled kernels")
SEED = 20_240_611


CELLS = np.arange(1, 53) / 53
TAILS = np.array([1e-4, 5e-4, 2e-3])
EDGES = np.concatenate([TAILS, CELLS, 1.0 - TAILS[::-1]])
"""Cells of a probability, finer in both tails."""


def evenly(u):
    """Return the cumulative probability of numbers that are uniform."""
    return u


def scaled(count: int) -> int:
    """Return a sample size: `count`, or a fiftieth of it where kernels run as plain Python."""
    return max(count // 50, 1000) if numba.config.DISABLE_JIT else count


@njit
def _fill_scalar(sampler, state, args, out):
    for i in range(out.size):
        out[i] = sampler(state, *args)


@njit
def _fill_tuple(sampler, state, args, out):
    for i in range(out.shape[0]):
        values = sampler(state, *args)
        for j in range(out.shape[1]):
            out[i, j] = values[j]


def stream(ray: int = 0) -> np.ndarray:
    """Return the state at the beginning of a random stream."""
    state = np.zeros(1, dtype=np.uint64)
    start_stream(state, SEED, 0, ray)
    return state


def draw(sampler, count: int, *args, width: int = 0, ray: int = 0) -> np.ndarray:
    """Return `count` values (or tuples of `width` values) of ``sampler(state, *args)``."""
    if width == 0:
        out = np.empty(count)
        _fill_scalar(sampler, stream(ray), args, out)
    else:
        out = np.empty((count, width))
        _fill_tuple(sampler, stream(ray), args, out)
    return out


def p_of_counts(counts, probabilities) -> float:
    """Return the chi-square p-value of counts in cells of known probability.

    Cells where fewer than ten counts are expected are pooled; a cell of probability 0 must be
    empty.
    """
    counts = np.asarray(counts, dtype=float).ravel()
    probabilities = np.asarray(probabilities, dtype=float).ravel()
    assert abs(probabilities.sum() - 1.0) < 1e-6
    if counts[probabilities <= 0.0].any():
        return 0.0
    expected = counts.sum() * probabilities
    small = expected < 10.0
    if small.any():
        counts = np.append(counts[~small], counts[small].sum())
        expected = np.append(expected[~small], expected[small].sum())
        if expected[-1] < 5.0:
            order = np.argsort(expected[:-1])[0]
            counts[order] += counts[-1]
            expected[order] += expected[-1]
            counts, expected = counts[:-1], expected[:-1]
    return float(stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), counts.size - 1))


def p_of_values(values, cdf, edges=53) -> float:
    """Return the chi-square p-value of a sample against a continuous distribution.

    `edges` are probabilities between cells, or the number of cells of equal probability.
    """
    u = np.asarray(cdf(np.asarray(values)), dtype=float)
    if np.isscalar(edges):
        edges = np.arange(1, edges) / edges
    edges = np.concatenate([[0.0], edges, [1.0]])
    counts, _ = np.histogram(u, edges)
    assert counts.sum() == u.size
    return p_of_counts(counts, np.diff(edges))


def tabulated_cdf(density, low: float, high: float, points: int = 20_001):
    """Return the cumulative of a density on [low, high] by the trapezoidal rule."""
    x = np.linspace(low, high, points)
    y = density(x)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))])
    cumulative /= cumulative[-1]
    return lambda value: np.interp(value, x, cumulative)


def judge_p(p_values: dict) -> None:
    """Fail if the smallest p-value of a family is below Šidák's bound."""
    bound = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / len(p_values))
    worst = min(p_values, key=p_values.get)
    report = f"{len(p_values)} chi-square tests, smallest p {p_values[worst]:.3g} at {worst}"
    print(report)
    assert p_values[worst] >= bound, f"{report}; bound {bound:.3g}; all: {p_values}"


def judge_z(z, label: str = "") -> None:
    """Fail if the largest |z| of a family exceeds Šidák's bound; report the rms."""
    z = np.asarray(z, dtype=float)
    flat = z.ravel()
    bound = stats.norm.isf(0.5 * (1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / flat.size)))
    worst = np.unravel_index(np.argmax(np.abs(z)), z.shape)
    report = (
        f"{label} {flat.size} comparisons: rms z {np.sqrt((flat**2).mean()):.2f}, "
        f"worst z {z[worst]:+.2f} at {tuple(int(i) for i in worst)}, bound {bound:.2f}"
    )
    print(report)
    assert np.isfinite(flat).all() and np.abs(flat).max() <= bound, report
