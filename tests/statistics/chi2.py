"""Samples from kernels, and significance tests of sets of comparisons.

A set of comparisons fails if its worst member has a probability below 1 % for the whole set
(Šidák): one of n comparisons may have p as low as 1 − 0.99^(1/n).  It also fails if the rms of its
z is outside the two-sided 99 % interval of χ²: stated errors may be neither too small nor too
large.  tests/statistics/test_significance.py measures the power of these tests.
"""

from functools import cache

import numba
import numpy as np
import pytest
from numba import njit
from scipy import stats

from splits.kernels.rng import start_stream

SIGNIFICANCE = 0.01
NEEDS_JIT = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="too slow without compiled kernels")
SEED = 20_240_611


BIN_PROBABILITIES = np.arange(1, 53) / 53
TAIL_PROBABILITIES = np.array([1e-4, 5e-4, 2e-3])
BIN_EDGES = np.concatenate([TAIL_PROBABILITIES, BIN_PROBABILITIES, 1.0 - TAIL_PROBABILITIES[::-1]])
"""Bin edges in probability, finer in both tails."""


def uniform_cdf(u):
    """Return the cumulative distribution of uniform numbers on [0, 1]."""
    return u


def scale_sample_size(count: int) -> int:
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


def start_random_stream(ray: int = 0) -> np.ndarray:
    """Return the state at the beginning of a random stream."""
    state = np.zeros(1, dtype=np.uint64)
    start_stream(state, SEED, 0, ray)
    return state


def draw_samples(sampler, count: int, *args, width: int = 0, ray: int = 0) -> np.ndarray:
    """Return `count` values (or tuples of `width` values) of ``sampler(state, *args)``."""
    sampler = getattr(sampler, "dispatcher", sampler)
    if width == 0:
        out = np.empty(count)
        _fill_scalar(sampler, start_random_stream(ray), args, out)
    else:
        out = np.empty((count, width))
        _fill_tuple(sampler, start_random_stream(ray), args, out)
    return out


def compute_p_of_counts(counts, probabilities) -> float:
    """Return the chi-square p-value of counts in bins of known probability.

    Bins with fewer than ten expected counts are pooled; a bin of probability 0 must be empty.
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


def compute_p_of_values(values, cdf, edges=53) -> float:
    """Return the chi-square p-value of a sample against a continuous distribution.

    `edges` are probabilities between bins, or the number of bins of equal probability.
    """
    u = np.asarray(cdf(np.asarray(values)), dtype=float)
    if np.isscalar(edges):
        edges = np.arange(1, edges) / edges
    edges = np.concatenate([[0.0], edges, [1.0]])
    counts, _ = np.histogram(u, edges)
    assert counts.sum() == u.size
    return compute_p_of_counts(counts, np.diff(edges))


def compute_p_of_unit_square(a, b, bins: int = 12) -> float:
    """Return the chi-square p-value of pairs that should be uniform on the unit square."""
    counts = np.histogram2d(a, b, bins=bins, range=((0, 1), (0, 1)))[0]
    assert counts.sum() == np.size(a)
    return compute_p_of_counts(counts, np.full(bins * bins, 1.0 / bins**2))


def tabulate_cdf(density, low: float, high: float, points: int = 20_001):
    """Return the cumulative distribution of a density on [low, high] by the trapezoidal rule."""
    x = np.linspace(low, high, points)
    y = density(x)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))])
    cumulative /= cumulative[-1]
    return lambda value: np.interp(value, x, cumulative)


def judge_p(p_values: dict) -> None:
    """Fail if the smallest p-value of a set is below Šidák's bound."""
    bound = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / len(p_values))
    worst = min(p_values, key=p_values.get)
    report = f"{len(p_values)} chi-square tests, smallest p {p_values[worst]:.3g} at {worst}"
    print(report)
    assert p_values[worst] >= bound, f"{report}; bound {bound:.3g}; all: {p_values}"


@cache
def compute_z_bound(count: int) -> float:
    """Return the |z| that the largest of `count` comparisons exceeds with a probability of 1 %."""
    return float(stats.norm.isf(0.5 * (1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / count))))


@cache
def compute_rms_limits(independent: int) -> tuple[float, float]:
    """Return the limits that contain the rms z of independent comparisons in 99 % of cases."""
    ends = np.array([0.5 * SIGNIFICANCE, 1.0 - 0.5 * SIGNIFICANCE])
    low, high = np.sqrt(stats.chi2.ppf(ends, independent) / independent)
    return float(low), float(high)


def judge_z(z, label: str = "", independent: int | None = None, bound_added: bool = False) -> None:
    """Fail if the largest |z| of a set, or its rms, has a probability below 1 %.

    Parameters
    ----------
    z : array_like
        Differences in units of their standard error.
    label : str
    independent : int, optional
        Number of independent comparisons, default: all of them.  The mean of z² of fully
        correlated comparisons scatters as that of one, so one per run is conservative where
        comparisons share paths; for Šidák's bound correlation is conservative.
    bound_added : bool
        Errors include the bound of a bias besides the statistical part (interpolation between
        refractive indices, truncation of an expansion), so that they are too large by design:
        only the upper limit applies.
    """
    z = np.asarray(z, dtype=float)
    flat = z.ravel()
    bound = compute_z_bound(flat.size)
    low, high = compute_rms_limits(independent or flat.size)
    low = 0.0 if bound_added else low
    rms = float(np.sqrt((flat**2).mean()))
    worst = np.unravel_index(np.argmax(np.abs(z)), z.shape)
    report = (
        f"{label}: {flat.size} comparisons, rms z {rms:.2f} (allowed {low:.2f} to {high:.2f}), "
        f"worst z {z[worst]:+.2f} at {tuple(int(i) for i in worst)}, bound {bound:.2f}"
    )
    print(report)
    assert np.isfinite(flat).all() and np.abs(flat).max() <= bound, report
    assert low <= rms <= high, report


def compare_results(one, other, *names: str) -> np.ndarray:
    """Return differences of quantities of two results in units of their common standard error.

    Values without an error are left out, but must be equal.
    """
    z = []
    for name in names:
        error = np.asarray(np.hypot(one[f"{name}_stderr"], other[f"{name}_stderr"]))
        difference = np.asarray(one[name] - other[name])
        is_exact = error == 0.0
        assert (np.abs(difference[is_exact]) < 1e-9).all(), (name, difference)
        z.append(difference[~is_exact] / error[~is_exact])
    return np.concatenate(z)


def compute_pooled_z(differences, errors, values=None) -> float:
    """Return the mean of differences, weighted by inverse variance, in units of its error.

    Parameters
    ----------
    differences, errors : array_like
        Independent differences and their standard errors.
    values : array_like, optional
        Reference values; if given, differences are relative to these.
    """
    d, s = np.ravel(differences), np.ravel(errors)
    v = np.ones_like(d) if values is None else np.ravel(values)
    # Relative differences d/v with errors s/v and weights (v/s)².
    return float((d * v / s**2).sum() / np.sqrt((v**2 / s**2).sum()))


def judge_scatter(samples, stated, label: str = "", bound_added: bool = False) -> float:
    """Fail if the scatter of repeated runs is above or below their stated errors, at 1 %.

    Return the root mean square of the scatter over the stated error.

    Parameters
    ----------
    samples, stated : array_like, shape (runs, …)
        Values of independent runs and their standard errors.  Quantities of a run may share
        paths: each is tested against quantiles of χ², with Šidák's bound for all.
    label : str
    bound_added : bool
        See `judge_z`.
    """
    samples = np.asarray(samples, dtype=float)
    runs = len(samples)
    mean_square = (np.asarray(stated, dtype=float) ** 2).mean(axis=0).ravel()
    square = ((samples - samples.mean(axis=0)) ** 2).sum(axis=0).ravel()
    assert (square[mean_square == 0.0] == 0.0).all()
    positive = mean_square > 0.0
    chi2 = square[positive] / mean_square[positive]
    level = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / chi2.size)
    low, high = np.sqrt(stats.chi2.ppf([0.5 * level, 1.0 - 0.5 * level], runs - 1) / (runs - 1))
    low = 0.0 if bound_added else low
    ratio = np.sqrt(chi2 / (runs - 1))
    report = (
        f"{label}: scatter over stated error of {chi2.size} quantities, {runs} runs: "
        f"{ratio.min():.2f} to {ratio.max():.2f}, allowed {low:.2f} to {high:.2f}"
    )
    print(report)
    assert low <= ratio.min() and ratio.max() <= high, report
    return float(np.sqrt((ratio**2).mean()))
