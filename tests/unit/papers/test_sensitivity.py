"""Mean sensitivity index of synthetic spectra."""

import numpy as np
import pytest
from chi2 import compute_z_bound

from workflow.papers.sensitivity import NOISE_THRESHOLD_SIGMA, compute_mean_sensitivity_index


def test_equal_spectra_have_no_sensitivity():
    s = compute_mean_sensitivity_index([0.5, 0.2], [0.01, 0.01], [0.5, 0.2], [0.01, 0.01])
    assert (s.index, s.index_resolved, s.resolved_fraction) == (0.0, 0.0, 1.0)


def test_index_is_the_mean_relative_difference():
    s = compute_mean_sensitivity_index([1.0, 0.2, 0.3], [0, 0, 0], [0.5, 0.8, 0.3], [0, 0, 0])
    assert s.index == pytest.approx((0.5 + 0.75 + 0.0) / 3)
    assert s.stderr == 0.0


def test_index_is_symmetric():
    y, e, z, f = [0.9, 0.1, 0.0], [0.01, 0.02, 0.01], [0.3, 0.4, 0.2], [0.03, 0.01, 0.02]
    assert compute_mean_sensitivity_index(y, e, z, f) == compute_mean_sensitivity_index(z, f, y, e)


def test_values_below_the_noise_are_ignored():
    s = compute_mean_sensitivity_index([0.8, 1e-3], [1e-3, 1e-3], [0.4, 0.0], [1e-3, 1e-3])
    assert s.index == pytest.approx(0.25)
    assert s.index_resolved == pytest.approx(0.5)
    assert s.resolved_fraction == 0.5


def test_index_is_zero_below_the_noise():
    s = compute_mean_sensitivity_index([1e-3, 0.0], [1e-3, 0.0], [0.0, 0.0], [1e-3, 0.0])
    assert (s.index, s.index_resolved, s.resolved_fraction) == (0.0, 0.0, 0.0)
    zero = compute_mean_sensitivity_index([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    assert zero.stderr == 0.0


def test_index_of_a_vanishing_spectrum_is_one():
    s = compute_mean_sensitivity_index([0.5, 0.4], [1e-3, 1e-3], [0.0, 0.0], [1e-3, 1e-3])
    assert s.index == 1.0


def test_values_at_the_noise_threshold_are_unresolved():
    for factor, resolved in ((1.0, 0.0), (1.001, 1.0)):
        assert (
            compute_mean_sensitivity_index(
                [NOISE_THRESHOLD_SIGMA * factor], [1.0], [0.0], [1.0]
            ).resolved_fraction
            == resolved
        )


def test_error_matches_the_scatter_of_noisy_pairs():
    rng = np.random.default_rng(5)
    y, e, z, f = 0.6, 0.006, 0.4, 0.008
    ratios = [
        compute_mean_sensitivity_index([y + e * a], [e], [z + f * b], [f]).index
        for a, b in rng.standard_normal((4000, 2))
    ]
    stderr = compute_mean_sensitivity_index([y], [e], [z], [f]).stderr
    # The relative standard error of the standard deviation of 4000 values is 1/√8000.
    assert np.std(ratios) == pytest.approx(stderr, rel=compute_z_bound(1) / 8000**0.5)


@pytest.mark.parametrize("ratio", [0.0, 0.5])
@pytest.mark.parametrize("mean", [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0])
def test_error_is_an_upper_bound_near_the_noise(mean, ratio):
    rng = np.random.default_rng(9)
    samples = np.maximum(rng.normal((mean, ratio * mean), 1.0, (2000, 2)), 0.0)
    results = [compute_mean_sensitivity_index([y], [1.0], [z], [1.0]) for y, z in samples]
    stated = np.sqrt(np.mean([s.stderr**2 for s in results]))
    # The relative standard error of the standard deviation of 2000 values is 1/√4000.
    assert np.std([s.index for s in results]) < stated * (1.0 + compute_z_bound(18) / 4000**0.5)


def test_error_above_the_noise_is_that_of_the_ratio():
    y, e, z, f = 0.8, 0.1, 0.4, 0.05
    exact = np.hypot(f / y, z * e / y**2)
    assert compute_mean_sensitivity_index([y], [e], [z], [f]).stderr == pytest.approx(
        exact, rel=1e-4
    )
