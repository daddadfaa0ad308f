"""Fluxes in layers by discrete ordinates against another program, budgets and exact values."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z
from level_fluxes import compute_profile, join_cosines
from test_ordinates_snow import WAVELENGTHS, make_random_snowpack

import splits
from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab

BEAMS = np.array([0.5, 0.9])
DIVIDED = ([0.3, 1.2, 2.0, 1.0], [0.95, 0.95, 0.8, 0.8], [0.6, 0.6, 0.2, 0.2])


def solve(thickness, albedo, asymmetry, ground, beams=BEAMS, n_streams=32):
    """Return the profile and the budget of layers of Henyey and Greenstein."""
    moments = np.array(asymmetry)[..., np.newaxis] ** np.arange(n_streams + 1)
    optics = LayerOptics.from_albedo(np.array(thickness, float), np.array(albedo, float), moments)
    streams, directions = Streams.from_number(n_streams), beams[np.newaxis]
    slabs = solve_slab(optics.truncate(n_streams), streams, directions)
    isotropic = make_isotropic(optics, streams, beams.size)
    elements = Element.from_slab(slabs, isotropic).split()
    boundaries = [Boundary.make_transparent(n_streams // 2, beams.size)] * 2
    outside = boundaries, np.broadcast_to(ground, optics.thickness.shape[1:]), n_streams // 2
    cosines = join_cosines(streams, directions)
    profile = compute_profile(elements, [*isotropic, isotropic[-1]], cosines, *outside)
    ends = isotropic[0], isotropic[-1]
    return profile, compute_budget(elements, ends, *outside, with_absorption=True)


def check_closure(profile, budget, tolerance=1e-12):
    net = profile.downward - profile.upward
    np.testing.assert_allclose(net[:-1] - net[1:], budget.absorption, atol=tolerance)
    np.testing.assert_allclose(profile.upward[0], budget.reflectance, atol=tolerance)
    np.testing.assert_allclose(net[-1], budget.transmittance, atol=tolerance)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_fluxes_agree_with_other_program(column):
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    thickness, albedo, asymmetry = DIVIDED
    n = 32
    profile, budget = solve(*DIVIDED, 0.3)
    check_closure(profile, budget)
    moments = np.array(asymmetry)[:, np.newaxis] ** np.arange(n + 1)
    cosine, intensity, diffuse = ((0.5, 2.0, 0.0), (0.9, 1.0 / 0.9, 0.0), (1.0, 0.0, 1.0 / np.pi))[
        column
    ]
    cosines, up, down, mean = pydisort(
        np.cumsum(thickness), np.array(albedo), n, moments, cosine, intensity, 0.0, only_flux=True,
        f_arr=moments[:, n], b_neg=diffuse, BDRF_Fourier_modes=[0.3],
    )  # fmt: skip
    depth = np.append(0.0, np.cumsum(thickness))
    np.testing.assert_allclose(profile.upward[:, column], up(depth), atol=1e-12)
    np.testing.assert_allclose(profile.downward[:, column], sum(down(depth)), atol=1e-12)
    weights = np.tile(np.polynomial.legendre.leggauss(n // 2)[1] / 2.0, 2)
    np.testing.assert_allclose(np.abs(cosines[n // 2 :]), cosines[: n // 2])
    actinic = 2.0 * np.pi * weights @ mean(depth)
    actinic += profile.direct[:, column] / cosine
    np.testing.assert_allclose(profile.actinic[:, column], actinic, atol=1e-11)
    # The direct flux includes the forward peak.
    if column < 2:
        scaled = np.array(thickness) * (1.0 - np.array(albedo) * moments[:, n])
        direct = np.exp(-np.append(0.0, np.cumsum(scaled)) / cosine)
        np.testing.assert_allclose(profile.direct[:, column], direct, rtol=1e-12)


def test_divisions_do_not_change_fluxes():
    merged, _ = solve([1.5, 3.0], [0.95, 0.8], [0.6, 0.2], 0.3)
    divided, _ = solve(*DIVIDED, 0.3)
    for one, other in zip(merged, divided, strict=True):
        np.testing.assert_allclose(one, other[[0, 2, 4]], atol=1e-13)


def test_profiles_are_batched():
    rng = np.random.default_rng(2)
    shape = (3, 5)
    layers = [rng.uniform(low, high, shape) for low, high in ((0.1, 4.0), (0.6, 1.0), (0.1, 0.8))]
    ground = rng.uniform(0.0, 1.0, 5)
    profile, budget = solve(*layers, ground, n_streams=16)
    check_closure(profile, budget)
    assert profile.actinic.shape == (4, 5, 3)
    for i in range(5):
        alone, _ = solve(*(values[:, i] for values in layers), ground[i], n_streams=16)
        for one, other in zip(profile, alone, strict=True):
            np.testing.assert_allclose(one[:, i], other, rtol=1e-11)


@pytest.mark.parametrize("thickness", [0.0, 1e-8, 1.0, 1e4, 1e8])
@pytest.mark.parametrize("albedo", [0.0, 0.9, 1.0 - 1e-12, 1.0])
def test_energy_is_conserved_at_extremes(thickness, albedo):
    beams = np.cos(np.radians([0.0, 60.0, 89.9]))
    for ground in (0.0, 0.5, 1.0):
        profile, budget = solve([thickness] * 3, [albedo] * 3, [0.8] * 3, ground, beams, 16)
        for values in profile:
            assert np.isfinite(values).all()
            assert (values > -1e-14).all()
        check_closure(profile, budget)


@pytest.mark.parametrize(("thickness", "tolerance"), [(1.0, 1e-13), (1e4, 1e-11), (1e8, 1e-6)])
def test_light_from_both_sides_is_isotropic_without_absorption(thickness, tolerance):
    """At the centre, light from above and its mirror image add up to isotropic radiance."""
    profile, _ = solve([thickness] * 2, [1.0] * 2, [0.8] * 2, 0.0, n_streams=16)
    total = profile.downward[1, -1] + profile.upward[1, -1]
    assert total == pytest.approx(1.0, abs=tolerance)
    assert profile.actinic[1, -1] == pytest.approx(2.0, abs=2.0 * tolerance)


def test_white_ground_without_absorption_encloses_isotropic_light():
    profile, _ = solve([1.0, 2.0], [1.0, 1.0], [0.8, 0.3], 1.0)
    np.testing.assert_allclose(profile.downward[:, -1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(profile.upward[:, -1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(profile.actinic[:, -1], 4.0, rtol=1e-12)


def test_flux_in_half_space_decays_at_the_rate_of_diffusion():
    """Isotropic scattering: 2k = ω log((1 + k)/(1 − k)) for the rate k."""
    albedo, step = 0.9, 2.0
    layers = [step] * 10 + [np.inf]
    profile, budget = solve(layers, [albedo] * 11, [0.0] * 11, 0.0)
    check_closure(profile, budget)
    low, high = 1e-3, 1.0 - 1e-12
    for _ in range(60):
        k = 0.5 * (low + high)
        low, high = (k, high) if 2.0 * k > albedo * np.log((1.0 + k) / (1.0 - k)) else (low, k)
    for values in (profile.downward, profile.upward, profile.actinic):
        decay = np.log(values[9, -1] / values[10, -1]) / step
        assert decay == pytest.approx(k, abs=1e-4)
        np.testing.assert_allclose(values[-1], 0.0, atol=1e-30)


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
            splits.irradiance_profile(
                pack,
                WAVELENGTHS,
                incidence,
                depth_m=depths,
                max_stderr=error,
                seed=seed,
                **solver,
            )
            for solver in (TRACED, SOLVED)
        )
        for name in QUANTITIES:
            z[name].extend(compare_results(solved, paths, name))
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
    keywords = {"depth_m": [0.005, 0.015], "max_stderr": 0.004}
    paths, solved = (
        splits.irradiance_profile(snow, [400.0, 700.0, 1030.0], 30.0, **keywords, **solver)
        for solver in (TRACED, SOLVED)
    )
    judge_z(compare_results(solved, paths, "actinic_flux"), independent=3, bound_added=True)


@pytest.mark.parametrize("water", [0.0, 0.05])
def test_isotropic_light_has_the_path_lengths_of_equilibrium(water):
    """Over a white ground, weakly absorbing snow has the radiance n² of isotropic light."""
    index = {"ice": "1.31+1e-12j", "water": "1.33+1e-12j"}
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.02, ground=1.0, liquid_water_content=water,
        refractive_index=index,
    )  # fmt: skip
    solved = splits.irradiance_profile(snow, [586.0], "diffuse", depth_m=[0.01], **SOLVED)
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
    solved = splits.irradiance_profile(pack, WAVELENGTHS, 40.0, depth_m=depths, **SOLVED)
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
    few = splits.irradiance_profile(pack, WAVELENGTHS, depth_m=[0.02], **SOLVED)
    many = splits.irradiance_profile(pack, WAVELENGTHS, depth_m=[0.005, 0.01, 0.02], **SOLVED)
    np.testing.assert_allclose(few.absorptance[:, 0], many.absorptance[:, :3].sum("interval"))
    np.testing.assert_allclose(
        few.downward_irradiance.sel(depth=0.02), many.downward_irradiance.sel(depth=0.02)
    )


def test_dataset_has_the_form_of_simulations(tmp_path):
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
    solved = splits.irradiance_profile(snow, WAVELENGTHS, depth_m=[0.01, 0.05], **SOLVED)
    assert solved.attrs["rays"] == 0 and solved.attrs["solver"] == "discrete_ordinates"
    assert (solved.actinic_flux.isel(interval=-1) == 0.0).all()
    assert "absorptance_batches" not in solved
    splits.save(solved, tmp_path / "profile.nc")
    loaded = splits.load(tmp_path / "profile.nc")
    np.testing.assert_array_equal(loaded.absorptance_of_material, solved.absorptance_of_material)


def test_radiation_profile_is_the_mean_of_irradiance_profiles():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0, liquid_water_content=0.02)
    sky = splits.sky("midlatitude_winter")
    solved = splits.radiation_profile(
        snow,
        sky,
        WAVELENGTHS[:4],
        depth_m=[0.02],
        max_stderr=0.01,
        total_w_m2=400.0,
        **SOLVED,
    )
    assert solved.attrs["solver"] == "discrete_ordinates" and solved.attrs["rays"] == 0
    net = solved.downward_irradiance - solved.upward_irradiance
    absorbed = solved.absorbed_power.sum("interval")
    np.testing.assert_allclose(net.isel(depth=0), absorbed, rtol=1e-9)


def test_refusals_state_the_reason():
    with pytest.raises(ValueError, match=r"(?s)solver.*no equation of"):
        splits.irradiance_profile(splits.Snow(depth_m=0.1), [600.0], depth_m=[0.05], **SOLVED)
    clear = splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.1, refractive_index={"ice": "1.31+0j"}
    )
    with pytest.raises(ValueError, match=r"(?s)solver.*absorb nothing at 600 nm"):
        splits.irradiance_profile(clear, [600.0], depth_m=[0.05], **SOLVED)
    with pytest.raises(ValueError, match=r"(?s)solver.*no equation of"):
        splits.radiation_profile(
            splits.Snow(depth_m=0.1), "midlatitude_winter", [600.0, 700.0], depth_m=[0.05],
            total_w_m2=1.0,
            **SOLVED,
        )  # fmt: skip
