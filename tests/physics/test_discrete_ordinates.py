"""Reflectance and transmittance against discrete ordinates with the same single scattering.

For grains so far apart that paths through them are negligible, the model must agree with radiative
transfer exactly.  For packed grains it must agree after a correction for paths through grains.
"""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.analysis.theory.asymptotic import correct_dense_packing
from splits.analysis.theory.discrete_ordinates import solve_discrete_ordinates
from splits.instruments.single_scattering import single_scattering

pytestmark = NEEDS_JIT

KEEP = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
WAVELENGTHS = [500.0, 900.0, 1800.0]
# One refractive index, hence one node without interpolation; absorption from weak to strong.
ICE = {"wavelength_nm": [400.0, 2000.0], "n": [1.31, 1.31], "k": [1e-7, 1e-4]}
ROUGH = {"facetness": (0.2, 0.4, 0.3, 0.072)}
SMOOTH = {"facetness": (0.0, 0.0, 0.0, 0.0)}
SEEDS = range(1, 5)
PACKED_TOLERANCE = 0.004
"""Largest deviation of discrete ordinates with the correction for paths through grains, for dry
packed snow, measured at standard errors of 0.0015 (docs/theory/radiative-transfer.md)."""


def make_dry_snow(thickness, density, **settings):
    """Return dry snow of an optical thickness, in which no grain is rejected."""
    interpretation = {**KEEP, "entry_point": settings.pop("entry", "uniform")}
    common = {
        "saturation": 0.0, "density_kg_m3": density, "interpretation": interpretation,
        "refractive_index": {"ice": ICE}, **settings,
    }  # fmt: skip
    return splits.Snow(
        **common, depth_m=thickness * splits.Snow(**common, depth_m=1e4).mean_grain_distance_m
    )


def solve_transfer(snow, incidence, rays=400_000, correct=lambda optics: optics):
    """Return R and T, their standard error and truncation, each of shape (2, wavelengths)."""
    runs = []
    for seed in SEEDS:
        optics = correct(single_scattering(snow, WAVELENGTHS, rays=rays, seed=seed))
        runs.append(solve_discrete_ordinates(optics, incidence))
    values = np.array([[run.reflectance, run.transmittance] for run in runs])
    truncation = np.array([runs[0].reflectance_truncation, runs[0].transmittance_truncation])
    return values.mean(axis=0), values.std(axis=0, ddof=1) / len(SEEDS) ** 0.5, truncation


def trace_paths(snow, incidence, max_stderr=0.0007, seed=11):
    ds = splits.spectrophotometer(snow, WAVELENGTHS, incidence, max_stderr=max_stderr, seed=seed)
    stderr = np.array([ds.reflectance_stderr, ds.transmittance_stderr])
    return np.array([ds.reflectance, ds.transmittance]), stderr


@pytest.mark.parametrize(
    ("settings", "thickness", "incidence"),
    [
        (ROUGH, 10.0, 0.0),
        (ROUGH, 1.0, 60.0),
        (SMOOTH, 3.0, 0.0),
        (SMOOTH, 10.0, "diffuse"),
        ({**SMOOTH, "entry": "projected"}, 3.0, 75.0),
    ],
)
@pytest.mark.long
def test_sparse_grains_agree_with_radiative_transfer(settings, thickness, incidence):
    snow = make_dry_snow(thickness, 1e-3, **settings)
    expected, error, truncation = solve_transfer(snow, incidence)
    actual, stderr = trace_paths(snow, incidence)
    difference = np.abs(actual - expected)
    z = difference / np.hypot(error, stderr)
    print(f"largest z {z.max():.2f}, truncation {truncation.max():.1e}")
    assert (difference <= 3.0 * np.hypot(error, stderr) + truncation).all(), z


def test_overlap_rules_have_no_effect_on_sparse_grains():
    # The default interpretation rejects overlapping grains, of which there are none here.
    snow = make_dry_snow(3.0, 1e-3)
    default = splits.Snow(**{**get_settings(snow), "interpretation": {}})
    kept, stderr = trace_paths(snow, 0.0, 0.002)
    rejected, _ = trace_paths(default, 0.0, 0.002)
    assert (np.abs(kept - rejected) <= stderr).all()


@pytest.mark.long
@pytest.mark.parametrize("entry", ["uniform", "projected"])
@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_packed_grains_agree_with_corrected_transfer(entry, incidence):
    snow = make_dry_snow(10.0, 275.0, entry=entry)
    actual, stderr = trace_paths(snow, incidence, 0.0015)
    uncorrected, error, _ = solve_transfer(snow, incidence, 100_000)
    corrected, _, _ = solve_transfer(snow, incidence, 100_000, correct_dense_packing)
    # Grains as points reflect too much and transmit too little, far outside all errors.
    assert (np.abs(uncorrected - actual)[:, 0] > 10.0 * np.hypot(error, stderr)[:, 0]).all()
    # The correction, from diffusion theory, is valid where scattering dominates.
    assert (np.abs(corrected - actual)[:, :2] <= PACKED_TOLERANCE + 3.0 * stderr[:, :2]).all()


@pytest.mark.long
def test_errors_of_optics_propagate_to_discrete_ordinates():
    snow = make_dry_snow(10.0, 275.0)
    names = ("reflectance", "transmittance", "absorptance")
    results = []
    for seed in range(20):
        optics = correct_dense_packing(single_scattering(snow, [500.0, 1800.0], 16, 2048, seed))
        result = solve_discrete_ordinates(optics, 30.0, 16)
        values = [[result[f"{n}{end}"].values for n in names] for end in ("", "_stderr")]
        thickness = (optics[f"optical_thickness{end}"].values for end in ("", "_stderr"))
        results.append(np.array([[*v, t] for v, t in zip(values, thickness, strict=True)]))
    values, stderrs = np.array(results).transpose(1, 0, 2, 3)
    ratio = values.std(axis=0, ddof=1) / np.sqrt((stderrs**2).mean(axis=0))
    print("scatter of seeds over stated errors:", ratio.round(2).tolist())
    # 20 seeds determine a scatter to 16 %, and 16 batches an error to 18 %, less over seeds.
    assert (np.abs(ratio - 1.0) < 4.0 * 0.16).all()


def get_settings(snow):
    names = ("facetness", "saturation", "density_kg_m3", "depth_m", "refractive_index")
    return {name: getattr(snow, name) for name in names}
