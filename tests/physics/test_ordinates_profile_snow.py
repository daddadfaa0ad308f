"""Profiles within natural snow by discrete ordinates against paths and exact values."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from test_ordinates_snow import WAVELENGTHS, make_random_snowpack

import splits

TRACED, SOLVED = {"solver": "monte_carlo"}, {"solver": "discrete_ordinates"}
QUANTITIES = ("downward_irradiance", "upward_irradiance", "absorptance", "absorptance_of_material")


def compare_profiles(seeds, error):
    """Return differences from paths over their errors, by quantity."""
    z = {name: [] for name in QUANTITIES}
    for seed in seeds:
        generator = np.random.default_rng(seed)
        pack = make_random_snowpack(generator, is_wet=seed % 2 == 0)
        incidence = "diffuse" if seed % 5 == 0 else float(generator.uniform(0.0, 80.0))
        thickness = np.array([layer.depth_m for layer in pack.layers])
        boundaries = np.cumsum(thickness)[:-1]
        total = thickness[np.isfinite(thickness)].sum() or 0.1
        depths = np.unique([*boundaries, *generator.uniform(0.02, 0.98, 2) * total])
        paths, solved = (
            splits.irradiance_profile(pack, WAVELENGTHS, depths, incidence, error, seed, **solver)
            for solver in (TRACED, SOLVED)
        )
        for name in QUANTITIES:
            stderr = np.hypot(solved[f"{name}_stderr"], paths[f"{name}_stderr"])
            values = ((solved[name] - paths[name]) / stderr).where(stderr > 0.0)
            z[name].extend(values.values[np.isfinite(values.values)])
    return z


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_profiles_agree_with_paths():
    for name, values in compare_profiles((1, 2, 3, 7, 9), 0.006).items():
        judge_z(values, name, independent=5, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_actinic_flux_agrees_with_paths():
    """Where light is not absorbed before it crosses a plane, paths have an accurate flux."""
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.03, impurities_ng_g={"black_carbon": 300.0}
    )
    arguments = (snow, [400.0, 700.0, 1030.0], [0.005, 0.015], 30.0, 0.004)
    paths, solved = (splits.irradiance_profile(*arguments, **solver) for solver in (TRACED, SOLVED))
    stderr = np.hypot(paths.actinic_flux_stderr, solved.actinic_flux_stderr)
    judge_z((solved.actinic_flux - paths.actinic_flux) / stderr, independent=3, bound_added=True)


@pytest.mark.parametrize("water", [0.0, 0.05])
def test_isotropic_light_has_the_path_lengths_of_equilibrium(water):
    """Over a white ground, weakly absorbing snow has the radiance n² of isotropic light."""
    index = {"ice": "1.31+1e-12j", "water": "1.33+1e-12j"}
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.02, ground=1.0, liquid_water_content=water,
        refractive_index=index,
    )  # fmt: skip
    solved = splits.irradiance_profile(snow, [586.0], [0.01], "diffuse", **SOLVED)
    np.testing.assert_allclose(solved.downward_irradiance.sel(depth=0.0), 1.0, atol=1e-6)
    in_grains = 1.31**2 * snow.extinction_per_m / snow.attenuation_per_m
    in_pores = snow.pore_fraction * (1.0 - snow.saturation + snow.saturation * 1.33**2)
    np.testing.assert_allclose(solved.actinic_flux, 4.0 * (in_grains + in_pores), rtol=0.01)


@pytest.mark.parametrize("seed", range(6))
def test_light_is_conserved(seed):
    pack = make_random_snowpack(np.random.default_rng(seed), is_wet=seed % 2 == 0)
    depths = np.cumsum([layer.depth_m for layer in pack.layers])[:-1]
    first = 0.5 * (depths[0] if depths.size else min(pack.depth_m, 0.1))
    depths = [first, *depths]
    solved = splits.irradiance_profile(pack, WAVELENGTHS, depths, 40.0, **SOLVED)
    spectrum = splits.spectrophotometer(pack, WAVELENGTHS, 40.0, **SOLVED)
    net = solved.downward_irradiance - solved.upward_irradiance
    below = net.isel(depth=-1) * (not pack.is_semi_infinite)
    total = solved.upward_irradiance.isel(depth=0) + solved.absorptance.sum("interval") + below
    np.testing.assert_allclose(total, 1.0, atol=1e-9)
    n = net.sizes["depth"] - 1
    np.testing.assert_allclose(
        net.values[:, :-1] - net.values[:, 1:], solved.absorptance.values[:, :n], atol=1e-9
    )
    parts = solved.absorptance_of_material
    np.testing.assert_allclose(parts.sum("material"), solved.absorptance, atol=1e-9)
    assert (parts >= 0.0).all()
    reflectance = solved.upward_irradiance.isel(depth=0)
    np.testing.assert_allclose(reflectance, spectrum.reflectance, atol=1e-3)


def test_intervals_do_not_depend_on_further_depths():
    pack = make_random_snowpack(np.random.default_rng(3), is_wet=False)
    few = splits.irradiance_profile(pack, WAVELENGTHS, [0.02], **SOLVED)
    many = splits.irradiance_profile(pack, WAVELENGTHS, [0.005, 0.01, 0.02], **SOLVED)
    np.testing.assert_allclose(few.absorptance[:, 0], many.absorptance[:, :3].sum("interval"))
    np.testing.assert_allclose(
        few.downward_irradiance.sel(depth=0.02), many.downward_irradiance.sel(depth=0.02)
    )


def test_dataset_has_the_form_of_simulations(tmp_path):
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
    solved = splits.irradiance_profile(snow, WAVELENGTHS, [0.01, 0.05], **SOLVED)
    assert solved.attrs["rays"] == 0 and solved.attrs["solver"] == "discrete_ordinates"
    assert (solved.actinic_flux.isel(interval=-1) == 0.0).all()
    assert solved.absorptance_batches.dims == ("batch", "wavelength", "interval")
    splits.save(solved, tmp_path / "profile.nc")
    loaded = splits.load(tmp_path / "profile.nc")
    np.testing.assert_array_equal(loaded.absorptance_of_material, solved.absorptance_of_material)


def test_radiation_profile_is_the_mean_of_irradiance_profiles():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=0.02)
    sky = splits.sky("midlatitude_winter")
    solved = splits.radiation_profile(
        snow, sky, [0.02], WAVELENGTHS[:4], 0.01, total_w_m2=400.0, **SOLVED
    )
    assert solved.attrs["solver"] == "discrete_ordinates" and solved.attrs["rays"] == 0
    net = solved.downward_irradiance - solved.upward_irradiance
    absorbed = solved.absorbed_power.sum("interval")
    np.testing.assert_allclose(net.isel(depth=0), absorbed, rtol=1e-9)


def test_refusals_state_the_reason():
    with pytest.raises(ValueError, match=r"(?s)solver.*no equation of"):
        splits.irradiance_profile(splits.Snow(depth_m=0.1), [600.0], [0.05], **SOLVED)
    clear = splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.1, refractive_index={"ice": "1.31+0j"}
    )
    with pytest.raises(ValueError, match=r"(?s)solver.*absorb nothing at 600 nm"):
        splits.irradiance_profile(clear, [600.0], [0.05], **SOLVED)
    with pytest.raises(ValueError, match=r"(?s)solver.*no equation of"):
        splits.radiation_profile(
            splits.Snow(depth_m=0.1), "midlatitude_winter", [0.05], [600.0, 700.0], total_w_m2=1.0,
            **SOLVED,
        )  # fmt: skip
