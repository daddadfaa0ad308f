"""Snow by measured quantities: surface area, optical radius and liquid water content."""

from __future__ import annotations

import math

import pytest
from shipped import CONFIG

import splits
from splits.core.validation import ConfigError
from splits.experiments.config.load import load_experiment
from splits.media.snow import NATURAL_GRAIN_SHAPE, override_keywords

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
            [splits.ParticleLayer(optical_thickness=math.inf, bottom_albedo=None)], **ground
        ),
    ],
)
@pytest.mark.parametrize("ground", [1.0, 0.0, "black", "camborthid"])
def test_no_ground_is_below_an_infinite_depth(make, ground):
    with pytest.raises(ValueError, match=r"^ground = .*must be left out \(no light reaches it"):
        make(ground=ground)
    assert make(ground="open").ground is None
