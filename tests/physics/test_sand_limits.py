"""Sand of known reflectance, trends, wet sand by interpretation, and colours of named sands."""

from functools import cached_property

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.analysis.colour import make_colour_table
from splits.media import grain_statistics
from splits.media.sand_composition import IRON_OXIDES

WAVELENGTHS = np.linspace(400.0, 1000.0, 6)
# At these wavelengths the absorption of ice ranges from negligible to almost complete.
ICE_WAVELENGTHS = np.array([500.0, 900.0, 1030.0, 1250.0, 1500.0])
MINERALS = ("quartz", "hematite", "goethite", "magnetite", "kaolinite")
TEC_10039240 = {"iron_oxide": 0.05, "hematite_ratio": 0.359, "partition": (0.5, 0.0, 0.5)}
ALL_TYPES = {
    "iron_oxide": 0.03,
    "hematite_ratio": 0.4,
    "magnetite": 0.05,
    "partition": (0.4, 0.35, 0.25),
}
ONE_TYPE = {"iron_oxide": 0.0, "partition": (1.0, 0.0, 0.0)}
# Eight types; coatings are so thin that they hold only this iron oxide and absorb no light.
EIGHT_TYPES = {
    "iron_oxide": 1e-6,
    "hematite_ratio": 0.5,
    "magnetite": 0.1,
    "partition": (0.4, 0.3, 0.3),
    "relative_coating_thickness": 1e-6,
}
SAMPLES = {
    "thin and dry": {"depth_m": 0.004},
    "thin and wet": {"depth_m": 0.004, "saturation": 0.3},
    "low sphericity": {"depth_m": 0.01, "saturation": 0.1, "sphericity": (0.3, 0.7, 0.5, 0.1)},
}


class UniformSizes:
    """Size distribution of snow, uniform from 300 to 750 µm, in place of that of a soil."""

    limits = (3e-4, 7.5e-4)
    largest_m = limits[1]
    size_attenuation_per_m = grain_statistics.compute_size_attenuation(*limits)

    def tabulate_hit_inverse_sizes(self):
        return grain_statistics.tabulate_hit_inverse_sizes(*self.limits, "cross_section")


class IcySand(splits.Sand):
    """Sand with the size distribution of snow."""

    @cached_property
    def size_distribution(self):
        return UniformSizes()


def make_snow_and_sand(types, settings):
    """Return snow and an optically equal sand of one or several particle types."""
    snow = splits.Snow(
        **{"saturation": 0.0, **settings},
        facetness=(0.0, 1.0, 0.3, 0.072),
        interpretation="splits_2007",
    )
    ice = snow.refractive_index["ice"]
    sand = IcySand(
        **types,
        **settings,
        porosity=snow.porosity,
        roundness=(0.7, 0.072),
        refractive_index=dict.fromkeys(MINERALS, ice),
    )
    return snow, sand


@NEEDS_JIT
def test_sand_of_ice_has_the_grain_population_of_snow():
    for settings in SAMPLES.values():
        snow, sand = make_snow_and_sand(ONE_TYPE, settings)
        assert sand.list_materials() == ("air", "water", "quartz")
        sand_population, snow_population = (
            sand.make_grain_population(),
            snow.make_grain_population(),
        )
        for one, other in zip(
            [*sand_population[:-1], *sand_population.types],
            [*snow_population[:-1], *snow_population.types],
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-12)
        np.testing.assert_array_equal(
            sand.compute_refractive_indices(ICE_WAVELENGTHS),
            snow.compute_refractive_indices(ICE_WAVELENGTHS),
        )


@NEEDS_JIT
@pytest.mark.parametrize("types", [ONE_TYPE, EIGHT_TYPES], ids=["one type", "eight types"])
def test_sand_of_ice_has_the_spectrum_of_snow(types):
    z = []
    for number, settings in enumerate(SAMPLES.values()):
        snow, sand = make_snow_and_sand(types, settings)
        assert sand.make_grain_population().type_cdf.size == (1 if types is ONE_TYPE else 8)
        spectra = [
            splits.spectrophotometer(medium, ICE_WAVELENGTHS, 30.0, max_stderr=0.005, seed=seed)
            for medium, seed in ((snow, 10 + number), (sand, 20 + number))
        ]
        z.append(compare_results(*spectra, "reflectance", "transmittance"))
    judge_z(
        z,
        f"sand against snow, types {sand.make_grain_population().type_cdf.size}",
        independent=len(SAMPLES),
    )
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_identical_types_may_be_split():
    """Mixed and coated grains of one index equal pure ones, for both estimators."""
    common = {"depth_m": 0.004, "saturation": 0.2}
    index = dict.fromkeys(MINERALS, 1.55 + 2e-6j)
    z = []
    for number, estimator in enumerate(("spectral", "analog")):
        pure, split = (
            splits.spectrophotometer(
                splits.Sand(**types, **common, refractive_index=index),
                [450.0, 900.0],
                max_stderr=0.006,
                seed=seed + number,
                estimator=estimator,
            )
            for types, seed in ((ONE_TYPE, 30), (EIGHT_TYPES, 40))
        )
        z.append(compare_results(pure, split, "reflectance", "transmittance"))
    judge_z(z, "identical types", independent=2)


@NEEDS_JIT
@pytest.mark.parametrize("estimator", ["spectral", "analog"])
@pytest.mark.parametrize("saturation", [0.0, 0.4])
def test_energy_is_conserved_without_absorption(estimator, saturation):
    index = dict(zip(MINERALS, (1.55, 2.9, 2.3, 2.5, 1.56), strict=True))
    sand = splits.Sand(
        **ALL_TYPES, depth_m=0.005, saturation=saturation, refractive_index={**index, "water": 1.33}
    )
    wavelengths = [400.0, 1000.0]
    assert (sand.compute_refractive_indices(wavelengths).imag == 0.0).all()
    ds = splits.spectrophotometer(sand, wavelengths, 30.0, max_stderr=0.03, estimator=estimator)
    assert np.abs(ds.reflectance + ds.transmittance - 1.0).max() < 1e-12
    assert np.abs(ds.absorptance).max() < 1e-12


def simulate_reflectance(seed=7, wavelengths=WAVELENGTHS, **settings):
    """Return reflectance and its standard error."""
    ds = splits.spectrophotometer(splits.Sand(**settings), wavelengths, max_stderr=0.006, seed=seed)
    return ds.reflectance.values, ds.reflectance_stderr.values


def judge_darker(brighter, darker):
    """Fail unless the second spectrum is darker in total and nowhere significantly brighter."""
    z = (brighter[0] - darker[0]) / np.hypot(brighter[1], darker[1])
    assert z.min() > -2.0 and z.sum() / np.sqrt(z.size) > 10.0, z


@NEEDS_JIT
@pytest.mark.parametrize("ratio", [0.0, 1.0], ids=reversed(IRON_OXIDES))
def test_iron_oxide_reduces_reflectance(ratio):
    """The trend is that of SPLITS section 5.2 and Fig 8."""
    little, more = (
        simulate_reflectance(iron_oxide=iron, hematite_ratio=ratio, seed=seed)
        for iron, seed in ((0.005, 7), (0.05, 8))
    )
    judge_darker(little, more)


@NEEDS_JIT
def test_magnetite_reduces_reflectance():
    little, more = (simulate_reflectance(magnetite=m, seed=int(10 + 10 * m)) for m in (0.0, 0.3))
    judge_darker(little, more)


@NEEDS_JIT
def test_water_reduces_reflectance():
    """The trend is that of SPLITS section 2.1.2 and Fig 10."""
    dry, wet = (
        simulate_reflectance(**TEC_10039240, saturation=s, seed=int(20 + s)) for s in (0.0, 1.0)
    )
    judge_darker(dry, wet)


@NEEDS_JIT
def test_hematite_instead_of_goethite_reddens():
    """Reflectance shifts to the red end of the spectrum (SPLITS section 5.2)."""
    ends = [450.0, 700.0]
    goethite, hematite = (
        simulate_reflectance(hematite_ratio=r, wavelengths=ends, seed=int(30 + 10 * r))
        for r in (0.0, 0.9)
    )
    redder = np.log(hematite[0][1] / hematite[0][0] / (goethite[0][1] / goethite[0][0]))
    error = np.sqrt(sum(((end[1] / end[0]) ** 2).sum() for end in (goethite, hematite)))
    assert redder > 3.0 * error and redder > np.log(1.05)


INTERPRETATIONS = ("whole_pores", "narrow_pores", "film")


def measure(interpretation, seed, error=0.003, **settings):
    """Return a spectrum of sand at three wavelengths."""
    sand = splits.Sand(interpretation={"water": interpretation}, **settings)
    return splits.spectrophotometer(sand, [600.0, 860.0, 1450.0], 40, max_stderr=error, seed=seed)


@NEEDS_JIT
def test_weakly_absorbing_water_absorbs_equally_in_all_pores():
    """Water of the index of air does not change segments, only their absorption."""
    z = []
    for number, saturation in enumerate((0.1, 0.5)):
        pair = []
        for i, interpretation in enumerate(INTERPRETATIONS[:2]):
            wet = measure(
                interpretation, 10 * number + i, 0.002, saturation=saturation, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            dry = measure(
                interpretation, 100 + 10 * number + i, 0.002, saturation=0.0, iron_oxide=0.0,
                refractive_index={"water": 1.0 + 3e-5j},
            )  # fmt: skip
            # The test has power only if water absorbs a significant fraction.
            assert float(wet.reflectance[1]) < float(dry.reflectance[1]) - 0.02
            pair.append(wet.isel(wavelength=1))
        z.append(compare_results(*pair, "reflectance"))
    judge_z(np.array(z), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("interpretation", INTERPRETATIONS)
def test_energy_of_wet_sand_is_conserved(interpretation):
    transparent = {"quartz": 1.54, "kaolinite": 1.56, "water": 1.33}
    spectrum = measure(
        interpretation,
        5,
        saturation=0.2,
        iron_oxide=0.0,
        depth_m=0.003,
        refractive_index=transparent,
    )
    total = (spectrum.reflectance + spectrum.transmittance).values
    np.testing.assert_allclose(total, 1.0, atol=1e-6)


@NEEDS_JIT
def test_first_water_reduces_reflectance_more_in_narrow_pores():
    dry, *wet = (measure(r, 3, saturation=s) for r, s in
                 [("whole_pores", 0.0), *((r, 0.1) for r in INTERPRETATIONS)])  # fmt: skip
    whole, narrow, film = (one.reflectance.values / dry.reflectance.values for one in wet)
    assert (narrow < whole - 0.05).all()
    # A film transmits light except for its weak absorption.
    assert (film[:2] > whole[:2]).all()


@NEEDS_JIT
def test_film_of_air_has_no_effect():
    """A coating with the index of its surroundings does not change the reflectance."""
    air = {"water": 1.0}
    pair = [
        measure(interpretation, seed, saturation=0.2, refractive_index=air).isel(wavelength=1)
        for seed, interpretation in enumerate(("film", "whole_pores"))
    ]
    judge_z(compare_results(*pair, "reflectance"))


VISIBLE = np.arange(400.0, 781.0, 10.0)


def compute_colour(name, **keywords):
    """Return L*, chroma and hue angle (°) of a named sand."""
    sand = splits.load_medium(name, **keywords)
    dataset = splits.spectrophotometer(sand, VISIBLE, max_stderr=0.005)
    colour = make_colour_table(dataset).iloc[0]
    assert colour.L_stderr < 1.0 and max(colour.a_stderr, colour.b_stderr) < 1.5
    return colour.L, np.hypot(colour.a, colour.b), np.degrees(np.arctan2(colour.b, colour.a))


@NEEDS_JIT
@pytest.mark.parametrize(
    ("name", "lightness", "chroma", "hue_deg"),
    [
        ("white_quartz", (90, 98), (0, 10), (60, 100)),
        ("yellow_dune", (65, 80), (15, 30), (70, 90)),
        ("red_dune", (45, 60), (25, 45), (45, 65)),
        ("black_magnetite", (20, 40), (0, 4), (-180, 180)),
    ],
)
def test_named_sands_have_the_colours_of_their_names(name, lightness, chroma, hue_deg):
    limits = (lightness, chroma, hue_deg)
    for value, (low, high) in zip(compute_colour(name), limits, strict=True):
        assert low <= value <= high


@NEEDS_JIT
def test_the_wet_beach_is_darker_and_browner_than_the_dry_one():
    wet, dry = compute_colour("wet_beach"), compute_colour("wet_beach", saturation=0)
    assert wet[0] < dry[0] - 8.0
    # Brown is a dark orange: the chroma relative to the lightness increases.
    assert wet[1] / wet[0] > 1.2 * dry[1] / dry[0]
