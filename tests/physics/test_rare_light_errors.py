"""Errors of light that few rays carry, against discrete ordinates, over many seeds.

Grains and wet pores reflect a part of strongly absorbed light without letting it enter.  It has the
weight 1, and all other light hardly any, so that runs without such rays show no scatter.
"""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits

pytestmark = [NEEDS_JIT, pytest.mark.slow, pytest.mark.long]

SEEDS = range(1000, 1060)
FINE = {"specific_surface_area_m2_kg": 20.0}
COARSE = {"specific_surface_area_m2_kg": 4.0}
SPECTRA = {
    "fine dry": (splits.Snow.natural(**FINE, depth_m=0.3), [1500.0, 1950.0], 53.0, 0.004),
    "coarse dry": (splits.Snow.natural(**COARSE, depth_m=0.3), [1500.0, 2500.0], 0.0, 0.004),
    "wet": (
        splits.Snow.natural(**FINE, depth_m=0.1, liquid_water_content=0.05),
        [1500.0, 2000.0],
        30.0,
        0.004,
    ),
    "thin": (splits.Snow.natural(**FINE, depth_m=0.002), [2000.0, 2250.0], 53.0, 0.004),
    "on soil": (splits.Snow.natural(**FINE, depth_m=0.005, ground=0.5), [1500.0], 0.0, 0.01),
}
PROFILES = {
    "coarse dry": (splits.Snow.natural(**COARSE, depth_m=0.05), 2000.0, [0.002, 0.005, 0.01], 0.0),
    "wet": (
        splits.Snow.natural(
            specific_surface_area_m2_kg=10.0, depth_m=0.03, liquid_water_content=0.05
        ),
        1500.0,
        [0.001, 0.004, 0.01],
        30.0,
    ),
    "thick": (splits.Snow.natural(**FINE, depth_m=0.05), 1300.0, [0.002, 0.01, 0.02, 0.03], 53.0),
}


def compare(run, solved, names):
    """Return differences of the runs of all seeds from exact values, over their errors."""
    z = []
    for seed in SEEDS:
        paths = run(seed)
        parts = []
        for name in names:
            stderr = np.hypot(paths[f"{name}_stderr"], solved[f"{name}_stderr"])
            parts.append(((paths[name] - solved[name]) / stderr.where(stderr > 0.0)).fillna(0.0))
        z.append(np.concatenate([part.values.ravel() for part in parts]))
    return np.array(z)


@pytest.mark.parametrize("name", SPECTRA)
def test_errors_of_spectra_cover_rare_light(name):
    snow, wavelengths, incidence, error = SPECTRA[name]
    for wavelength in wavelengths:
        arguments = (snow, [wavelength], incidence)
        z = compare(
            lambda seed, arguments=arguments: splits.spectrophotometer(
                *arguments, error, seed, solver="monte_carlo"
            ),
            splits.spectrophotometer(*arguments, 0.0003, solver="discrete_ordinates"),
            ("reflectance", "transmittance", "absorptance"),
        )
        judge_z(z, f"{name}, {wavelength:g} nm", independent=len(SEEDS), bound_added=True)


@pytest.mark.parametrize("name", PROFILES)
def test_errors_of_profiles_cover_rare_light(name):
    snow, wavelength, depths, incidence = PROFILES[name]
    arguments = (snow, [wavelength], depths, incidence)
    z = compare(
        lambda seed: splits.irradiance_profile(*arguments, 0.01, seed, solver="monte_carlo"),
        splits.irradiance_profile(*arguments, 0.0005, solver="discrete_ordinates"),
        ("downward_irradiance", "upward_irradiance", "absorptance", "actinic_flux"),
    )
    judge_z(z, name, independent=len(SEEDS), bound_added=True)


def test_errors_of_angular_bins_cover_rare_light():
    snow = splits.Snow.natural(**COARSE, depth_m=0.3)

    def run(rays, seed):
        return splits.goniophotometer(
            snow, [2000.0], 30.0, rays, seed, estimator="bins", n_bins=(3, 6)
        )

    z = compare(lambda seed: run(4000, seed), run(2_000_000, 1), ("brdf", "reflectance"))
    judge_z(z, independent=len(SEEDS), bound_added=True)
