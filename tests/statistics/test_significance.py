"""Rejection rates of `judge_z` and `judge_scatter` for correct, too small and too large errors."""

import contextlib
import io

import numpy as np
import pytest
from chi2 import (
    SIGNIFICANCE,
    compute_pooled_z,
    compute_rms_limits,
    compute_z_bound,
    judge_scatter,
    judge_z,
)
from scipy import stats

N_SETS = 1000


@pytest.fixture
def random():
    return np.random.default_rng(20_240_611)


def is_rejected(judge, *arguments, **settings) -> bool:
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            judge(*arguments, **settings)
        except AssertionError:
            return True
    return False


def estimate_rejection_rate(random, count: int, stated: float, **settings) -> float:
    """Return the rejection rate of sets whose stated errors are `stated` times the true ones."""
    z = random.normal(size=(N_SETS, count)) / stated
    return float(np.mean([is_rejected(judge_z, one_set, **settings) for one_set in z]))


@pytest.mark.parametrize("count", [1, 4, 12, 100])
def test_correct_errors_are_accepted(random, count):
    # Each of the two criteria rejects 1 %, and rarely both the same set.
    rate = estimate_rejection_rate(random, count, 1.0)
    upper_limit = stats.binom.ppf(0.995, N_SETS, 2.0 * SIGNIFICANCE) / N_SETS
    assert 0.0 < rate <= upper_limit


def compute_power(count: int, stated: float) -> float:
    """Return the probability by χ² that the rms is outside its limits."""
    low, high = compute_rms_limits(count)
    ends = count * (np.array([low, high]) * stated) ** 2
    return float(stats.chi2.cdf(ends[0], count) + stats.chi2.sf(ends[1], count))


@pytest.mark.parametrize("stated", [1.5, 1.0 / 1.5, 3.0, 1.0 / 3.0])
@pytest.mark.parametrize("count", [4, 12, 30, 100])
def test_rejection_rate_of_wrong_errors_follows_chi_square(random, count, stated):
    actual, expected = estimate_rejection_rate(random, count, stated), compute_power(count, stated)
    slack = stats.norm.isf(0.0005) * np.sqrt(expected * (1.0 - expected) / N_SETS)
    print(
        f"{count} comparisons, errors times {stated:.2f}: {actual:.3f} rejected, χ² {expected:.3f}"
    )
    # The bound on the largest |z| adds rejections where errors are too small.
    assert actual >= expected - slack
    assert stated < 1.0 or actual <= expected + slack + SIGNIFICANCE
    assert actual > {4: 0.0, 12: 0.1, 30: 0.5, 100: 0.99}[count]


def test_rms_detects_errors_that_the_largest_z_misses(random):
    # Errors three times too large never exceed the bound on the largest |z|, only the rms limits.
    z = random.normal(size=(N_SETS, 30)) / 3.0
    assert (np.abs(z).max(axis=1) <= compute_z_bound(30)).all()
    assert estimate_rejection_rate(random, 30, 3.0) == 1.0


def test_bound_added_accepts_only_errors_too_large(random):
    assert estimate_rejection_rate(random, 100, 1.5, bound_added=True) == 0.0
    assert estimate_rejection_rate(random, 100, 1.0 / 1.5, bound_added=True) > 0.99


def test_correlated_quantities_count_as_one(random):
    # Four equal values in each of ten runs: counted as ten, they are rejected at the nominal rate.
    z = np.repeat(random.normal(size=(N_SETS, 10)), 4, axis=1)
    as_ten = np.mean([is_rejected(judge_z, one_set, independent=10) for one_set in z])
    as_forty = np.mean([is_rejected(judge_z, one_set) for one_set in z])
    assert as_ten <= stats.binom.ppf(0.995, N_SETS, 2.0 * SIGNIFICANCE) / N_SETS
    assert as_forty > 0.1


def test_nonfinite_values_are_rejected():
    for value in (np.nan, np.inf, -np.inf):
        assert is_rejected(judge_z, [0.3, value, -1.2])


@pytest.mark.parametrize("relative", [False, True])
def test_pooled_mean_detects_a_small_common_bias(random, relative):
    # A hundred biases of 1 % with errors of 3 %: none is significant alone, all have one sign.
    values = random.uniform(0.1, 1.0, 100)
    errors = 0.03 * values
    noise = random.normal(size=(N_SETS, 100)) * errors
    scale = values if relative else None
    unbiased = np.array([compute_pooled_z(d, errors, scale) for d in noise])
    assert stats.kstest(unbiased, stats.norm.cdf).pvalue > SIGNIFICANCE
    weights = 1.0 / errors**2
    per_error = (weights * values).sum() / np.sqrt(weights.sum())
    expected = 0.01 * (100.0**0.5 / 0.03 if relative else per_error)
    biased = np.array([compute_pooled_z(d + 0.01 * values, errors, scale) for d in noise])
    # Weights 1/s² suit constant biases; relative differences suit biases proportional to values.
    assert biased.mean() - unbiased.mean() == pytest.approx(expected, rel=0.01)


def test_scatter_is_tested_on_both_sides(random):
    samples = random.normal(size=(400, 24, 6))
    correct, large, small = (
        np.mean([is_rejected(judge_scatter, s, np.full_like(s, stated)) for s in samples])
        for stated in (1.0, 2.0, 0.5)
    )
    assert correct <= stats.binom.ppf(0.995, 400, SIGNIFICANCE) / 400
    assert large > 0.99 and small > 0.99
