"""Snow: defaults, measured quantities, derived quantities, statistics of grains, and errors."""

import math
from dataclasses import fields

import numpy as np
import pytest
from scipy import integrate
from shipped import CONFIG

import splits
from splits import Interpretation, Snow
from splits.core.validation import ConfigError
from splits.experiments.config.load import load_experiment
from splits.materials import ice_density
from splits.media.grain_statistics import (
    compute_shape_attenuation,
    surface_to_volume_ratio,
    tabulate_hit_inverse_sizes,
    tabulate_hit_sphericities,
    tabulate_truncated_normal,
)
from splits.media.interpretations import INTERPRETATION_CHOICES, merge_interpretations
from splits.media.kinds import check_medium, read_named_medium
from splits.media.parameters import override_keywords
from splits.media.snow import NATURAL_GRAIN_SHAPE

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


def test_indices_of_unknown_materials_are_rejected():
    with pytest.raises(ValueError, match=r"refractive_index = 'sand'.*ice, water"):
        Snow(refractive_index={"sand": 1.5})


@pytest.mark.parametrize("name", NAMES)
def test_invalid_interpretations_are_rejected_by_name(name):
    allowed = ", ".join(sorted(INTERPRETATION_CHOICES[name]))
    message = f"{name} = 'neither': must be one of {allowed}"
    with pytest.raises(ValueError, match=f"^interpretation.{message}"):
        Snow(interpretation={name: "neither"})
    with pytest.raises(ValueError, match=f"^{message}"):
        Interpretation(**{name: "neither"})
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


MEDIA = CONFIG / "media"


@pytest.mark.parametrize("area", [0.25, 5.0, 20.0, 60.0, 1900.0])
def test_grain_sizes_have_the_given_surface_area(area):
    for snow in (
        splits.Snow.natural(specific_surface_area_m2_kg=area),
        splits.Snow(specific_surface_area_m2_kg=area, temperature_c=-20.0),
    ):
        assert snow.specific_surface_area_m2_kg == pytest.approx(area, rel=1e-12)
        assert snow.grain_size_um[1] / snow.grain_size_um[0] == pytest.approx(2.5)
        same = splits.Snow(
            optical_radius_um=snow.optical_radius_um, sphericity=snow.sphericity,
            temperature_c=snow.temperature_c,
        )  # fmt: skip
        assert same.grain_size_um == pytest.approx(snow.grain_size_um)


def test_liquid_water_content_sets_the_saturation():
    snow = splits.Snow(liquid_water_content=0.02, density_kg_m3=400)
    assert snow.liquid_water_content == pytest.approx(0.02)
    assert snow.saturation == pytest.approx(0.02 / snow.porosity)


def test_natural_snow_is_semi_infinite_and_dry():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    assert snow.depth_m == math.inf and snow.saturation == 0.0
    assert snow.interpretation == splits.Interpretation.from_input("radiative_transfer")
    assert snow.refractive_index["water"].name == "segelstein_1981"
    assert "picard" in snow.refractive_index["ice"].name
    attributes = snow.describe()
    assert (
        attributes["absorption_enhancement_900nm_dry"] == NATURAL_GRAIN_SHAPE.absorption_enhancement
    )
    assert attributes["optical_radius_um"] == pytest.approx(3e6 / (916.9 * 20), rel=1e-3)
    for changed in (
        {"facetness": (0.1, 0.1, 0.1, 0)},
        {"interpretation": {"facet_sampling": "any"}},
    ):
        modified = splits.Snow.natural(specific_surface_area_m2_kg=20, **changed)
        assert "absorption_enhancement_900nm_dry" not in modified.describe()
    assert modified.interpretation.entry_point == "projected"
    custom = splits.Snow.natural(specific_surface_area_m2_kg=20, refractive_index={"ice": 1.31})
    assert custom.refractive_index["water"].name == "segelstein_1981"


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: splits.Snow.natural(), ValueError, "area_m2_kg = None: must be given"),
        (lambda: splits.Snow.natural(ssa=20), TypeError, "mean specific_surface_area_m2_kg"),
        (lambda: splits.Snow(ssa=20), TypeError, "mean specific_surface_area_m2_kg"),
        (lambda: splits.Snow(grain_size=3), TypeError, "mean grain_size_um"),
        (lambda: splits.Snow(lwc=0.1), TypeError, "mean liquid_water_content"),
        (
            lambda: splits.Snow(specific_surface_area_m2_kg=20, grain_size_um=(100, 200)),
            ValueError, "left out where specific_surface_area_m2_kg is given",
        ),
        (
            lambda: splits.Snow((100, 200), optical_radius_um=100),
            ValueError, "left out where grain_size_um is given",
        ),
        (
            lambda: splits.Snow(saturation=0.1, liquid_water_content=0.1),
            ValueError, "left out where saturation is given",
        ),
        (lambda: splits.Snow(liquid_water_content=0.9), ValueError, r"in \[0, 0.70"),
        (lambda: splits.Snow(specific_surface_area_m2_kg=0.1), ValueError, r"\[0.2, 2000\]"),
        (lambda: splits.Snow(optical_radius_um="a"), ValueError, "optical_radius_um = 'a'"),
        (
            lambda: splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=0.25),
            ValueError, r"\[10, 916.9\d*\) kg/m3 \(in g/cm3\? write 250; ice at",
        ),
        (
            lambda: splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=950),
            ValueError, r"\[10, 916.9\d*\) kg/m3",
        ),
        (
            lambda: splits.Snow.natural(
                specific_surface_area_m2_kg=20, density_kg_m3=300, temperature_c=5
            ),
            ValueError, "temperature_c = 5",
        ),
        (lambda: splits.Snow(density_kg_m3=2750), ValueError, r"kg/m3 \(ice at -1 °C has 916\.9\)"),
        (
            lambda: splits.Snow.natural(
                optical_radius_um=90, interpretation={"overlap_with_boundary": "skip"}
            ),
            ValueError, "overlap_with_boundary = 'skip': must be keep with grain_extent point",
        ),
    ],
)  # fmt: skip
def test_invalid_input_is_rejected_in_one_line(make, error, message):
    with pytest.raises(error, match=message) as error_info:
        make()
    assert "\n" not in str(error_info.value)


def test_alternative_keywords_override_those_of_the_base():
    base = {"grain_size_um": (1, 2), "saturation": 0.1, "depth_m": 1}
    merged = override_keywords(base, {"optical_radius_um": 3, "depth_m": 2})
    assert merged == {"saturation": 0.1, "optical_radius_um": 3, "depth_m": 2}


def load_text(folder, text):
    path = folder / "made.yaml"
    path.write_text(text)
    return [medium for _, medium, _ in load_experiment(path, MEDIA).iter_points()]


def test_natural_snow_in_experiment_files(tmp_path):
    text = (
        "medium: {kind: natural_snow, depth_m: 1, optical_radius_um: 100}\n"
        "grid: {specific_surface_area_m2_kg: [10, 20]}\ninstrument: {wavelength_nm: [500]}\n"
    )
    with pytest.raises(ConfigError, match=r"medium.optical_radius_um = 100: must be left out"):
        load_text(tmp_path, text)
    media = load_text(tmp_path, text.replace(", optical_radius_um: 100", ""))
    assert [medium.specific_surface_area_m2_kg for medium in media] == pytest.approx([10, 20])
    assert all(
        medium.interpretation == splits.Interpretation.from_input("radiative_transfer")
        for medium in media
    )
    text = (
        "medium: {base: splitsnow_table1, interpretation: geometric}\n"
        "grid: {liquid_water_content: [0, 0.1], interpretation: {same: {}, "
        "other: {facet_sampling: any}, paper: splitsnow_2021}}\n"
        "instrument: {wavelength_nm: [500]}\n"
    )
    media = load_text(tmp_path, text)
    assert media[3].liquid_water_content == pytest.approx(0.1)
    interpretations = [medium.interpretation for medium in media[:3]]
    assert [(medium.entry_point, medium.facet_sampling) for medium in interpretations] == [
        ("projected", "projected"), ("projected", "any"), ("uniform", "any"),
    ]  # fmt: skip
    with pytest.raises(ConfigError, match=r"medium.ssa: unknown key.*specific_surface_area_m2_kg"):
        load_text(tmp_path, "medium: {kind: natural_snow, ssa: 20}\n")
    with pytest.raises(
        ConfigError, match=r"medium.kind = 'natural_snow': must be snow, as its base"
    ):
        load_text(tmp_path, "medium: {base: splitsnow_table1, kind: natural_snow, ssa: 20}\n")
    stack_text = "medium: {kind: stack, layers: [{kind: natural_snow, optical_radius_um: 90}]}\n"
    (stack,) = load_text(tmp_path, stack_text + "instrument: {wavelength_nm: [500]}\n")
    assert stack.layers[0].optical_radius_um == pytest.approx(90.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda **ground: splits.Snow.natural(specific_surface_area_m2_kg=20, **ground),
        lambda **ground: splits.Snow(depth_m=math.inf, **ground),
        lambda **ground: splits.Sand(depth_m=math.inf, **ground),
        lambda **ground: splits.Stack([splits.Snow(depth_m=math.inf)], **ground),
        lambda **ground: splits.Stack(
            [splits.ParticleLayer(optical_thickness=math.inf, ground=None)], **ground
        ),
    ],
)
@pytest.mark.parametrize("ground", [1.0, 0.0, "black", "camborthid"])
def test_no_ground_is_below_an_infinite_depth(make, ground):
    with pytest.raises(ValueError, match=r"^ground = .*must be left out \(no light reaches it"):
        make(ground=ground)
    assert make(ground="open").ground is None


TABLE1 = (0.6, 0.95, 0.798, 0.064)


@pytest.mark.parametrize(
    ("temperature", "density"),
    [(-40, 922.8), (-30, 921.6), (-20, 920.3), (-10, 918.7), (0, 916.7), (-1, 916.9), (-5, 917.7)],
)
def test_ice_density_at_and_between_tabulated_temperatures(temperature, density):
    assert ice_density(temperature) == pytest.approx(density, rel=1e-12)


@pytest.mark.parametrize("temperature", [-40.1, 0.1, float("nan"), None])
def test_ice_density_outside_the_table_is_rejected(temperature):
    with pytest.raises(ValueError, match=r"temperature_c = .*\[-40, 0\]"):
        ice_density(temperature)


@pytest.mark.parametrize("psi", [0.1, 0.5, 0.8, 0.99])
def test_surface_to_volume_of_a_prolate_spheroid(psi):
    # Surface of revolution of an ellipse with semi-axes 1/2 and ψ²/2, by quadrature.
    a, b = 0.5, 0.5 * psi**2
    surface = integrate.quad(
        lambda t: 2.0 * math.pi * b * math.sin(t) * math.hypot(a * math.sin(t), b * math.cos(t)),
        0.0,
        math.pi,
        epsabs=0.0,
        epsrel=1e-11,
    )[0]
    volume = 4.0 / 3.0 * math.pi * a * b * b
    assert float(surface_to_volume_ratio(psi)) == pytest.approx(surface / volume, rel=1e-9)


@pytest.mark.parametrize("limits", [(0.6, 0.9, 0.8, 0.0), (0.8, 0.8, 0.8, 0.1)])
def test_degenerate_distributions_give_one_shape(limits):
    assert compute_shape_attenuation(*limits) == pytest.approx(
        float(surface_to_volume_ratio(0.8)) / 4.0
    )
    assert (tabulate_hit_sphericities(*limits) == 0.8).all()
    assert (tabulate_truncated_normal(*limits) == 0.8).all()


@pytest.mark.parametrize("table", [tabulate_hit_sphericities, tabulate_truncated_normal])
def test_quantiles_increase_within_their_limits(table):
    psi = table(*TABLE1)
    assert (np.diff(psi) > 0.0).all()
    assert psi[0] == pytest.approx(TABLE1[0])
    assert psi[-1] == pytest.approx(TABLE1[1])


@pytest.mark.parametrize("weighting", ["cross_section", "uniform"])
def test_inverse_sizes_increase_between_the_limits(weighting):
    inverse = tabulate_hit_inverse_sizes(3e-4, 7.5e-4, weighting)
    assert (np.diff(inverse) > 0.0).all()
    assert 1.0 / inverse[[0, -1]] == pytest.approx([7.5e-4, 3e-4])


def test_hit_grains_are_more_elongated_on_average():
    assert (
        tabulate_hit_sphericities(*TABLE1)[1:-1] < tabulate_truncated_normal(*TABLE1)[1:-1]
    ).all()
