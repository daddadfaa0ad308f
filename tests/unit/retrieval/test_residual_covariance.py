"""Errors of fits: stated errors compared with the deviations of fits of synthetic spectra."""

import numpy as np
import pytest

from splits.retrieval.linearization import (
    NEIGHBOUR_CORRELATIONS,
    estimate_fit_covariance,
    estimate_misfit_variances,
    solve_for_state,
)
from splits.retrieval.state_vector import ParameterRange, StateVector

UNIFORM = np.sqrt(1.0 / 12.0)
NOISE_FREE = np.zeros((25, 25))


def sample_states(best, covariance):
    """Return samples around the best state in the unit cube."""
    names = [f"x{i}" for i in range(len(best))]
    free = StateVector.from_ranges(
        names, None, dict.fromkeys(names, ParameterRange(0.0, 1.0, "identity"))
    )
    return solve_for_state(free, best, covariance, 1).draws


def compute_covariance(jacobians, misfit, noise):
    """Return the covariance of the coordinates of the unit cube."""
    at_bound = np.zeros(jacobians[0].shape[1], dtype=bool)
    return estimate_fit_covariance(jacobians, misfit, noise, at_bound)[0]


def make_jacobian(n_values, n_coordinates):
    """Return smooth derivatives of a spectrum."""
    x = np.linspace(0.0, 1.0, n_values)[:, np.newaxis]
    return np.cos(np.pi * x * np.arange(n_coordinates))


def draw_autoregressive_series(rng, n_values, correlation, n_series):
    """Return autoregressive series of unit variance."""
    series = rng.normal(size=(n_series, n_values))
    for i in range(1, n_values):
        series[:, i] = correlation * series[:, i - 1] + np.sqrt(1.0 - correlation**2) * series[:, i]
    return series


@pytest.mark.parametrize(
    ("n_values", "n_coordinates", "correlation"),
    [(25, 3, 0.5), (25, 3, 0.75), (25, 7, 0.75), (61, 3, 0.0), (61, 7, 0.5), (61, 7, 0.75),
     (61, 3, 0.9), (601, 7, 0.75), (601, 7, 0.95)],
)  # fmt: skip
def test_stated_errors_match_deviations_for_correlated_misfits(
    n_values, n_coordinates, correlation
):
    jacobian = make_jacobian(n_values, n_coordinates)
    deviations, stated = [], []
    for error in 0.1 * draw_autoregressive_series(
        np.random.default_rng(4), n_values, correlation, 100
    ):
        deviations.append(np.linalg.lstsq(jacobian, error)[0])
        misfit = jacobian @ deviations[-1] - error
        covariance = compute_covariance([jacobian] * 2, misfit, np.zeros((n_values, n_values)))
        stated.append(np.sqrt(np.diag(covariance)))
    z = np.sqrt(np.mean((np.array(deviations) / np.array(stated)) ** 2))
    # The rms of 100 fits has a relative standard error of 7 %: three of these.  A short spectrum
    # gives a poor estimate of the correlation of neighbours, so the errors are overestimated.
    assert 0.6 < z < 1.0 + 3.0 * 0.07


def test_misfit_variances_match_the_autocorrelation():
    for correlation in (0.0, 0.75):
        misfit = draw_autoregressive_series(np.random.default_rng(5), 4000, correlation, 1)[0]
        variances = estimate_misfit_variances(misfit, make_jacobian(4000, 3))
        assert variances.sum() == pytest.approx(1.0, rel=0.15)
        # The standard error of a correlation r is √((1 − r²)/4000): four of these.
        near = np.abs(NEIGHBOUR_CORRELATIONS - correlation) < 0.065
        assert variances[near].sum() > 0.99 * variances.sum()
    alternating = np.where(np.arange(20) % 2, 1.0, -1.0)
    # Anticorrelated values count as independent values at most.
    assert 0.0 < estimate_misfit_variances(alternating, np.zeros((20, 0))).sum() < 1.2


def test_ray_noise_is_correlated_within_a_batch():
    jacobian, misfit = (
        make_jacobian(12, 3),
        1e-3 * draw_autoregressive_series(np.random.default_rng(6), 12, 0.0, 1)[0],
    )
    plain, one, two = (
        compute_covariance([jacobian, jacobian], misfit, noise.T @ noise)
        for noise in (np.zeros((1, 12)), np.ones((1, 12)), np.repeat(np.eye(2), 6, axis=1))
    )
    halves = [
        compute_covariance([jacobian, jacobian], misfit, np.outer(half, half)) - plain
        for half in np.repeat(np.eye(2), 6, axis=1)
    ]
    # Independent errors of the two halves add their variances; a common error does not.
    np.testing.assert_allclose(two - plain, halves[0] + halves[1], atol=1e-5)
    inverse = np.linalg.pinv(jacobian) @ np.ones(12)
    np.testing.assert_allclose(one - plain, np.outer(inverse, inverse), atol=1e-5)


def test_jacobian_noise_does_not_bias_the_errors():
    rng = np.random.default_rng(3)
    exact = np.outer(np.ones(61), [0.3, 0.0])
    misfit = 0.01 * draw_autoregressive_series(rng, 61, 0.0, 1)[0]
    noise = np.outer(rng.normal(0.0, 0.005 / np.sqrt(32), 32), np.ones(61))
    best = np.full(2, 0.5)
    noise_covariance = noise.T @ noise
    expected = sample_states(best, compute_covariance([exact] * 2, misfit, noise_covariance))[
        :, 0
    ].std()
    spreads = []
    for _ in range(20):
        noise_of_jacobians = (
            0.05 * rng.normal(size=(4, 1, 2)) * np.linspace(0.5, 1.0, 61)[:, np.newaxis]
        )
        spreads.append(
            sample_states(
                best, compute_covariance(exact + noise_of_jacobians, misfit, noise_covariance)
            ).std(axis=0)
        )
    sd = np.array(spreads)
    np.testing.assert_allclose(sd[:, 1], UNIFORM, rtol=0.04)
    # The remaining uncertainty of the other coordinate, from four Jacobians, adds to that.
    assert np.median(sd[:, 0]) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("edge", [0.0, 0.5, 1.0])
def test_unconstrained_coordinates_span_the_unit_cube(edge):
    best = np.array([edge, 0.3])
    misfit = 0.01 * draw_autoregressive_series(np.random.default_rng(7), 25, 0.0, 1)[0]
    covariance = compute_covariance([np.outer(np.ones(25), [0.0, 1.0])] * 2, misfit, NOISE_FREE)
    deviations = sample_states(best, covariance)[:, 0] - edge
    # The rms of 400 samples has a relative standard error of about 4 %: three of these.
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(np.hypot(UNIFORM, edge - 0.5), rel=0.12)


@pytest.mark.parametrize("best", [[0.5, 0.4, 0.3], [0.0, 0.4, 1.0], [0.0, 0.0, 0.0]])
def test_samples_follow_a_truncated_normal_distribution(best):
    rng = np.random.default_rng(8)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    covariance = (axes * np.array([0.03, 0.2, 1.5]) ** 2) @ axes.T
    reference = rng.multivariate_normal(best, covariance, 2_000_000)
    reference = reference[((reference >= 0.0) & (reference <= 1.0)).all(axis=1)]
    assert len(reference) > 2000
    samples = sample_states(np.array(best), covariance)
    error = np.sqrt(reference.var(axis=0) * (1.0 / len(reference) + 1.0 / len(samples)))
    assert (np.abs(samples.mean(axis=0) - reference.mean(axis=0)) < 3.3 * error).all()
    np.testing.assert_allclose(samples.std(axis=0), reference.std(axis=0), rtol=0.08)


@pytest.mark.parametrize("sd", [0.1, 0.3, 1.0])
def test_stated_errors_hold_at_a_bound(sd):
    rng = np.random.default_rng(9)
    truth = rng.random(20_000)
    estimates = np.clip(rng.normal(truth, sd), 0.0, 1.0)
    grid = np.linspace(0.0, 0.5, 6)
    squares = [np.mean((sample_states(g[np.newaxis], np.eye(1) * sd**2) - g) ** 2) for g in grid]
    stated = np.interp(np.minimum(estimates, 1.0 - estimates), grid, squares)
    at_bound = (estimates == 0.0) | (estimates == 1.0)
    for subset in (at_bound, ~at_bound):
        ratio = np.sqrt(stated[subset].mean() / ((estimates - truth)[subset] ** 2).mean())
        # The truncated normal distribution is an approximation and too wide at a bound.
        assert 0.93 < ratio < 1.3
