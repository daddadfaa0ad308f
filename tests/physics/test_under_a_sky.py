"""Light inside a sample under a sky, and the directions into which it is sent back."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.uncertainty import compute_difference

W = np.array([400.0, 500.0, 700.0, 1000.0])
MINE = {"wavelength_nm": [300, 600, 1200], "direct": [1.0, 3.0, 0.0], "diffuse": [1.0, 0.0, 1.0]}


@NEEDS_JIT
def test_light_inside_a_sample_adds_up():
    """What comes in is sent back, absorbed, or goes out below; and it is as much as was said."""
    found = splits.radiation_profile(
        splits.Snow(depth_m=0.03), splits.sky("midlatitude_winter"), [0.01],
        [400.0, 700.0, 1000.0, 2000.0], 0.05, total_w_m2=500.0,
        bands={"photosynthetic": (400, 700)},
    )  # fmt: skip
    assert found.band.values.tolist() == ["broadband", "photosynthetic"]
    net = found.downward_irradiance - found.upward_irradiance
    kept = found.absorbed_power.sum("interval")
    np.testing.assert_allclose(kept + net.isel(depth=-1), net.isel(depth=0), rtol=1e-12)
    arriving = float(found.downward_irradiance[0, 0])
    assert arriving == pytest.approx(500.0 * float(found.irradiance_covered[0]), rel=1e-9)
    assert (found.absorbed_power_stderr > 0.0).all()


@NEEDS_JIT
@pytest.mark.parametrize("seeds", [24, pytest.param(50, marks=pytest.mark.long)])
def test_light_inside_has_the_errors_that_seeds_scatter_by(seeds):
    """Many seeds; what they measure shares its rays, so each counts as one comparison."""
    snow, mine = splits.Snow(depth_m=0.02), splits.sky(MINE, 50.0)
    runs = [
        splits.radiation_profile(snow, mine, [0.005], [500.0, 750.0, 1000.0], 0.03, seed=2 * seed)
        for seed in range(seeds)
    ]
    for name in ("downward_irradiance", "upward_irradiance", "absorbed_power"):
        values = np.array([run[name].values[0] for run in runs])
        stated = np.array([run[f"{name}_stderr"].values[0] for run in runs])
        seen = values.std(axis=0) > 1e-9
        off = (values - values.mean(axis=0))[:, seen]
        scale = np.sqrt((stated[:, seen] ** 2).mean(axis=0) * (1.0 - 1.0 / len(runs)))
        judge_z(off / scale, name, independent=len(runs), bound_added=True)
        assert np.sqrt(((off / scale) ** 2).mean()) > 0.5


LAYERS = [(0.02, 40, 150), (0.04, 25, 250), (0.06, 15, 350)]
"""Thickness (m), specific surface area (m²/kg) and density (kg/m³) of layers of snow."""
PACK = splits.Stack(
    [
        splits.Snow.natural(depth_m=d, specific_surface_area_m2_kg=s, density_kg_m3=r)
        for d, s, r in LAYERS
    ],
    ground=0.2,
)
COARSE = np.arange(310.0, 2491.0, 90.0)


def inside_pack(error, **given):
    sky = splits.sky("midlatitude_winter")
    return splits.radiation_profile(PACK, sky, [0.02, 0.06], COARSE, error, total_w_m2=1.0, **given)


@NEEDS_JIT
def test_light_inside_is_known_as_well_as_its_bands_ask_for():
    power, irradiance = (
        inside_pack(0.02, target=name) for name in ("absorbed_power", "irradiance")
    )
    for found in (power, irradiance):
        assert found.attrs["stop_reason"] == "converged"
        assert found.absorbed_power_stderr.max() <= 0.02
        assert found.upward_irradiance_stderr[0, 0] <= 0.02
    assert irradiance.downward_irradiance_stderr.max() <= 0.02
    assert irradiance.upward_irradiance_stderr.max() <= 0.02
    # Each wavelength for itself takes 70 000 rays and more.
    assert power.attrs["rays"] <= 20_000 < irradiance.attrs["rays"] <= 40_000


@NEEDS_JIT
def test_stated_errors_of_light_inside_follow_the_one_asked_for():
    rough, fine = (inside_pack(error) for error in (0.05, 0.0006))
    assert fine.absorbed_power_stderr.max() <= 0.0006
    assert rough.upward_irradiance_stderr[0, 0] >= 2.0 * fine.upward_irradiance_stderr[0, 0]


def test_skies_in_relative_units_ask_for_their_total():
    with pytest.raises(ValueError, match="total_w_m2 = None"):
        splits.sky("midlatitude_winter").scale_to(None)
    with pytest.raises(ValueError, match="total_w_m2"):
        splits.sky(MINE, 50.0).scale_to(-3.0)
    scaled = splits.sky("midlatitude_winter").scale_to(800.0)
    assert np.trapezoid(scaled.total, scaled.wavelength_nm) == pytest.approx(800.0)
    assert splits.sky(MINE, 50.0).scale_to(None).total[0] == 2.0


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.002, pytest.param(0.001, marks=pytest.mark.long)])
def test_the_reflectance_factor_under_diffuse_light_is_the_reciprocal_albedo(error):
    """Diffuse light is seen from a direction as much as a beam from there would be reflected."""
    polar = [0.0, 40.0, 70.0]
    natural = {"specific_surface_area_m2_kg": 20, "depth_m": 0.03}
    media = [
        splits.Snow.natural(**natural),
        splits.Snow.natural(**natural, liquid_water_content=0.1, ground=0.4),
        splits.ParticleLayer(optical_thickness=1.0, refractive_index=1.33),
    ]
    z = []
    for number, medium in enumerate(media):
        seen = splits.goniophotometer(
            medium, [1300.0], "diffuse", seed=number, relative_stderr=10.0 * error, polar_deg=polar,
            azimuth_deg=[0.0, 90.0],
        ).isel(wavelength=0)  # fmt: skip
        assert (seen.reflectance_factor[:, 0] == seen.reflectance_factor[:, 1]).all()
        for angle in polar:
            own = splits.spectrophotometer(medium, [1300.0], angle, error, seed=9)
            here = seen.sel(polar=angle).isel(azimuth=0)
            off = float(here.reflectance_factor - own.reflectance[0])
            z.append(off / np.hypot(here.reflectance_factor_stderr, own.reflectance_stderr[0]))
    judge_z(np.array(z, dtype=float), independent=len(media), bound_added=True)


@NEEDS_JIT
def test_the_reflectance_factor_under_a_sky_mixes_both():
    snow, mine = splits.Snow(depth_m=0.03), splits.sky(MINE, 50.0)
    asked = {"relative_stderr": 0.05, "polar_deg": [0.0, 60.0], "azimuth_deg": [0.0, 180.0]}
    found = splits.hdrf(snow, mine, W, seed=5, **asked)
    sun = splits.goniophotometer(snow, W, 50.0, seed=5, **asked).reflectance_factor
    rest = splits.goniophotometer(snow, W, "diffuse", seed=6, **asked).reflectance_factor
    share = xr.DataArray(mine.compute_direct_fraction(W), {"wavelength": W}, ("wavelength",))
    np.testing.assert_allclose(
        found.reflectance_factor, share * sun + (1.0 - share) * rest, rtol=1e-12
    )
    assert found.zenith_deg == 50.0


def test_only_the_expansion_knows_diffuse_light():
    with pytest.raises(ValueError, match="incidence_deg = 'diffuse'"):
        splits.goniophotometer(splits.Snow(), [500.0], "diffuse", estimator="bins")


def soiled(soot):
    natural = {"specific_surface_area_m2_kg": 20, "depth_m": 0.05, "ground": 0.2}
    return splits.Snow.natural(**natural, impurities_ng_g={"black_carbon": soot})


@NEEDS_JIT
def test_what_soot_does_to_an_albedo_has_the_error_that_seeds_scatter_by():
    """Far less than the albedo's own; 20 seeds, bands share rays and count as one comparison."""
    media, mine = {"clean": soiled(0.0), "dirty": soiled(200.0)}, splits.sky(MINE, 50.0)
    found, stated = [], []
    for seed in range(20):
        ds = splits.albedo(media, mine, W, 0.02, 2 * seed, bands={"visible": (400, 700)})
        change, error = compute_difference(ds, "band_albedo", "dirty", "clean")
        found.append(change.values)
        stated.append(error.values)
        assert (error < ds.band_albedo_stderr.min("medium")).all()
    found, stated = np.array(found), np.array(stated)
    assert (found < 0.0).all()
    scale = np.sqrt((stated**2).mean(axis=0) * (1.0 - 1.0 / len(found)))
    judge_z((found - found.mean(axis=0)) / scale, independent=len(found), bound_added=True)


@NEEDS_JIT
def test_albedos_of_several_media_are_those_of_each():
    mine = splits.sky(MINE, 50.0)
    both = splits.albedo({"a": soiled(0.0), "b": soiled(200.0)}, mine, W, 0.01, 3)
    assert both.attrs["medium"] == "snow"
    assert both.snow_black_carbon_ng_g.values.tolist() == [0.0, 200.0]
    z = []
    for number, (name, soot) in enumerate((("a", 0.0), ("b", 200.0))):
        own = splits.albedo(soiled(soot), mine, W, 0.01, 50 + 2 * number)
        here = both.sel(medium=name)
        error = np.hypot(own.albedo_stderr, here.albedo_stderr)
        z.append(((here.albedo - own.albedo) / error).values)
    judge_z(np.array(z), independent=1, bound_added=True)
    with pytest.raises(ValueError, match=r"media\['b'\]"):
        splits.albedo({"a": soiled(0.0), "b": splits.Sand()}, mine, W)
    with pytest.raises(ValueError, match="one = 'c': must be one of a, b"):
        compute_difference(both, "albedo", "c", "a")
    with pytest.raises(ValueError, match="quantity = 'direct_fraction'"):
        compute_difference(both, "direct_fraction", "a", "b")
