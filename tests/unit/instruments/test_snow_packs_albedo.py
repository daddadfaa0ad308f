"""Albedo of many snowpacks: equal to those one by one, skies by zenith angle, bands, files."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.instruments import snow_packs

TIMES = pd.date_range("2024-02-01", periods=5, freq="h")
ZENITH = np.array([20.0, 50.03, 70.0, 89.5, 100.0])
WAVELENGTHS = np.arange(350.0, 2451.0, 150.0)
BANDS = {"visible": (400, 700)}
TABLE = {"wavelength_nm": [300, 2500], "direct": [0.5, 1.0], "diffuse": [0.5, 0.1]}


def make_packs(zenith=ZENITH):
    dims = ("time", "layer")
    rng = np.random.default_rng(5)
    ranges = {
        "thickness_m": (0.02, 0.1), "density_kg_m3": (80, 450),
        "specific_surface_area_m2_kg": (5, 60), "liquid_water_content": (0.0, 0.0),
    }  # fmt: skip
    variables = {name: (dims, rng.uniform(*limits, (5, 2))) for name, limits in ranges.items()}
    variables["liquid_water_content"][1][1] = 0.03
    dataset = xr.Dataset(variables, {"time": TIMES})
    packs = splits.SnowPacks(dataset, ground=0.2)
    return packs if zenith is None else packs.with_sun_zenith(zenith)


def check_one_by_one(result, packs, skies):
    for time, sky in zip(TIMES, skies, strict=False):
        stack = packs.make_stack(time)
        one = splits.albedo(stack, sky, WAVELENGTHS, bands=BANDS, solver="discrete_ordinates")
        row = result.sel(time=time)
        # Both components of the light have the same number of streams here.
        tolerance = 1e-6 if row.attrs["streams"] == 8 else 1e-3
        for name in ("albedo", "band_albedo", "direct_fraction", "irradiance_covered"):
            np.testing.assert_allclose(row[name], one[name], atol=tolerance, rtol=0)
        np.testing.assert_allclose(row.band_albedo_stderr, one.band_albedo_stderr, atol=1e-3)


def test_one_sky_for_all():
    packs, sky = make_packs(None), splits.sky(TABLE, 40)
    result = splits.albedo(packs, sky, WAVELENGTHS, bands=BANDS)
    assert result.albedo.dims == ("time", "wavelength")
    assert result.band_albedo.dims == ("time", "band")
    assert result.attrs["zenith_deg"] == 40.0
    check_one_by_one(result, packs, [sky] * 5)


@pytest.mark.parametrize("value", [TABLE, "midlatitude_winter", lambda z: splits.sky(TABLE, z)])
def test_sky_at_the_zenith_angle_of_each(value):
    packs = make_packs()
    result = splits.albedo(packs, value, WAVELENGTHS, bands=BANDS)
    make = value if callable(value) else lambda zenith: splits.sky(value, zenith)
    check_one_by_one(result, packs, [make(zenith) for zenith in ZENITH[:3]])
    assert np.isfinite(result.albedo[3]).all()
    assert result.albedo[4].isnull().all() and result.band_albedo[4].isnull().all()
    assert result.quality_flag.values.tolist() == [0, 0, 0, 0, 4]


def test_cloudy_sky_needs_no_sun():
    packs = make_packs(None)
    name = "midlatitude_winter_cloudy"
    result = splits.albedo(packs, name, WAVELENGTHS, bands=BANDS)
    check_one_by_one(result, packs, [splits.sky(name)] * 5)


def test_rounding_of_the_zenith_angle_has_a_small_effect(monkeypatch):
    pytest.importorskip("pvlib")
    zenith = np.array([30.024, 60.024, 75.024, 85.024, 88.024])
    packs = make_packs(zenith)
    rounded = splits.albedo(packs, "clear", WAVELENGTHS)
    monkeypatch.setattr(snow_packs, "ZENITH_STEP_DEG", 0.001)
    exact = splits.albedo(packs, "clear", WAVELENGTHS)
    assert abs(rounded.band_albedo - exact.band_albedo).max() < 1e-4
    assert abs(rounded.albedo - exact.albedo).max() < 5e-4
    assert not rounded.equals(exact)


def test_default_wavelengths_and_files(tmp_path):
    result = splits.albedo(make_packs(), "midlatitude_winter")
    assert result.wavelength.values[[0, -1]].tolist() == [305.0, 2495.0]
    splits.save(result, tmp_path / "albedo.nc")
    xr.testing.assert_equal(splits.load(tmp_path / "albedo.nc"), result)


def test_no_good_snowpack():
    result = splits.albedo(make_packs(np.full(5, 95.0)), TABLE, WAVELENGTHS)
    assert result.band_albedo.isnull().all()


@pytest.mark.parametrize("sky", ["clear", lambda zenith: splits.sky(TABLE, zenith)])
def test_sky_by_zenith_angle_needs_angles(sky):
    with pytest.raises(ValueError, match="for snowpacks without sun_zenith_deg"):
        splits.albedo(make_packs(None), sky, WAVELENGTHS)


def test_function_must_return_a_sky():
    with pytest.raises(ValueError, match=r"a function that returns a splits\.Sky"):
        splits.albedo(make_packs(), lambda zenith: zenith, WAVELENGTHS)


def test_paths_are_refused():
    with pytest.raises(ValueError, match="paths are for one snowpack"):
        splits.albedo(make_packs(), TABLE, WAVELENGTHS, solver="monte_carlo")
