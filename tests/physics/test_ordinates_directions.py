"""BRDFs and reflectance factors of natural snow by discrete ordinates against paths."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits

WAVELENGTHS = [600.0, 1030.0, 1500.0]
DIRECTIONS = {"polar_deg": [0.0, 25.0, 50.0, 75.0], "azimuth_deg": [0.0, 60.0, 120.0, 180.0, 300.0]}
FEW = {"polar_deg": [0.0, 53.0], "azimuth_deg": [0.0, 90.0]}
SOLVED = {"solver": "discrete_ordinates"}


def make_snow(**settings):
    keywords = {"specific_surface_area_m2_kg": 20.0, "depth_m": 0.05, "ground": 0.3} | settings
    return splits.Snow.natural(**keywords)


def make_stack():
    fresh = splits.Snow.natural(specific_surface_area_m2_kg=60.0, density_kg_m3=100, depth_m=0.01)
    return splits.Stack([fresh, splits.Snow.natural(specific_surface_area_m2_kg=8.0, depth_m=0.04)])


def compare(instrument, medium, *arguments, **settings):
    """Return differences from paths over their errors, of factors and of the reflectance."""
    paths, solved = (
        instrument(medium, *arguments, seed=3, **DIRECTIONS, **settings, **solver)
        for solver in ({}, SOLVED)
    )
    return [
        ((solved[name] - paths[name]) / np.hypot(solved[f"{name}_stderr"], paths[f"{name}_stderr"]))
        .values.ravel()
        for name in ("reflectance_factor", "reflectance") if name in solved
    ]  # fmt: skip


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("incidence", [0.0, 53.0, 70.0, "diffuse"])
def test_directions_agree_with_paths(incidence):
    z = compare(splits.goniophotometer, make_snow(), WAVELENGTHS, incidence, relative_stderr=0.015)
    judge_z(np.concatenate(z), f"{incidence}", independent=len(WAVELENGTHS), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_directions_of_a_stack_agree_with_paths():
    z = compare(splits.goniophotometer, make_stack(), WAVELENGTHS, 53.0, relative_stderr=0.015)
    judge_z(np.concatenate(z), independent=len(WAVELENGTHS), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_mixed_sky_agrees_with_paths():
    sky = splits.sky("midlatitude_winter")
    z = compare(splits.hdrf, make_snow(), sky, WAVELENGTHS, relative_stderr=0.04)
    judge_z(np.concatenate(z), independent=len(WAVELENGTHS), bound_added=True)


@pytest.mark.parametrize("make", [make_snow, make_stack])
def test_brdf_is_reciprocal(make):
    angles = [0.0, 30.0, 53.0, 75.0]
    brdf = np.stack([
        splits.goniophotometer(
            make(), WAVELENGTHS, angle, polar_deg=angles, azimuth_deg=[0.0, 70.0, 180.0],
            relative_stderr=0.5, **SOLVED,
        ).brdf.values
        for angle in angles
    ])  # fmt: skip
    np.testing.assert_allclose(brdf, np.swapaxes(brdf, 0, 2), rtol=1e-8)


@pytest.mark.parametrize("depth_m", [0.05, np.inf])
def test_brdf_integrates_to_reflectance_of_spectrophotometer(depth_m):
    x, w = np.polynomial.legendre.leggauss(32)
    cosines, weights = 0.5 * (x + 1.0)[::-1], 0.5 * w[::-1]
    polar = np.degrees(np.arccos(cosines))
    snow = make_snow(depth_m=depth_m, ground=None)
    arguments = (snow, WAVELENGTHS, 53.0)
    solved = splits.goniophotometer(
        *arguments, polar_deg=polar, azimuth_deg=np.arange(0.0, 360.0, 10.0), relative_stderr=0.001,
        **SOLVED,
    )  # fmt: skip
    integral = 2.0 * np.pi * solved.brdf.mean("azimuth").values @ (weights * cosines)
    spectrum = splits.spectrophotometer(*arguments, max_stderr=1e-4, **SOLVED)
    np.testing.assert_allclose(integral, solved.reflectance, rtol=3e-3)
    for name in ("reflectance", "transmittance"):
        np.testing.assert_allclose(solved[name], spectrum[name], atol=1e-4)
    # π times the BRDF over the reflectance, so that its mean is 1.
    anisotropy = 2.0 * solved.anisotropy_factor.mean("azimuth").values @ (weights * cosines)
    np.testing.assert_allclose(anisotropy, 1.0, rtol=3e-3)


def test_reflectance_factor_under_diffuse_light_is_reflectance_of_a_beam():
    solved = splits.goniophotometer(make_snow(), WAVELENGTHS, "diffuse", **FEW, **SOLVED)
    beam = splits.spectrophotometer(make_snow(), WAVELENGTHS, 53.0, **SOLVED)
    factor = solved.reflectance_factor.sel(polar=53.0)
    np.testing.assert_allclose(factor, beam.reflectance.values[:, None] * np.ones(2), atol=1e-3)


def test_dataset_has_the_form_of_simulations(tmp_path):
    solved = splits.goniophotometer(make_snow(ground=None), WAVELENGTHS, 30.0, **FEW, **SOLVED)
    assert solved.attrs["solver"] == "discrete_ordinates" and solved.attrs["rays"] == 0
    assert solved.brdf.dims == ("wavelength", "polar", "azimuth")
    assert not {"btdf", "transmittance_factor"} & set(solved)
    assert {"direct_transmittance", "specular_reflectance", "anisotropy_factor"} <= set(solved)
    splits.save(solved, tmp_path / "brdf.nc")
    loaded = splits.load(tmp_path / "brdf.nc")
    np.testing.assert_array_equal(loaded.brdf, solved.brdf)
    assert not {"transmittance", "direct_transmittance"} & set(
        splits.goniophotometer(make_snow(), WAVELENGTHS, 30.0, **FEW, **SOLVED)
    )


def test_figures_accept_the_dataset():
    plotting = pytest.importorskip("splits.plotting.principal_plane", exc_type=ImportError)
    solved = splits.goniophotometer(make_snow(), WAVELENGTHS, 53.0, **SOLVED)
    figure = plotting.draw_principal_planes(solved, ["brdf"])
    assert figure.axes
    figure.clear()


@pytest.mark.parametrize(
    ("medium", "settings", "reason"),
    [
        (make_snow(liquid_water_content=0.02), {}, "wet snow"),
        (make_snow(ground=None), {"target": "btdf"}, "the BTDF needs paths"),
        (make_snow(), {"estimator": "bins"}, "the estimator bins needs paths"),
        (make_snow(), {"rays": 1000}, "a number of rays"),
        (splits.Snow(depth_m=0.1, saturation=0.0), {}, "no points"),
    ],
)
def test_refusals_state_the_reason(medium, settings, reason):
    with pytest.raises(ValueError, match=rf"(?s)solver.*{reason}"):
        splits.goniophotometer(medium, WAVELENGTHS, 30.0, **FEW, **settings, **SOLVED)


def test_semi_infinite_snow_needs_discrete_ordinates():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
    assert splits.goniophotometer(snow, [900.0], **FEW, solver="auto").attrs["rays"] == 0
    with pytest.raises(ValueError, match="depth_m"):
        splits.goniophotometer(snow, [900.0], **FEW)
    wet = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=0.02)
    with pytest.raises(ValueError, match="depth_m"):
        splits.goniophotometer(wet, [900.0], **FEW, solver="auto")
    with pytest.raises(ValueError, match=r"(?s)solver.*wet snow"):
        splits.hdrf(wet, "midlatitude_winter", [900.0], **FEW, **SOLVED)


@NEEDS_JIT
@pytest.mark.slow
def test_auto_traces_paths_for_wet_snow():
    wet = make_snow(liquid_water_content=0.02)
    traced = splits.goniophotometer(wet, [900.0], 30.0, 1000, **FEW, solver="auto")
    assert traced.attrs["solver"] == "monte_carlo" and traced.attrs["rays"] >= 1000
