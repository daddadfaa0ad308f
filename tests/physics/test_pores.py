"""Pores of several media: exact results, renamed water, subdivision, energy, validation."""

import numpy as np
import pytest
from chi2 import judge_z

import splits

WAVELENGTHS = [500.0, 1000.0, 1300.0]
BRINE = complex(1.38, 2e-6)
HAZE = complex(1.0, 1e-7)
MIXED_PORES = {
    "saturation": 0.2,
    "pores": {"brine": 0.3, "oil": 0.1},
    "refractive_index": {"brine": BRINE, "oil": 1.47 + 1e-5j, "air": HAZE},
}


def get_fluxes(ds):
    names = ("reflectance", "transmittance")
    return np.array([ds[name] for name in names]), np.array([ds[f"{n}_stderr"] for n in names])


@pytest.mark.parametrize("medium", [splits.Snow, splits.Sand])
def test_pore_medium_with_index_of_water_equals_water(medium):
    wavelength = np.array([700.0])
    plain = medium(saturation=0.3, depth_m=0.005)
    water = complex(plain.refractive_index["water"](wavelength)[0])
    named = medium(
        saturation=0.1, depth_m=0.005, pores={"second": 0.2}, refractive_index={"second": water}
    )
    actual, expected = (
        splits.spectrophotometer(m, wavelength, 30.0, max_stderr=0.01, kernel="scalar")
        for m in (named, plain)
    )
    # Both runs use the same random numbers; weights are added up in single precision.
    np.testing.assert_allclose(actual.reflectance, expected.reflectance, rtol=1e-7)
    np.testing.assert_allclose(actual.transmittance, expected.transmittance, rtol=1e-7)


@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_empty_slab_absorbs_by_pore_fractions(incidence):
    """Without grains a ray crosses in one segment: T = Σ f exp(−α d/cos θ)."""
    index = {"water": 1.0 + 1e-7j, "brine": 1.0 + 4e-7j, "oil": 1.0 + 2e-6j, "air": 1.0 + 5e-8j}
    snow = splits.Snow(
        density_kg_m3=1e-8, depth_m=0.1, **MIXED_PORES | {"refractive_index": {"ice": 1.31} | index}
    )
    ds = splits.spectrophotometer(snow, 500.0, incidence, max_stderr=0.001)
    k = np.array([5e-8, 1e-7, 4e-7, 2e-6])
    path_length = 0.1 / np.cos(np.radians(incidence))
    expected = np.array([0.4, 0.2, 0.3, 0.1]) @ np.exp(-4.0 * np.pi * k / 500e-9 * path_length)
    assert ds.attrs["kernel"] == "scalar" and not ds.reflectance.values.any()
    judge_z((ds.transmittance.values - expected) / ds.transmittance_stderr.values, independent=1)


def test_index_matched_grains_leave_absorption_by_pore_fractions():
    equal_index = dict.fromkeys(("ice", "water", "brine", "oil", "air"), 1.0 + 4e-7j)
    snow = splits.Snow(depth_m=0.05, **MIXED_PORES | {"refractive_index": equal_index})
    ds = splits.irradiance_profile(snow, 500.0, 0.0, depth_m=[0.02], max_stderr=0.003)
    transmittance = np.exp(-4.0 * np.pi * 4e-7 / 500e-9 * 0.05)
    # Roulette starts below a weight of 0.6, which no ray reaches.
    assert abs(float(ds.downward_irradiance[0, -1]) - transmittance) < 1e-5
    absorbed = ds.absorptance_of_material.sum("interval").squeeze()
    error = np.sqrt((ds.absorptance_of_material_stderr**2).sum("interval")).squeeze()
    names = ["air", "water", "brine", "oil"]
    fractions = np.array([0.4, 0.2, 0.3, 0.1])
    pores = absorbed.sel(material=names).values
    z = (pores - fractions * pores.sum()) / error.sel(material=names).values
    judge_z(z, independent=1, bound_added=True)


@pytest.mark.parametrize("medium", [splits.Snow, splits.Sand])
def test_profile_conserves_energy(medium):
    sample = medium(depth_m=0.005, ground=0.5, **MIXED_PORES)
    ds = splits.irradiance_profile(
        sample, [500.0, 900.0], 40.0, depth_m=[0.001, 0.003], max_stderr=0.01
    )
    net = ds.downward_irradiance - ds.upward_irradiance
    absorbed = ds.absorptance.sum("interval")
    total = ds.upward_irradiance.isel(depth=0) + net.isel(depth=-1) + absorbed
    np.testing.assert_allclose(total, 1.0, rtol=0.0, atol=1e-12)
    by_material = ds.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, ds.absorptance, rtol=0.0, atol=1e-9)


def test_kernels_agree_on_air_of_any_index():
    index = {"air": 1.1 + 1e-7j}
    snow = splits.Snow(depth_m=0.006, saturation=0.3, refractive_index=index)
    z = []
    for incidence in (0.0, 60.0):
        one, two = (
            splits.spectrophotometer(
                snow, WAVELENGTHS, incidence, max_stderr=0.004, seed=seed, kernel=kernel
            )
            for seed, kernel in enumerate(("vectorized", "scalar"))
        )
        (a, da), (b, db) = get_fluxes(one), get_fluxes(two)
        z.append((a - b) / np.hypot(da, db))
    judge_z(np.array(z), independent=2, bound_added=True)


def test_subdivision_does_not_change_the_spectrum():
    undivided = splits.Snow(depth_m=0.006, **MIXED_PORES)
    subdivided = splits.Stack(
        [splits.Snow(depth_m=d, **MIXED_PORES) for d in (0.002, 0.003, 0.001)]
    )
    z = []
    for incidence in (0.0, 60.0):
        one = splits.spectrophotometer(undivided, WAVELENGTHS, incidence, max_stderr=0.004, seed=1)
        two = splits.spectrophotometer(subdivided, WAVELENGTHS, incidence, max_stderr=0.004, seed=2)
        (a, da), (b, db) = get_fluxes(one), get_fluxes(two)
        z.append((a - b) / np.hypot(da, db))
    judge_z(np.array(z), independent=2, bound_added=True)


def test_layers_may_have_different_pore_media():
    """A third medium with the index of water in one layer only does not change the spectrum."""
    wavelength = np.array([700.0])
    water = complex(splits.Snow().refractive_index["water"](wavelength)[0])
    lower = splits.Snow(depth_m=0.003, saturation=0.3)
    named = {"saturation": 0.1, "pores": {"x": 0.2}, "refractive_index": {"x": water}}
    pair = [
        splits.spectrophotometer(
            splits.Stack([top, lower]), wavelength, 30.0, max_stderr=0.01, kernel="scalar"
        )
        for top in (splits.Snow(depth_m=0.003, **named), lower)
    ]
    np.testing.assert_allclose(pair[0].reflectance, pair[1].reflectance, rtol=1e-7)
    np.testing.assert_allclose(pair[0].transmittance, pair[1].transmittance, rtol=1e-7)


def test_medium_describes_its_pores():
    snow = splits.Snow(**MIXED_PORES)
    assert snow.list_materials() == ("air", "water", "brine", "oil", "ice")
    index = snow.compute_refractive_indices(np.array([600.0]))[0]
    np.testing.assert_array_equal(index[[0, 2, 3]], [HAZE, BRINE, 1.47 + 1e-5j])
    description = snow.describe()
    assert (
        description["pores_brine"] == 0.3 and description["refractive_index_oil"] == "1.47+1e-05j"
    )


@pytest.mark.parametrize(
    ("pores", "index", "message"),
    [
        (3, {}, "pores = 3: must be a mapping"),
        ({"brine": 0.1}, {}, "pores = 'brine': must be media of known refractive index"),
        ({"water": 0.1}, {"water": 1.3}, "pores = 'water': must be names other than"),
        ({"ice": 0.1}, {"ice": 1.3}, "pores = 'ice': must be names other than"),
        ({"a b": 0.1}, {}, "pores = 'a b'"),
        ({"brine": 0.0}, {"brine": 1.3}, r"pores\.brine = 0\.0"),
        ({"brine": 0.97}, {"brine": 1.3}, "pores = .*add up to at most 1"),
        ({"brine": 0.1}, {"brine": "icy"}, r"refractive_index\[brine\] = 'icy'"),
        ({"brine": 0.1}, {"brine": 1.3, "tar": 1.5}, "refractive_index = 'tar'"),
    ],
)
def test_invalid_pores_are_rejected(pores, index, message):
    with pytest.raises(ValueError, match=message):
        splits.Snow(pores=pores, refractive_index=index)


def test_unsupported_instruments_reject_other_pore_media():
    snow = splits.Snow(**MIXED_PORES)
    with pytest.raises(ValueError, match="pores"):
        splits.single_scattering(snow, 500.0)
    with pytest.raises(ValueError, match="vectorized"):
        splits.spectrophotometer(snow, 500.0, kernel="vectorized")
    for settings in (MIXED_PORES, {"refractive_index": {"air": HAZE}}):
        with pytest.raises(ValueError, match="depth_m"):
            splits.spectrophotometer(splits.Snow(**settings | {"depth_m": np.inf}), 500.0)


@pytest.mark.parametrize("water_content", [0.0, 0.1])
def test_path_lengths_are_proportional_to_volume_fractions(water_content):
    """Paths through grains are included; boundaries, which no grain crosses, are far away."""
    equal_index = dict.fromkeys(("ice", "water", "air"), 1.0 + 4e-7j)
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20, density_kg_m3=400, depth_m=0.08,
        liquid_water_content=water_content, refractive_index=equal_index,
    )  # fmt: skip
    ds = splits.irradiance_profile(snow, 500.0, 0.0, depth_m=[0.02, 0.06], max_stderr=0.0015)
    absorbed = ds.absorptance_of_material.isel(interval=1).squeeze()
    error = ds.absorptance_of_material_stderr.isel(interval=1).squeeze()
    expected = {
        "ice": snow.ice_fraction,
        "water": water_content,
        "air": snow.porosity - water_content,
    }
    total = float(absorbed.sum())
    z = [
        (float(absorbed.sel(material=name)) - fraction * total) / float(error.sel(material=name))
        for name, fraction in expected.items()
        if fraction
    ]
    judge_z(np.array(z[:-1]), independent=1, bound_added=True)


def test_mean_free_path_as_printed_excludes_grains():
    dry = {"density_kg_m3": 400.0, "grain_size_um": (200, 600)}
    paper = splits.Snow(**dry)
    including_grain = splits.Snow(**dry, interpretation={"mean_free_path": "including_grain"})
    assert paper.mean_grain_distance_m == including_grain.mean_grain_distance_m
    mean_free_paths = [
        1.0 / snow.make_grain_population().collision_coefficient
        for snow in (paper, including_grain)
    ]
    assert mean_free_paths[0] == paper.mean_grain_distance_m
    assert mean_free_paths[1] == pytest.approx(paper.porosity * mean_free_paths[0])
