"""The judge itself: how often it refuses errors that are honest, too small or too large."""

from __future__ import annotations

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

FAMILIES = 1000


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
    """Return the share of families refused whose errors are `stated` times the true ones."""
    z = random.normal(size=(FAMILIES, count)) / stated
    return float(np.mean([is_rejected(judge_z, family, **settings) for family in z]))


@pytest.mark.parametrize("count", [1, 4, 12, 100])
def test_honest_errors_are_accepted(random, count):
    # Each of the two judgements refuses 1 %, and hardly both the same families.
    found = estimate_rejection_rate(random, count, 1.0)
    most = stats.binom.ppf(0.995, FAMILIES, 2.0 * SIGNIFICANCE) / FAMILIES
    assert 0.0 < found <= most


def compute_power(count: int, stated: float) -> float:
    """Return how often the rms alone is outside its limits, by χ²."""
    low, high = compute_rms_limits(count)
    ends = count * (np.array([low, high]) * stated) ** 2
    return float(stats.chi2.cdf(ends[0], count) + stats.chi2.sf(ends[1], count))


@pytest.mark.parametrize("stated", [1.5, 1.0 / 1.5, 3.0, 1.0 / 3.0])
@pytest.mark.parametrize("count", [4, 12, 30, 100])
def test_false_errors_are_refused_at_the_rates_of_chi_square(random, count, stated):
    found, expected = estimate_rejection_rate(random, count, stated), compute_power(count, stated)
    slack = stats.norm.isf(0.0005) * np.sqrt(expected * (1.0 - expected) / FAMILIES)
    print(f"{count} comparisons, errors times {stated:.2f}: {found:.3f} refused, χ² {expected:.3f}")
    # The largest one adds refusals where errors are too small.
    assert found >= expected - slack
    assert stated < 1.0 or found <= expected + slack + SIGNIFICANCE
    assert found > {4: 0.0, 12: 0.1, 30: 0.5, 100: 0.99}[count]


def test_what_the_largest_alone_let_pass(random):
    # Errors three times too large were never refused before the rms was judged.
    z = random.normal(size=(FAMILIES, 30)) / 3.0
    assert (np.abs(z).max(axis=1) <= compute_z_bound(30)).all()
    assert estimate_rejection_rate(random, 30, 3.0) == 1.0


def test_a_bound_of_a_bias_may_make_errors_too_large_but_not_too_small(random):
    assert estimate_rejection_rate(random, 100, 1.5, bound_added=True) == 0.0
    assert estimate_rejection_rate(random, 100, 1.0 / 1.5, bound_added=True) > 0.99


def test_quantities_that_share_paths_count_as_one(random):
    # Four alike in each of ten runs: as ten, they are refused as often as they should be.
    z = np.repeat(random.normal(size=(FAMILIES, 10)), 4, axis=1)
    as_ten = np.mean([is_rejected(judge_z, family, independent=10) for family in z])
    as_forty = np.mean([is_rejected(judge_z, family) for family in z])
    assert as_ten <= stats.binom.ppf(0.995, FAMILIES, 2.0 * SIGNIFICANCE) / FAMILIES
    assert as_forty > 0.1


def test_what_is_not_a_number_is_refused():
    for value in (np.nan, np.inf, -np.inf):
        assert is_rejected(judge_z, [0.3, value, -1.2])


@pytest.mark.parametrize("relative", [False, True])
def test_pooled_mean_sees_what_is_small_everywhere(random, relative):
    # A hundred differences of 1 % of values known to 3 %: none beyond 3 errors, all one way.
    values = random.uniform(0.1, 1.0, 100)
    errors = 0.03 * values
    noise = random.normal(size=(FAMILIES, 100)) * errors
    scale = values if relative else None
    honest = np.array([compute_pooled_z(d, errors, scale) for d in noise])
    assert stats.kstest(honest, stats.norm.cdf).pvalue > SIGNIFICANCE
    weights = 1.0 / errors**2
    per_error = (weights * values).sum() / np.sqrt(weights.sum())
    expected = 0.01 * (100.0**0.5 / 0.03 if relative else per_error)
    biased = np.array([compute_pooled_z(d + 0.01 * values, errors, scale) for d in noise])
    # Weights 1/s² suit differences that are alike; relative ones, those in proportion to values.
    assert biased.mean() - honest.mean() == pytest.approx(expected, rel=0.01)


def test_scatter_is_judged_on_both_sides(random):
    samples = random.normal(size=(400, 24, 6))
    honest, large, small = (
        np.mean([is_rejected(judge_scatter, s, np.full_like(s, stated)) for s in samples])
        for stated in (1.0, 2.0, 0.5)
    )
    assert honest <= stats.binom.ppf(0.995, 400, SIGNIFICANCE) / 400
    assert large > 0.99 and small > 0.99
