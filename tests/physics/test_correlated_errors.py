"""Stated errors of combined wavelengths, colours and rare light against repeated runs."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, judge_p, judge_z
from scipy.stats import chi2

import splits
from splits.analysis.colour import make_colour_table
from splits.illumination.bands import SpectralBand

SEEDS = range(1, 61)
SELECTED = np.array(
    [450, 560, 700, 860, 1030, 1100, 1240, 1300, 1500, 1650, 1800, 2200], dtype=float
)
WIDE = np.union1d(np.arange(400.0, 781.0, 10.0), SELECTED)
NARROW = np.union1d(np.arange(400.0, 781.0, 10.0), [860.0, 900.0, 950.0, 1000.0])
FRESH = splits.Snow.natural(
    specific_surface_area_m2_kg=50, density_kg_m3=150, depth_m=0.02,
    impurities_ng_g={"black_carbon": 100},
)  # fmt: skip
COARSE = splits.Snow.natural(
    specific_surface_area_m2_kg=10, depth_m=0.2, liquid_water_content=0.03
)  # fmt: skip
MEDIA = {
    "Table 1": splits.Snow(),
    "natural": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.3),
    "wet": COARSE,
    "snowpack on soil": splits.Stack([FRESH, COARSE], ground=0.2),
    "thin": splits.Snow(depth_m=0.01, saturation=0.3),
    "sand": splits.Sand(),
}
"""Media chosen before any results were known."""


def combine_wavelengths(run):
    """Return quantities that combine wavelengths: value, standard error, interpolation bound."""
    w, r = run.wavelength.values, run.reflectance.values
    selected = np.isin(w, SELECTED)
    signs = np.zeros(w.size)
    signs[selected] = np.where(np.arange(selected.sum()) % 2, -1.0, 1.0)
    irradiance = splits.sky("midlatitude_winter").compute_weights(
        w, SpectralBand.from_limits(w[0], w[-1])
    )
    long_wavelength = 1240.0 if 1240.0 in w else 1000.0
    one, other = w == 860.0, w == long_wavelength
    a, b = float(r[one][0]), float(r[other][0])
    ratio = (2.0 * b * one - 2.0 * a * other) / (a + b) ** 2
    weights = {
        "sum": selected / selected.sum(),
        "differences": signs,
        "broadband": irradiance / irradiance.sum(),
    }
    values = {name: float(weight @ r) for name, weight in weights.items()}
    values["ratio"], weights["ratio"] = (a - b) / (a + b), ratio
    quantities = {}
    for name, weight in weights.items():
        parts = run.errors.split("reflectance", xr.DataArray(weight, dims="wavelength"))
        quantities[name] = (values[name], *map(float, parts))
    table = make_colour_table(run.sel(wavelength=slice(400.0, 780.0))).iloc[0]
    for axis in "Lab":
        quantities[f"{axis}*"] = tuple(table[axis + end] for end in ("", "_stderr", "_error_bound"))
    return quantities


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_errors_of_combined_wavelengths_agree_with_scatter():
    """A ratio from 60 seeds is uncertain by 9 %; means over six media are tested at 15 %.

    Interpolation errors are equal for all seeds and are therefore not part of the scatter.
    """
    freedom = len(SEEDS) - 1
    variance_ratios, total_ratios, p = {}, {}, {}
    for name, medium in MEDIA.items():
        wavelengths = NARROW if isinstance(medium, splits.Sand) else WIDE
        runs = [
            combine_wavelengths(
                splits.spectrophotometer(
                    medium, wavelengths, max_stderr=0.01, seed=seed, solver="monte_carlo"
                )
            )
            for seed in SEEDS
        ]
        for key in runs[0]:
            values, errors, bounds = np.array([run[key] for run in runs]).T
            variance_ratio = values.var(ddof=1) / (errors**2).mean()
            variance_ratios.setdefault(key, []).append(variance_ratio)
            stated = (errors**2 + bounds**2).mean()
            total_ratios.setdefault(key, []).append(values.var(ddof=1) / stated)
            probability = chi2.cdf(freedom * variance_ratio, freedom)
            p[f"{key} of {name}"] = 2.0 * min(probability, 1.0 - probability)
        print(
            name,
            {key: round(float(np.sqrt(items[-1])), 2) for key, items in variance_ratios.items()},
        )
    ratios = {key: float(np.sqrt(np.mean(items))) for key, items in variance_ratios.items()}
    print("scatter over stated scatter:", {key: round(r, 2) for key, r in ratios.items()})
    totals = {key: round(float(np.sqrt(np.mean(items))), 2) for key, items in total_ratios.items()}
    print("scatter over stated error with interpolation bound:", totals)
    assert all(0.85 < value < 1.15 for value in ratios.values()), ratios
    judge_p(p)


WAVELENGTHS = np.arange(400.0, 781.0, 10.0)
COLOUR_SEEDS = range(1, 41)
SANDS = {
    "default": {},
    "hematite": {"iron_oxide": 0.04, "hematite_ratio": 1.0},
    "wet goethite": {"iron_oxide": 0.02, "hematite_ratio": 0.0, "saturation": 1.0},
}
"""Sands chosen before any results were known: two to four refractive indices, unlike colours."""


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_errors_of_colours_agree_with_scatter():
    """A ratio from 40 seeds is uncertain by 11 %; nine ratios are tested together."""
    freedom = len(COLOUR_SEEDS) - 1
    ratios, p = {}, {}
    for name, settings in SANDS.items():
        sand = splits.Sand(**settings)
        runs = [
            splits.spectrophotometer(sand, WAVELENGTHS, max_stderr=0.005, seed=s)
            for s in COLOUR_SEEDS
        ]
        table = pd.concat([make_colour_table(run) for run in runs])
        for axis in "Lab":
            variance_ratio = table[axis].var() / (table[f"{axis}_stderr"] ** 2).mean()
            probability = chi2.cdf(freedom * variance_ratio, freedom)
            label = f"{axis}* of {name}"
            ratios[label], p[label] = (
                np.sqrt(variance_ratio),
                2.0 * min(probability, 1.0 - probability),
            )
    print("scatter over stated:", ", ".join(f"{k} {v:.2f}" for k, v in ratios.items()))
    judge_p(p)


RARE_SEEDS = range(1000, 1060)
FINE = {"specific_surface_area_m2_kg": 20.0}
COARSE_SNOW = {"specific_surface_area_m2_kg": 4.0}
SPECTRA = {
    "fine dry": (splits.Snow.natural(**FINE, depth_m=0.3), [1500.0, 1950.0], 53.0, 0.004),
    "coarse dry": (splits.Snow.natural(**COARSE_SNOW, depth_m=0.3), [1500.0, 2500.0], 0.0, 0.004),
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
    "coarse dry": (
        splits.Snow.natural(**COARSE_SNOW, depth_m=0.05),
        2000.0,
        [0.002, 0.005, 0.01],
        0.0,
    ),
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
    return np.array([compare_results(run(seed), solved, *names) for seed in RARE_SEEDS])


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", SPECTRA)
def test_errors_of_spectra_cover_rare_light(name):
    snow, wavelengths, incidence, error = SPECTRA[name]
    for wavelength in wavelengths:
        arguments = (snow, [wavelength], incidence)
        z = compare(
            lambda seed, arguments=arguments: splits.spectrophotometer(
                *arguments, max_stderr=error, seed=seed, solver="monte_carlo"
            ),
            splits.spectrophotometer(*arguments, max_stderr=0.0003, solver="discrete_ordinates"),
            ("reflectance", "transmittance", "absorptance"),
        )
        judge_z(z, f"{name}, {wavelength:g} nm", independent=len(RARE_SEEDS), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", PROFILES)
def test_errors_of_profiles_cover_rare_light(name):
    snow, wavelength, depths, incidence = PROFILES[name]
    arguments = (snow, [wavelength], incidence)
    z = compare(
        lambda seed: splits.irradiance_profile(
            *arguments, depth_m=depths, max_stderr=0.01, seed=seed, solver="monte_carlo"
        ),
        splits.irradiance_profile(
            *arguments, depth_m=depths, max_stderr=0.0005, solver="discrete_ordinates"
        ),
        ("downward_irradiance", "upward_irradiance", "absorptance", "actinic_flux"),
    )
    judge_z(z, name, independent=len(RARE_SEEDS), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_errors_of_angular_bins_cover_rare_light():
    snow = splits.Snow.natural(**COARSE_SNOW, depth_m=0.3)

    def run(rays, seed):
        return splits.goniophotometer(
            snow, [2000.0], 30.0, rays=rays, seed=seed, estimator="bins", n_bins=(3, 6)
        )

    z = compare(lambda seed: run(4000, seed), run(2_000_000, 1), ("brdf", "reflectance"))
    judge_z(z, independent=len(RARE_SEEDS), bound_added=True)
