"""Snow: defaults, derived quantities and errors."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from splits import Interpretation, Snow
from splits.materials import ice_density
from splits.media.interpretations import INTERPRETATION_CHOICES, merge_interpretations
from splits.media.kinds import check_medium, read_named_medium

ORDER = "min <= mean <= max <= 1"
INVALID_SNOWS = [
    ("grain_size_um", (750, 300), "1 <= min <= max <= 100000"),
    ("grain_size_um", (0.5, 300), "1 <= min <= max <= 100000"),
    ("grain_size_um", (300, 2e5), "1 <= min <= max <= 100000"),
    ("grain_size_um", (1, 2000), "max <= 1000 min"),
    ("grain_size_um", (300,), "2 numbers (min, max)"),
    ("grain_size_um", 300, "2 numbers (min, max)"),
    ("grain_size_um", "30", "2 numbers (min, max)"),
    ("facetness", (-0.1, 0.4, 0.3, 0.1), f"0 <= {ORDER}"),
    ("facetness", (0.2, 0.4, 0.5, 0.1), f"0 <= {ORDER}"),
    ("facetness", (0.2, 1.1, 0.5, 0.1), f"0 <= {ORDER}"),
    ("facetness", (0.2, 0.4, 0.3), "4 numbers (min, max, mean, sd)"),
    ("sphericity", (0.05, 0.9, 0.8, 0.1), f"0.1 <= {ORDER}"),
    ("sphericity", (0.9, 0.6, 0.8, 0.1), f"0.1 <= {ORDER}"),
    ("saturation", 1.2, "[0, 1]"),
    ("saturation", -0.1, "[0, 1]"),
    ("saturation", True, "[0, 1]"),
    ("saturation", "wet", "[0, 1]"),
    ("saturation", float("nan"), "[0, 1]"),
    ("density_kg_m3", 950.0, "916.9"),
    ("density_kg_m3", 917, "916.9"),
    ("density_kg_m3", 0.0, "916.9"),
    ("density_kg_m3", 5e-324, "1e-12, 916.9"),
    ("temperature_c", 1.0, "[-40, 0]"),
    ("temperature_c", -41.0, "[-40, 0]"),
    ("depth_m", -0.1, "(0, 10000]"),
    ("depth_m", float("-inf"), "(0, 10000]"),
    ("refractive_index", 1.31, "mapping"),
    ("interpretation", "projected", "must be one of geometric"),
]

NAMES = [field.name for field in fields(Interpretation)]


def test_defaults_equal_the_sample_of_table_1():
    shipped = read_named_medium("splitsnow_table1")
    assert shipped.pop("kind") == Snow.kind
    assert set(shipped) == set(Snow.__dataclass_fields__) - {
        "refractive_index",
        "interpretation",
        "ground",
        "pores",
        "impurities_ng_g",
        "algae_cells_ml",
        "impurities_in",
    }
    assert Snow(**shipped).describe() == Snow().describe()


def test_mean_grain_distance_and_specific_surface_area():
    assert Snow(density_kg_m3=450).mean_grain_distance_m == pytest.approx(4.3e-4, rel=0.03)
    assert Snow().specific_surface_area_m2_kg == pytest.approx(20.3, abs=0.05)


def test_liquid_water_content_is_per_volume_of_snow():
    wet = Snow(saturation=0.1, density_kg_m3=400)
    assert wet.describe()["liquid_water_content"] == pytest.approx(0.1 * wet.porosity)
    assert Snow(saturation=0).liquid_water_content == 0.0


def test_specific_surface_area_of_equal_spheres():
    snow = Snow(grain_size_um=(500, 500), sphericity=(1, 1, 1, 0))
    exact = 6.0 / (500e-6 * ice_density(-1.0))
    assert snow.specific_surface_area_m2_kg == pytest.approx(exact, rel=1e-12)
    assert snow.optical_radius_um == pytest.approx(250.0, rel=1e-12)
    # Mean cross-section over volume of a sphere: 1.5 per diameter.
    assert snow.attenuation_per_m == pytest.approx(1.5 / 500e-6, rel=1e-12)


def test_porosity_is_the_volume_without_ice():
    snow = Snow(density_kg_m3=275, temperature_c=-20)
    assert snow.porosity == pytest.approx(1.0 - 275 / 920.3, rel=1e-14)


def test_semi_axis_interpretation_doubles_the_grains():
    single, double = Snow(), Snow(interpretation={"size_definition": "semi_axis"})
    ratio = double.mean_grain_distance_m / single.mean_grain_distance_m
    assert ratio == pytest.approx(2.0, rel=1e-14)
    with pytest.raises(ValueError, match=r"depth_m = 0.001: .*0.0015 m"):
        check_medium(
            Snow(depth_m=0.001, interpretation=Interpretation(size_definition="semi_axis"))
        )


@pytest.mark.parametrize(("key", "value", "allowed"), INVALID_SNOWS)
def test_invalid_values_are_rejected_with_key_and_range(key, value, allowed):
    with pytest.raises(ValueError, match=f"^{key}") as error:
        Snow(**{key: value})
    assert repr(value) in str(error.value)
    assert allowed in str(error.value)


@pytest.mark.parametrize("key", ["facetness", "sphericity"])
def test_negative_standard_deviations_are_rejected(key):
    with pytest.raises(ValueError, match=rf"^{key} \(sd\) = -0.1: must be in \[0, 1\]"):
        Snow(**{key: (0.2, 0.8, 0.5, -0.1)})


def test_unknown_keywords_are_rejected():
    with pytest.raises(TypeError, match="saturaton"):
        Snow(saturaton=0.1)


def test_indices_of_unknown_materials_are_rejected():
    with pytest.raises(ValueError, match=r"refractive_index = 'sand'.*ice, water"):
        Snow(refractive_index={"sand": 1.5})


@pytest.mark.parametrize("name", NAMES)
def test_invalid_interpretations_are_rejected_by_name(name):
    allowed = ", ".join(sorted(INTERPRETATION_CHOICES[name]))
    for make in (lambda r: Snow(interpretation=r), lambda r: Interpretation(**r)):
        with pytest.raises(ValueError, match=f"interpretation.{name} = 'neither': .*{allowed}"):
            make({name: "neither"})
    with pytest.raises(ValueError, match=f"did you mean {name}"):
        Snow(interpretation={f"{name}x": INTERPRETATION_CHOICES[name][0]})


def test_interpretation_sets_have_names():
    defaults = {name: INTERPRETATION_CHOICES[name][0] for name in NAMES}
    assert Interpretation.from_input("splits_2007").as_dict() == defaults
    assert Snow().interpretation == Interpretation() == Interpretation.from_input("splitsnow_2021")
    assert Interpretation().as_dict() == defaults | {
        "facet_sampling": "any",
        "wrong_side_ray": "mirror",
    }
    modified = Interpretation.from_input({"set": "geometric", "facet_sampling": "any"})
    assert (modified.entry_point, modified.facet_sampling) == ("projected", "any")
    with pytest.raises(ValueError, match=r"interpretation\.set = 'geo'.*geometric"):
        Interpretation.from_input({"set": "geo"})


def test_interpretations_are_merged_in_sequence():
    assert merge_interpretations(["geometric"]) == "geometric"
    assert merge_interpretations(["geometric", {"facet_sampling": "any"}]) == {
        "set": "geometric",
        "facet_sampling": "any",
    }
    assert merge_interpretations([{"facet_sampling": "any"}, "splits_2007"]) == "splits_2007"
    assert merge_interpretations([{"facet_sampling": "any"}, {"entry_point": "projected"}, {}]) == {
        "facet_sampling": "any", "entry_point": "projected",
    }  # fmt: skip


def test_snow_is_immutable():
    snow = Snow()
    with pytest.raises(AttributeError):
        snow.saturation = 0.5
    assert snow.saturation == 0.05


def test_refractive_indices_of_air_water_and_ice():
    index = Snow(refractive_index={"ice": 1.31 + 1e-3j, "water": 1.33}).compute_refractive_indices(
        [500.0, 900.0]
    )
    np.testing.assert_array_equal(index, [[1.0, 1.33, 1.31 + 1e-3j]] * 2)
    dry = Snow(saturation=0, refractive_index={"ice": 1.31}).compute_refractive_indices([500.0])
    np.testing.assert_array_equal(dry, [[1.0, 1.0, 1.31]])
    assert len(Snow().list_materials()) == index.shape[1]


def test_description_contains_every_input():
    attributes = Snow(refractive_index={"water": 1.33}).describe()
    assert {
        f
        for f in Snow.__dataclass_fields__
        if f not in ("refractive_index", "interpretation", "pores") and "impurities" not in f
        if f != "algae_cells_ml"
    } <= (set(attributes))
    assert attributes["refractive_index_ice"] == "warren_brandt_2008"
    assert attributes["refractive_index_water"] == "1.33+0j"
    assert {f"interpretation_{name}" for name in NAMES} <= set(attributes)
