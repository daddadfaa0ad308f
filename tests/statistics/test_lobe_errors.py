"""A lobe that is cut short by noise: the errors stated where it is, against what is known."""

from __future__ import annotations

import numpy as np
import pytest

from splits.instruments.angular import angles_of, estimate
from splits.instruments.directional import GROUPS
from splits.transport.directions import basis_of

POLAR = np.array([0.0, 20.0, 40.0, 60.0, 65.0, 70.0, 72.5, 75.0, 77.5, 80.0])
AZIMUTH = np.array([0.0, 5.0, 10.0, 60.0, 90.0, 120.0, 180.0])
BASIS = basis_of(24)
ANGLES = angles_of(POLAR, AZIMUTH, BASIS)
LOBE = (POLAR[:, np.newaxis] >= 60.0) & (AZIMUTH <= 10.0)
SEEDS = 40


class Exits:
    """Groups of coefficients as rays yield them that leave with a given BRDF.

    Their covariance is that of single exits, ∫ f B_i B_j over projected solid angle, by rays.
    """

    def __init__(self, mean, root, rays, rng):
        self.basis, self.place = BASIS, {0: 0}
        self.rays = rays
        noise = rng.standard_normal((GROUPS, mean.size)) @ root.T
        self.groups = mean + noise * np.sqrt(GROUPS / rays)

    def coefficients(self, _):
        return np.stack([self.groups, self.groups], axis=1)[:, np.newaxis]

    def unscattered(self, _):
        return np.zeros((GROUPS, 2))

    def counts(self):
        return np.array([self.rays])


def forward(polar, azimuth, width):
    """Return a BRDF (1/sr) with a forward lobe about 76° of so many degrees, of snow's height."""
    theta, phi, peak = np.radians(polar), np.radians(azimuth), np.radians(76.0)
    cosine = np.cos(theta) * np.cos(peak) + np.sin(theta) * np.sin(peak) * np.cos(phi)
    away = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return 0.06 + 0.15 * np.exp(-0.5 * (away / width) ** 2)


def projected(width):
    """Return the coefficients of the lobe and a square root of the covariance of one exit."""
    x, w = np.polynomial.legendre.leggauss(60)
    mu = 0.5 * (x + 1.0)
    polar, azimuth = np.degrees(np.arccos(mu)), np.arange(0.0, 360.0, 3.0)
    values = angles_of(polar, azimuth, BASIS).values
    weight = np.repeat(0.5 * w * mu, azimuth.size) * np.radians(3.0)
    light = weight * forward(polar[:, np.newaxis], azimuth, width).ravel()
    mean = values.T @ light
    covariance = (values.T * light) @ values - np.outer(mean, mean)
    share, vectors = np.linalg.eigh(covariance)
    return mean, vectors * np.sqrt(np.maximum(share, 0.0))


@pytest.mark.parametrize(("width", "rays"), [(12.0, 30_000), (15.0, 60_000), (10.0, 100_000)])
def test_a_lobe_cut_by_noise_is_within_its_errors(width, rays):
    mean, root = projected(width)
    truth = ANGLES.values @ mean
    rng = np.random.default_rng(7)
    counted = np.ones(truth.size, dtype=bool)
    found = []
    for _ in range(SEEDS):
        exits = Exits(mean, root, rays, rng)
        result, _ = estimate([exits], np.zeros(1), ANGLES, False, 0, counted)
        found.append((result.mean[0, 0], result.stderr[0, 0]))
    value, stated = np.array(found).transpose(1, 0, 2).reshape(2, SEEDS, *LOBE.shape)
    off = value - truth.reshape(LOBE.shape)
    error = np.sqrt((stated**2).mean(axis=0))
    z = np.sqrt((off**2).mean(axis=0)) / error
    bias = np.abs(off.mean(axis=0)) / error
    print(f"off over stated: lobe {rms(z[LOBE]):.2f}, elsewhere {rms(z[~LOBE]):.2f}, at most")
    print(f"{z.max():.2f}; bias over stated at most {bias.max():.2f}")
    # 40 values know a root mean square to 11 %, and a mean to 16 % of their scatter.
    assert 0.6 < rms(z[LOBE]) < 1.2 and 0.6 < rms(z[~LOBE]) < 1.2
    assert z.max() < 1.0 + 4.0 * 0.11
    assert bias.max() < 1.0 + 2.0 * 0.16


def rms(values):
    return float(np.sqrt((values**2).mean()))
