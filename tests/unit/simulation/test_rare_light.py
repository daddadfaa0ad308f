"""Allowance for rays that a run does not contain: coverage, continuity, and required rays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from splits.simulation.tally import (
    SUFFICIENT_RAYS,
    UNSEEN_RAYS,
    allow_for_unseen_rays,
    find_required_rays,
)

EXPECTED_COUNTS = np.geomspace(0.01, 100.0, 400)


def compute_coverage(stderr, sigma):
    """Return the probability that a Poisson count is within a multiple of its error."""
    counts = np.arange(len(stderr))
    inside = np.abs(counts - EXPECTED_COUNTS[:, np.newaxis]) <= sigma * stderr
    return (stats.poisson.pmf(counts, EXPECTED_COUNTS[:, np.newaxis]) * inside).sum(axis=1)


def test_two_errors_contain_rare_rays():
    counts = np.arange(300.0)
    allowed = np.sqrt(allow_for_unseen_rays(counts, np.ones_like(counts)))
    assert compute_coverage(np.sqrt(counts), 2.0).min() < 0.1
    # Rays of small weight give a scatter that hardly exceeds 0 if the others are missing.
    assert compute_coverage(allowed, 2.0).min() > 0.92
    assert compute_coverage(allowed, 3.0).min() > 0.98


def test_sufficient_rays_are_not_changed():
    variance = np.linspace(0.0, 20.0, 201)
    allowed = allow_for_unseen_rays(variance, 1.0)
    sufficient = variance >= SUFFICIENT_RAYS
    np.testing.assert_array_equal(allowed[sufficient], variance[sufficient])
    assert allowed[0] == UNSEEN_RAYS and (np.diff(allowed) > 0.0).all()
    assert (allowed[~sufficient] > variance[~sufficient]).all()


@pytest.mark.parametrize("variance", [0.0, 1e-6, 1e-3, 0.1, 1.0])
@pytest.mark.parametrize("max_error", [1e-4, 0.003, 0.05])
def test_required_rays_reach_the_error(variance, max_error):
    rays = find_required_rays(np.array(variance), np.array(0.9), np.array(max_error**2))
    reached = allow_for_unseen_rays(variance / rays, 0.9 / rays**2)
    assert reached == pytest.approx(max_error**2, rel=1e-12)
