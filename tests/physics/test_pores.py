"""Pores of several media: exact answers, water under two names, cuts, energy, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits

WAVELENGTHS = [500.0, 1000.0, 1300.0]
BRINE = complex(1.38, 2e-6)
HAZE = complex(1.0, 1e-7)
MUDDY = {
    "saturation": 0.2,
    "pores": {"brine": 0.3, "oil": 0.1},
    "refractive_index": {"brine": BRINE, "oil": 1.47 + 1e-5j, "air": HAZE},
}


def values(ds):
    names = ("reflectance", "transmittance")
    return np.array([ds[name] for name in names]), np.array([ds[f"{n}_stderr"] for n in names])


@pytest.mark.parametrize("medium", [splits.Snow, splits.Sand])
def test_water_by_two_names_is_water(medium):
    at = np.array([700.0])
    plain = medium(saturation=0.3, depth_m=0.005)
    water = complex(plain.refractive_index["water"](at)[0])
    named = medium(
        saturation=0.1, depth_m=0.005, pores={"second": 0.2}, refractive_index={"second": water}
    )
    found, expected = (
        splits.spectrophotometer(m, at, 30.0, 0.01, kernel="scalar") for m in (named, plain)
    )
    # The same draws, and the same answers to them; weights are added up in single precision.
    np.testing.assert_allclose(found.reflectance, expected.reflectance, rtol=1e-7)
    np.testing.assert_allclose(found.transmittance, expected.transmittance, rtol=1e-7)


@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_each_medium_absorbs_what_its_share_lets_it(incidence):
    """Without grains a ray crosses in one leg: T = Σ share exp(−α d/cos θ)."""
    index = {"water": 1.0 + 1e-7j, "brine": 1.0 + 4e-7j, "oil": 1.0 + 2e-6j, "air": 1.0 + 5e-8j}
    snow = splits.Snow(
        density_kg_m3=1e-8, depth_m=0.1, **MUDDY | {"refractive_index": {"ice": 1.31} | index}
    )
    ds = splits.spectrophotometer(snow, 500.0, incidence, 0.001)
    k = np.array([5e-8, 1e-7, 4e-7, 2e-6])
    way = 0.1 / np.cos(np.radians(incidence))
    expected = np.array([0.4, 0.2, 0.3, 0.1]) @ np.exp(-4.0 * np.pi * k / 500e-9 * way)
    assert ds.attrs["kernel"] == "scalar" and not ds.reflectance.values.any()
    judge_z((ds.transmittance.values - expected) / ds.transmittance_stderr.values, independent=1)


def test_among_grains_that_nobody_sees_each_medium_absorbs_by_its_share():
    alike = dict.fromkeys(("ice", "water", "brine", "oil", "air"), 1.0 + 4e-7j)
    snow = splits.Snow(depth_m=0.05, **MUDDY | {"refractive_index": alike})
    ds = splits.irradiance_profile(snow, 500.0, [0.02], 0.0, 0.003)
    decayed = np.exp(-4.0 * np.pi * 4e-7 / 500e-9 * 0.05)
    # Roulette is played from a weight of 0.6 on: none has happened.
    assert abs(float(ds.downward_irradiance[0, -1]) - decayed) < 1e-5
    taken = ds.absorptance_of_material.sum("interval").squeeze()
    error = np.sqrt((ds.absorptance_of_material_stderr**2).sum("interval")).squeeze()
    names = ["air", "water", "brine", "oil"]
    shares = np.array([0.4, 0.2, 0.3, 0.1])
    pores = taken.sel(material=names).values
    z = (pores - shares * pores.sum()) / error.sel(material=names).values
    judge_z(z, independent=1, bound_added=True)


@pytest.mark.parametrize("medium", [splits.Snow, splits.Sand])
def test_what_comes_in_goes_somewhere(medium):
    sample = medium(depth_m=0.005, ground=0.5, **MUDDY)
    ds = splits.irradiance_profile(sample, [500.0, 900.0], [0.001, 0.003], 40.0, 0.01)
    net = ds.downward_irradiance - ds.upward_irradiance
    absorbed = ds.absorptance.sum("interval")
    whole = ds.upward_irradiance.isel(depth=0) + net.isel(depth=-1) + absorbed
    np.testing.assert_allclose(whole, 1.0, rtol=0.0, atol=1e-12)
    by_material = ds.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, ds.absorptance, rtol=0.0, atol=1e-9)


def test_both_kernels_take_air_of_any_index():
    index = {"air": 1.1 + 1e-7j}
    snow = splits.Snow(depth_m=0.006, saturation=0.3, refractive_index=index)
    z = []
    for incidence in (0.0, 60.0):
        one, two = (
            splits.spectrophotometer(snow, WAVELENGTHS, incidence, 0.004, seed, kernel=kernel)
            for seed, kernel in enumerate(("vectorized", "scalar"))
        )
        (a, da), (b, db) = values(one), values(two)
        z.append((a - b) / np.hypot(da, db))
    judge_z(np.array(z), independent=2, bound_added=True)


def test_a_cut_changes_nothing():
    whole = splits.Snow(depth_m=0.006, **MUDDY)
    cut = splits.Stack([splits.Snow(depth_m=d, **MUDDY) for d in (0.002, 0.003, 0.001)])
    z = []
    for incidence in (0.0, 60.0):
        one = splits.spectrophotometer(whole, WAVELENGTHS, incidence, 0.004, seed=1)
        two = splits.spectrophotometer(cut, WAVELENGTHS, incidence, 0.004, seed=2)
        (a, da), (b, db) = values(one), values(two)
        z.append((a - b) / np.hypot(da, db))
    judge_z(np.array(z), independent=2, bound_added=True)


def test_layers_may_hold_different_media():
    """A layer with a third medium of no optical difference from water, on one without."""
    at = np.array([700.0])
    water = complex(splits.Snow().refractive_index["water"](at)[0])
    lower = splits.Snow(depth_m=0.003, saturation=0.3)
    named = {"saturation": 0.1, "pores": {"x": 0.2}, "refractive_index": {"x": water}}
    pair = [
        splits.spectrophotometer(splits.Stack([top, lower]), at, 30.0, 0.01, kernel="scalar")
        for top in (splits.Snow(depth_m=0.003, **named), lower)
    ]
    np.testing.assert_allclose(pair[0].reflectance, pair[1].reflectance, rtol=1e-7)
    np.testing.assert_allclose(pair[0].transmittance, pair[1].transmittance, rtol=1e-7)


def test_a_medium_tells_what_is_in_its_pores():
    snow = splits.Snow(**MUDDY)
    assert snow.list_materials() == ("air", "water", "brine", "oil", "ice")
    index = snow.compute_refractive_indices(np.array([600.0]))[0]
    np.testing.assert_array_equal(index[[0, 2, 3]], [HAZE, BRINE, 1.47 + 1e-5j])
    facts = snow.describe()
    assert facts["pores_brine"] == 0.3 and facts["refractive_index_oil"] == "1.47+1e-05j"


@pytest.mark.parametrize(
    ("pores", "index", "told"),
    [
        (3, {}, "pores = 3: must be a mapping"),
        ({"brine": 0.1}, {}, "pores = 'brine': must be media of known refractive index"),
        ({"water": 0.1}, {"water": 1.3}, "pores = 'water': must be names other than"),
        ({"ice": 0.1}, {"ice": 1.3}, "pores = 'ice': must be names other than"),
        ({"a b": 0.1}, {}, "pores = 'a b'"),
        ({"brine": 0.0}, {"brine": 1.3}, r"pores\.brine = 0\.0"),
        ({"brine": 0.97}, {"brine": 1.3}, "pores = .*at most 1 together"),
        ({"brine": 0.1}, {"brine": "icy"}, r"refractive_index\[brine\] = 'icy'"),
        ({"brine": 0.1}, {"brine": 1.3, "tar": 1.5}, "refractive_index = 'tar'"),
    ],
)
def test_pores_that_cannot_be_are_refused(pores, index, told):
    with pytest.raises(ValueError, match=told):
        splits.Snow(pores=pores, refractive_index=index)


def test_what_does_not_serve_more_than_air_and_water_says_so():
    snow = splits.Snow(**MUDDY)
    with pytest.raises(ValueError, match="pores"):
        splits.single_scattering(snow, 500.0)
    with pytest.raises(ValueError, match="vectorized"):
        splits.spectrophotometer(snow, 500.0, kernel="vectorized")
    for settings in (MUDDY, {"refractive_index": {"air": HAZE}}):
        with pytest.raises(ValueError, match="depth_m"):
            splits.spectrophotometer(splits.Snow(**settings | {"depth_m": np.inf}), 500.0)


@pytest.mark.parametrize("wet", [0.0, 0.1])
def test_rays_are_in_ice_and_water_for_as_much_of_their_way_as_these_fill(wet):
    """With the way through a grain counted; far from boundaries, across which none lies."""
    alike = dict.fromkeys(("ice", "water", "air"), 1.0 + 4e-7j)
    snow = splits.Snow.natural(
        specific_surface_area_m2_kg=20, density_kg_m3=400, depth_m=0.08, liquid_water_content=wet,
        refractive_index=alike,
    )  # fmt: skip
    ds = splits.irradiance_profile(snow, 500.0, [0.02, 0.06], 0.0, 0.0015)
    taken = ds.absorptance_of_material.isel(interval=1).squeeze()
    error = ds.absorptance_of_material_stderr.isel(interval=1).squeeze()
    expected = {"ice": snow.ice_fraction, "water": wet, "air": snow.porosity - wet}
    whole = float(taken.sum())
    z = [
        (float(taken.sel(material=name)) - share * whole) / float(error.sel(material=name))
        for name, share in expected.items()
        if share
    ]
    judge_z(np.array(z[:-1]), independent=1, bound_added=True)


def test_the_papers_distance_is_that_of_a_leg():
    dry = {"density_kg_m3": 400.0, "grain_size_um": (200, 600)}
    paper = splits.Snow(**dry)
    other = splits.Snow(**dry, interpretation={"mean_free_path": "including_grain"})
    assert paper.mean_grain_distance_m == other.mean_grain_distance_m
    legs = [1.0 / snow.make_grain_population().attenuation for snow in (paper, other)]
    assert legs[0] == paper.mean_grain_distance_m
    assert legs[1] == pytest.approx(paper.porosity * legs[0])
