"""Laws of polarized light in whole media: reciprocity of grains, energy, effect on reflectances."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z, scale_sample_size

import splits

pytestmark = NEEDS_JIT

CLEAR = {"refractive_index": {"ice": 1.31, "water": 1.33}}
WAVES = {"rms_height_m": 0.01, "wave_number_per_m": 20.0, "correlation": "gaussian"}
POINT_GRAINS = "radiative_transfer"
N_POLAR, N_AZIMUTH = 4, 8
BIN_PAIRS = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3)]
"""Pairs of polar bins, from the zenith; the bins have equal widths of the cosine."""
RAYLEIGH = {
    "optical_thickness": 2.0, "single_scattering_albedo": 1.0, "phase_function": "rayleigh",
    "bottom_albedo": None, "polarized": True,
}  # fmt: skip


def average_over_incidence(medium, wavelength: float, polar_bin: int, rays: int) -> tuple:
    """Return BRDF and error of light that is isotropic within a polar bin, by bins of view.

    The mean over the cosine of incidence, weighted by it, by three Gaussian nodes.
    """
    x, weight = np.polynomial.legendre.leggauss(3)
    cosine = 1.0 - (polar_bin + 0.5 - 0.5 * x) / N_POLAR
    weight = weight * cosine / (weight * cosine).sum()
    mean, variance = 0.0, 0.0
    for number, (node, share) in enumerate(zip(cosine, weight, strict=True)):
        ds = splits.goniophotometer(
            medium, [wavelength], float(np.degrees(np.arccos(node))), rays=rays,
            estimator="bins", n_bins=(N_POLAR, N_AZIMUTH), stokes=medium.has_grains,
            seed=10 * polar_bin + number,
        ).squeeze("wavelength")  # fmt: skip
        mean = mean + share * ds.brdf.to_numpy()
        variance = variance + (share * ds.brdf_stderr.to_numpy()) ** 2
    return mean, np.sqrt(variance)


@pytest.mark.long
@pytest.mark.parametrize(
    ("medium", "wavelength"),
    [
        (splits.Snow(depth_m=0.005, saturation=0.0, interpretation=POINT_GRAINS), 1300.0),
        (splits.Sand(depth_m=0.003, interpretation=POINT_GRAINS), 650.0),
        (splits.ParticleLayer(**{**RAYLEIGH, "optical_thickness": 1.0}), 550.0),
    ],
    ids=["snow", "sand", "particles"],
)
def test_reflection_of_polarized_runs_is_reciprocal(medium, wavelength):
    """Element R11 of the reflection matrix, R(μ, μ0) = P Rᵀ(μ0, μ) P (Hovenier 1969).

    Incidence and view are averaged over the same bins, so that both sides are equal.
    """
    rays = scale_sample_size(300_000)
    runs = [average_over_incidence(medium, wavelength, i, rays) for i in range(N_POLAR)]
    z = []
    for one, other in BIN_PAIRS:
        error = np.hypot(runs[one][1][other], runs[other][1][one])
        z.append((runs[one][0][other] - runs[other][0][one]) / error)
    judge_z(np.array(z), "reciprocity")


@pytest.mark.parametrize(
    "medium",
    [
        splits.Snow(depth_m=0.003, saturation=0.0, **CLEAR),
        splits.Snow(depth_m=0.003, saturation=0.5, **CLEAR),
        splits.ParticleLayer(**RAYLEIGH),
        splits.ParticleLayer(**RAYLEIGH, surface=WAVES),
        splits.Stack([splits.ParticleLayer(**RAYLEIGH), splits.Snow(depth_m=0.003, **CLEAR)]),
    ],
    ids=["snow", "wet snow", "particles", "rough", "stack"],
)
def test_energy_is_conserved_without_absorption(medium):
    """Every ray leaves with a weight of 1: the sum is exact but for rounding."""
    ds = splits.goniophotometer(
        medium, [600.0], 50.0, rays=scale_sample_size(100_000), estimator="bins", n_bins=(2, 4),
        stokes=True,
    )  # fmt: skip
    total = float(ds.reflectance[0] + ds.transmittance[0])
    print(f"1 - R - T = {1.0 - total:.1e}")
    assert total == pytest.approx(1.0, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(
    ("medium", "wavelength"),
    [
        (splits.Snow(interpretation=POINT_GRAINS), 1300.0), (splits.Snow(), 1300.0),
        (splits.Sand(interpretation=POINT_GRAINS), 650.0), (splits.Sand(), 650.0),
        (splits.ParticleLayer(**RAYLEIGH), 550.0),
    ],
    ids=["snow, radiative_transfer", "snow", "sand, radiative_transfer", "sand", "particles"],
)  # fmt: skip
def test_effect_of_polarization_on_reflectance(medium, wavelength):
    """Reflectances with and without polarization at 60°, to an error below 4e-4."""
    rays = scale_sample_size(3_000_000 if medium.has_grains else 10_000_000)
    scalar_medium = medium
    if not medium.has_grains:
        scalar_medium = splits.ParticleLayer(**{**RAYLEIGH, "polarized": False})
    polarized, scalar = (
        splits.goniophotometer(
            one, [wavelength], 60.0, rays=rays, estimator="bins", n_bins=(2, 4), seed=seed,
            stokes=one.has_grains and seed == 1,
        )
        for seed, one in ((1, medium), (2, scalar_medium))
    )  # fmt: skip
    value = float(scalar.reflectance[0])
    difference = float(polarized.reflectance[0]) - value
    stderr = float(np.hypot(polarized.reflectance_stderr, scalar.reflectance_stderr)[0])
    print(
        f"reflectance {value:.5f}, with polarization {difference:+.5f} ± {stderr:.5f}: "
        f"{100.0 * difference / value:+.3f} ± {100.0 * stderr / value:.3f} %"
    )
    assert stderr < 4e-4
    assert abs(difference) < 0.01 * value + 3.0 * stderr
