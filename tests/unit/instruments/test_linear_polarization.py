"""Degree and angle of linear polarization: bias, errors, and light without polarization."""

from __future__ import annotations

import numpy as np
import pytest

from splits.instruments.angular_tallies import MAX_ANGLE_STDERR_DEG, compute_linear_polarization

STDERR = 0.01
DOUBLE_ANGLE = 0.7
N_DRAWS = 100_000


def draw_estimates(degree, seed):
    """Return estimates from Q and U with noise, of light of an intensity of 1."""
    rng = np.random.default_rng(seed)
    q, u = (
        degree * component + STDERR * rng.standard_normal(N_DRAWS)
        for component in (np.cos(DOUBLE_ANGLE), np.sin(DOUBLE_ANGLE))
    )
    mean = np.stack([np.ones(N_DRAWS), q, u])
    stderr = np.full_like(mean, STDERR) * [[0.0], [1.0], [1.0]]
    return compute_linear_polarization(mean, stderr, np.zeros((3, N_DRAWS)))


@pytest.mark.parametrize("degree_in_errors", [2.0, 3.0, 5.0, 20.0])
def test_the_bias_is_removed(degree_in_errors):
    estimate = draw_estimates(degree_in_errors * STDERR, 1)
    bias = estimate.degree.mean() / STDERR - degree_in_errors
    # √(Q² + U²) has a bias of 0.5 errors / the degree in errors.
    assert abs(bias) < 0.1
    assert estimate.degree.std() == pytest.approx(estimate.degree_stderr.mean(), rel=0.05)
    difference = (np.degrees(DOUBLE_ANGLE) / 2.0 - estimate.angle + 90.0) % 180.0 - 90.0
    z = difference / estimate.angle_stderr
    assert abs(z.mean()) < 5.0 / np.sqrt(N_DRAWS)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.1)


def test_unpolarized_light_is_within_the_error():
    estimate = draw_estimates(0.0, 2)
    assert estimate.degree.mean() == pytest.approx(STDERR, rel=0.02)
    assert estimate.angle_stderr.max() == MAX_ANGLE_STDERR_DEG
    assert ((estimate.angle >= 0.0) & (estimate.angle < 180.0)).all()


def test_noise_that_the_intensity_shares_cancels():
    """Q is exactly -I/5 in every sample: its degree has no error."""
    intensity, error = np.array([2.0]), np.array([0.3])
    zero = np.zeros(1)
    mean = np.stack([intensity, -0.2 * intensity, zero])
    stderr = np.stack([error, 0.2 * error, zero])
    estimate = compute_linear_polarization(mean, stderr, np.stack([-0.2 * error**2, zero, zero]))
    assert estimate.degree == pytest.approx(0.2)
    assert estimate.degree_stderr == pytest.approx(0.0, abs=1e-9)
    assert estimate.angle == pytest.approx(90.0)
    independent = compute_linear_polarization(mean, stderr, np.zeros((3, 1)))
    assert independent.degree_stderr == pytest.approx(0.2 * 0.15 * np.sqrt(2.0))


def test_no_light_has_no_known_polarization():
    zero = np.zeros((3, 1))
    estimate = compute_linear_polarization(zero, zero, zero)
    assert estimate.degree == 0.0 and estimate.degree_stderr == 1.0
    assert estimate.angle_stderr == MAX_ANGLE_STDERR_DEG


@pytest.mark.parametrize("value", [5e-324, 1e-200, 1e-12])
def test_noise_far_above_the_polarization_leaves_finite_values(value):
    mean, stderr = np.array([[1.0], [value], [0.0]]), np.full((3, 1), 0.1)
    estimate = compute_linear_polarization(mean, stderr, np.zeros((3, 1)))
    assert all(np.isfinite(one).all() for one in estimate)


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 22.5, 45.0, 100.0])
def test_errors_do_not_depend_on_the_reference(angle_deg):
    """Light of rays of one direction of polarization, some of them depolarized.

    The degree scatters, and the direction does not.
    """
    degree, scatter = 0.4, 0.02
    cos, sin = np.cos(2.0 * np.radians(angle_deg)), np.sin(2.0 * np.radians(angle_deg))
    mean = np.array([[1.0], [degree * cos], [degree * sin]])
    stderr = scatter * np.abs([[0.0], [cos], [sin]])
    covariance = np.array([[0.0], [0.0], [scatter**2 * cos * sin]])
    estimate = compute_linear_polarization(mean, stderr, covariance)
    assert estimate.degree == pytest.approx(degree)
    assert estimate.degree_stderr == pytest.approx(scatter)
    assert estimate.angle == pytest.approx(angle_deg)
    assert estimate.angle_stderr == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("intensity", [0.0, 5e-324, 1e-200, 1e-99])
def test_hardly_any_light_leaves_finite_values(intensity):
    mean = intensity * np.array([[1.0], [0.5], [-0.5]])
    for stderr in (0.0, 1e-6):
        estimate = compute_linear_polarization(mean, np.full((3, 1), stderr), np.zeros((3, 1)))
        assert all(np.isfinite(one).all() for one in estimate)
