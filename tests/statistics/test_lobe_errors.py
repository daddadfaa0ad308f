"""A lobe that is cut short by noise: the errors stated where it is, against what is known."""

from __future__ import annotations

import numpy as np
import pytest

from splits.instruments.angular_estimate import estimate_brdf
from splits.instruments.angular_tally import N_ANGULAR_BATCHES
from splits.instruments.angular_truncation import is_significant, make_direction_grid
from splits.kernels.tallies.angular import make_basis

POLAR = np.array([0.0, 20.0, 40.0, 60.0, 65.0, 70.0, 72.5, 75.0, 77.5, 80.0])
AZIMUTH = np.array([0.0, 5.0, 10.0, 60.0, 90.0, 120.0, 180.0])
BASIS = make_basis(24)
ANGLES = make_direction_grid(POLAR, AZIMUTH, BASIS)
LOBE = (POLAR[:, np.newaxis] >= 60.0) & (AZIMUTH <= 10.0)
SEEDS = 40


class SyntheticExits:
    """Groups of coefficients as rays yield them that leave with a given BRDF.

    Their covariance is that of single exits, ∫ f B_i B_j over projected solid angle, by rays.
    Every class has an equal part of the light.
    """

    def __init__(self, mean, root, rays, rng, classes=1):
        self.basis, self.wavelength_rows = BASIS, {0: 0}
        self.rays = rays
        noise = rng.standard_normal((N_ANGULAR_BATCHES, classes, 1, mean.size)) @ root.T
        groups = mean / classes + noise * np.sqrt(N_ANGULAR_BATCHES / rays / classes)
        self.groups = np.repeat(groups, 2, axis=2)

    def compute_coefficients(self, _):
        return self.groups

    def compute_unscattered(self, _):
        return np.zeros((N_ANGULAR_BATCHES, 2))

    def count_rays(self):
        return np.full(self.groups.shape[1], self.rays)


def evaluate_forward_lobe(polar, azimuth, width):
    """Return a BRDF (1/sr) with a forward lobe about 76° of so many degrees, of snow's height."""
    theta, phi, peak = np.radians(polar), np.radians(azimuth), np.radians(76.0)
    cosine = np.cos(theta) * np.cos(peak) + np.sin(theta) * np.sin(peak) * np.cos(phi)
    away = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return 0.06 + 0.15 * np.exp(-0.5 * (away / width) ** 2)


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
    share, vectors = np.linalg.eigh(covariance)
    # The symmetric root: eigenvectors of equal values are another set on every machine.
    return mean, (vectors * np.sqrt(np.maximum(share, 0.0))) @ vectors.T


def compare_errors(width, rays, classes):
    """Return how far results are off, over the errors stated, and their bias so."""
    mean, root = project_lobe(width)
    truth = ANGLES.polynomials @ mean
    rng = np.random.default_rng(7)
    counted = np.ones(truth.size, dtype=bool)
    found = []
    for _ in range(SEEDS):
        exits = SyntheticExits(mean, root, rays, rng, classes)
        result, _ = estimate_brdf([exits], np.zeros(1), ANGLES, False, 0, counted)
        found.append((result.mean[0, 0], result.stderr[0, 0]))
    value, stated = np.array(found).transpose(1, 0, 2).reshape(2, SEEDS, *LOBE.shape)
    off = value - truth.reshape(LOBE.shape)
    error = np.sqrt((stated**2).mean(axis=0))
    z = np.sqrt((off**2).mean(axis=0)) / error
    bias = np.abs(off.mean(axis=0)) / error
    lobe, elsewhere = compute_rms(z[LOBE]), compute_rms(z[~LOBE])
    print(f"off over stated: lobe {lobe:.2f}, elsewhere {elsewhere:.2f}, at most")
    print(f"{z.max():.2f}; bias over stated at most {bias.max():.2f}")
    # 40 values know a root mean square to 11 %, and a mean to 16 % of their scatter.
    assert 0.6 < compute_rms(z[LOBE]) < 1.2 and 0.6 < compute_rms(z[~LOBE]) < 1.2
    return z, bias


@pytest.mark.parametrize(("width", "rays"), [(12.0, 30_000), (15.0, 60_000), (10.0, 100_000)])
def test_a_lobe_cut_by_noise_is_within_its_errors(width, rays):
    z, bias = compare_errors(width, rays, 1)
    assert z.max() < 1.0 + 4.0 * 0.11
    assert bias.max() < 1.0 + 2.0 * 0.16


@pytest.mark.parametrize(("width", "rays"), [(10.0, 30_000), (12.0, 100_000), (15.0, 200_000)])
def test_so_is_a_lobe_that_classes_share(width, rays):
    # Every class for itself sees little of it: the slope of the lobe may still be off by more.
    z, _ = compare_errors(width, rays, 4)
    assert z.max() < 2.0


class FewRays(SyntheticExits):
    """A few rays that left as from a Lambertian surface, 100 000 having been traced."""

    def __init__(self, number, rng):
        polar, azimuth = (
            np.degrees(np.arcsin(np.sqrt(rng.random(number)))),
            360.0 * rng.random(number),
        )
        self.basis, self.wavelength_rows, self.rays = BASIS, {0: 0}, 100_000
        self.groups = np.zeros((N_ANGULAR_BATCHES, 1, 2, BASIS.norms.size))
        for at, around, group in zip(
            polar, azimuth, rng.integers(0, N_ANGULAR_BATCHES, number), strict=True
        ):
            values = make_direction_grid(np.array([at]), np.array([around]), BASIS).polynomials[0]
            self.groups[group, 0] += values * N_ANGULAR_BATCHES / self.rays


@pytest.mark.parametrize("number", [1, 2, 4, 8, 32])
def test_few_rays_do_not_know_their_own_error(number):
    rng = np.random.default_rng(number)
    counted = np.ones(len(ANGLES.polynomials), dtype=bool)
    z = []
    for seen in rng.poisson(number, SEEDS):
        result, _ = estimate_brdf([FewRays(seen, rng)], np.zeros(1), ANGLES, False, 0, counted)
        z.append((result.mean[0, 0] - number / 1e5 / np.pi) / result.stderr[0, 0])
        # No light went straight, which 100 000 rays cannot rule out.
        assert result.hemispherical[3] == pytest.approx(1e-5)
    print(f"{number} rays: rms z {compute_rms(np.array(z)):.2f}, largest {np.abs(z).max():.1f}")
    # Directions share their rays, so that one run of 40 may be 40 values: an rms known to 11 %.
    assert compute_rms(np.array(z)) < 1.0 + 4.0 * 0.11


def compute_rms(values):
    return float(np.sqrt((values**2).mean()))


def test_noise_of_what_was_dropped_does_not_raise_errors_of_a_plain_surface():
    # Lambert's law: all but the constant coefficient is noise.
    mean, root = project_lobe(0.01)
    rng = np.random.default_rng(3)
    counted = np.ones(len(ANGLES.polynomials), dtype=bool)
    z = []
    for _ in range(SEEDS):
        exits = SyntheticExits(mean, root, 30_000, rng, 4)
        result, _ = estimate_brdf([exits], np.zeros(1), ANGLES, False, 0, counted)
        z.append((result.mean[0, 0] - ANGLES.polynomials @ mean) / result.stderr[0, 0])
    print(f"plain surface: rms z {compute_rms(np.array(z)):.2f}")
    assert 0.8 < compute_rms(np.array(z)) < 1.2


@pytest.mark.parametrize("count", [2, 8, 40])
def test_noise_is_hardly_ever_taken_for_detail(count):
    draws = 40_000
    generator = np.random.default_rng(count)
    found = 0
    for _ in range(10):
        groups = generator.normal(size=(N_ANGULAR_BATCHES, draws // 10, count)) * np.linspace(
            1.0, 2.0, count
        )
        mean, variance = groups.mean(axis=0), groups.var(axis=0, ddof=1) / N_ANGULAR_BATCHES
        found += int(is_significant(mean, variance).sum())
    # A normal variable lies 4 of its deviations above its mean in 3 of 100 000 cases; few groups
    # know their variance to 18 % and make it up to five times as many.
    print(f"{count} coefficients: {found} of {draws}")
    assert found <= 12
    one = np.zeros((1, count))
    assert not is_significant(one, one).any()
    one[0, 0] = 1.0
    assert is_significant(10.0 * one, np.ones_like(one)).all()
