"""Stated errors of a BRDF lobe whose expansion is truncated by noise, against exact values."""

import numpy as np
import pytest

from splits.core.uncertainty import ErrorTarget
from splits.instruments.angular_estimate import (
    N_ANGULAR_BATCHES,
    add_interpolation_error,
    estimate_row,
    is_significant,
    join_wavelengths,
    make_direction_grid,
)
from splits.kernels.records import make_basis

POLAR = np.array([0.0, 20.0, 40.0, 60.0, 65.0, 70.0, 72.5, 75.0, 77.5, 80.0])
AZIMUTH = np.array([0.0, 5.0, 10.0, 60.0, 90.0, 120.0, 180.0])
BASIS = make_basis(24)
ANGLES = make_direction_grid(POLAR, AZIMUTH, BASIS)
LOBE = (POLAR[:, np.newaxis] >= 60.0) & (AZIMUTH <= 10.0)
SEEDS = 40


class SyntheticExits:
    """Batches of expansion coefficients with the noise of rays that exit with a given BRDF.

    Their covariance is that of single exits, ∫ f B_i B_j over projected solid angle, divided by
    the number of rays.  Every class has an equal fraction of the light.
    """

    def __init__(self, mean, root, rays, rng, classes=1):
        self.rays = rays
        noise = rng.standard_normal((N_ANGULAR_BATCHES, classes, 1, mean.size)) @ root.T
        batches = mean / classes + noise * np.sqrt(N_ANGULAR_BATCHES / rays / classes)
        self.batches = np.repeat(batches, 2, axis=2)

    def estimate_brdf(self):
        """Return the estimate of one wavelength at one index node."""
        n_rays = np.full(self.batches.shape[1], self.rays)
        target = ErrorTarget(0, np.ones(len(ANGLES.polynomials), dtype=bool))
        unscattered = np.zeros((N_ANGULAR_BATCHES, 2))
        estimate, _ = estimate_row([self.batches], unscattered, n_rays, ANGLES, False, target)
        return add_interpolation_error(join_wavelengths([estimate], np.stack), np.zeros(1))


def evaluate_forward_lobe(polar, azimuth, width):
    """Return a BRDF (1/sr) with a forward lobe about 76° of given width in degrees, as of snow."""
    theta, phi, peak = np.radians(polar), np.radians(azimuth), np.radians(76.0)
    cosine = np.cos(theta) * np.cos(peak) + np.sin(theta) * np.sin(peak) * np.cos(phi)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return 0.06 + 0.15 * np.exp(-0.5 * (angle / width) ** 2)


def project_lobe(width):
    """Return the coefficients of the lobe and a square root of the covariance of one exit."""
    x, w = np.polynomial.legendre.leggauss(60)
    mu = 0.5 * (x + 1.0)
    polar, azimuth = np.degrees(np.arccos(mu)), np.arange(0.0, 360.0, 3.0)
    values = make_direction_grid(polar, azimuth, BASIS).polynomials
    weight = np.repeat(0.5 * w * mu, azimuth.size) * np.radians(3.0)
    light = weight * evaluate_forward_lobe(polar[:, np.newaxis], azimuth, width).ravel()
    mean = values.T @ light
    covariance = (values.T * light) @ values - np.outer(mean, mean)
    eigenvalues, vectors = np.linalg.eigh(covariance)
    # The symmetric root is unique, whereas eigenvectors of equal values depend on the machine.
    return mean, (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T


def compare_errors(width, rays, classes):
    """Return the rms deviation and the bias of results, both in units of stated errors."""
    mean, root = project_lobe(width)
    truth = ANGLES.polynomials @ mean
    rng = np.random.default_rng(7)
    results = []
    for _ in range(SEEDS):
        exits = SyntheticExits(mean, root, rays, rng, classes)
        result = exits.estimate_brdf()
        results.append((result.mean[0, 0], result.stderr[0, 0]))
    value, stderr = np.array(results).transpose(1, 0, 2).reshape(2, SEEDS, *LOBE.shape)
    deviation = value - truth.reshape(LOBE.shape)
    error = np.sqrt((stderr**2).mean(axis=0))
    z = np.sqrt((deviation**2).mean(axis=0)) / error
    bias = np.abs(deviation.mean(axis=0)) / error
    lobe, elsewhere = compute_rms(z[LOBE]), compute_rms(z[~LOBE])
    print(f"deviation over stated error: lobe {lobe:.2f}, elsewhere {elsewhere:.2f}, at most")
    print(f"{z.max():.2f}; bias over stated at most {bias.max():.2f}")
    # 40 values determine a root mean square to 11 %, and a mean to 16 % of their scatter.
    assert 0.6 < compute_rms(z[LOBE]) < 1.2 and 0.6 < compute_rms(z[~LOBE]) < 1.2
    return z, bias


@pytest.mark.parametrize(("width", "rays"), [(12.0, 30_000), (15.0, 60_000), (10.0, 100_000)])
def test_lobe_truncated_by_noise_is_within_errors(width, rays):
    z, bias = compare_errors(width, rays, 1)
    assert z.max() < 1.0 + 4.0 * 0.11
    assert bias.max() < 1.0 + 2.0 * 0.16


@pytest.mark.parametrize(("width", "rays"), [(10.0, 30_000), (12.0, 100_000), (15.0, 200_000)])
def test_lobe_split_among_classes_is_within_errors(width, rays):
    # In every class the lobe is less significant, so its slope may deviate by more.
    z, _ = compare_errors(width, rays, 4)
    assert z.max() < 2.0


class FewRays(SyntheticExits):
    """A few of 100 000 traced rays that exit as from a Lambertian surface."""

    def __init__(self, number, rng):
        polar, azimuth = (
            np.degrees(np.arcsin(np.sqrt(rng.random(number)))),
            360.0 * rng.random(number),
        )
        self.rays = 100_000
        self.batches = np.zeros((N_ANGULAR_BATCHES, 1, 2, BASIS.norms.size))
        for theta, phi, batch in zip(
            polar, azimuth, rng.integers(0, N_ANGULAR_BATCHES, number), strict=True
        ):
            values = make_direction_grid(np.array([theta]), np.array([phi]), BASIS).polynomials[0]
            self.batches[batch, 0] += values * N_ANGULAR_BATCHES / self.rays


@pytest.mark.parametrize("number", [1, 2, 4, 8, 32])
def test_errors_from_few_rays_are_conservative(number):
    rng = np.random.default_rng(number)
    z = []
    for n_rays in rng.poisson(number, SEEDS):
        result = FewRays(n_rays, rng).estimate_brdf()
        z.append((result.mean[0, 0] - number / 1e5 / np.pi) / result.stderr[0, 0])
        # No unscattered ray was recorded; 100 000 rays leave an uncertainty of one ray.
        assert result.unscattered_stderr == pytest.approx(1e-5)
    print(f"{number} rays: rms z {compute_rms(np.array(z)):.2f}, largest {np.abs(z).max():.1f}")
    # Directions of a run are correlated, so 40 runs count as 40 values: the rms is known to 11 %.
    assert compute_rms(np.array(z)) < 1.0 + 4.0 * 0.11


def compute_rms(values):
    return float(np.sqrt((values**2).mean()))


def test_truncation_does_not_enlarge_errors_of_a_lambertian_surface():
    # For a Lambertian surface all coefficients but the constant are noise.
    mean, root = project_lobe(0.01)
    rng = np.random.default_rng(3)
    z = []
    for _ in range(SEEDS):
        exits = SyntheticExits(mean, root, 30_000, rng, 4)
        result = exits.estimate_brdf()
        z.append((result.mean[0, 0] - ANGLES.polynomials @ mean) / result.stderr[0, 0])
    print(f"Lambertian surface: rms z {compute_rms(np.array(z)):.2f}")
    assert 0.8 < compute_rms(np.array(z)) < 1.2


@pytest.mark.long
@pytest.mark.parametrize("count", [2, 8, 40])
def test_noise_is_rarely_significant(count):
    n_samples = 40_000
    generator = np.random.default_rng(count)
    n_significant = 0
    for _ in range(10):
        batches = generator.normal(size=(N_ANGULAR_BATCHES, n_samples // 10, count)) * np.linspace(
            1.0, 2.0, count
        )
        mean, variance = batches.mean(axis=0), batches.var(axis=0, ddof=1) / N_ANGULAR_BATCHES
        n_significant += int(is_significant(mean, variance).sum())
    # A normal variable exceeds 4 standard deviations in 3 of 100 000 cases; the few batches
    # determine their variance to 18 %, which makes this up to five times as frequent.
    print(f"{count} coefficients: {n_significant} of {n_samples}")
    assert n_significant <= 12
    single = np.zeros((1, count))
    assert not is_significant(single, single).any()
    single[0, 0] = 1.0
    assert is_significant(10.0 * single, np.ones_like(single)).all()
