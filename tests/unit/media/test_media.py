"""All media: names, parameters, representations, stacks of layers, and the ground below."""

import copy
import hashlib
import json
import math
import pickle
import random
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import splits
from splits.core.validation import ConfigError, InvalidValue
from splits.core.yaml import dump_yaml
from splits.experiments import load_experiment
from splits.illumination.bands import SpectralBand
from splits.io.netcdf import to_netcdf_attributes
from splits.media.ground import BLACK_OPTICAL_DEPTH, Ground, load_soils
from splits.media.interpretations import INTERPRETATION_SETS
from splits.media.kinds import NAMED_MEDIA, NAMED_MEDIA_FOLDER, check_medium, read_named_medium
from splits.media.parameters import list_parameters, replace_parameter, replace_parameters
from splits.media.rough_surface import RandomHeightField
from splits.simulation.scene import build_scene
from splits.simulation.spectral_nodes import choose_nodes

SETTINGS_DIGESTS = {
    "splits_base": "b179755d90d5fcce",
    "splitsnow_table1": "45a550017c20abe1",
    "tec_10019201": "2d035e2b36fe3f5f",
    "tec_10039240": "e0d22a0a7d8ac201",
    "tec_13j9823": "97837251785c7f7b",
    "tec_19au9815": "746bb669accda8bf",
}
"""Digests of the samples of the papers, which published results depend on."""
CORE_PROGRAM = """
import sys
sys.modules |= dict.fromkeys(["yaml", "colour", "matplotlib", "scipy"])
import splits
for name in splits.list_media():
    print(name, splits.load_medium(name))
try:
    splits.load_medium("mine.yaml")
except ModuleNotFoundError as error:
    print(error)
"""


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_named_media_are_described_and_equal_their_representation(name):
    medium = splits.load_medium(name)
    same = eval(repr(medium), {"Snow": splits.Snow, "Sand": splits.Sand})
    assert repr(same) == repr(medium)
    assert to_netcdf_attributes(medium.describe())
    assert medium.kind == read_named_medium(name)["kind"]
    assert splits.list_media()[name]


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_named_media_state_their_source(name):
    text = (NAMED_MEDIA_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    is_sample = name in SETTINGS_DIGESTS
    assert ('source = "illustrative: ' in text) != is_sample
    assert "(2007)" in text or "(2021)" in text


@pytest.mark.parametrize("name", SETTINGS_DIGESTS)
def test_samples_of_the_papers_are_unchanged(name):
    content = json.dumps(read_named_medium(name), sort_keys=True)
    assert hashlib.sha256(content.encode()).hexdigest()[:16] == SETTINGS_DIGESTS[name]


def test_named_media_need_no_extra():
    done = subprocess.run([sys.executable, "-c", CORE_PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *lines, missing = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(NAMED_MEDIA)
    assert "pip install '.[experiments]' in a copy of the repository" in missing


def test_keywords_replace_values():
    beach = splits.load_medium("wet_beach", saturation=0.25, depth_m=0.2)
    assert (beach.saturation, beach.depth_m, beach.magnetite) == (0.25, 0.2, 0.01)
    snow = splits.load_medium("splitsnow_table1", optical_radius_um=100)
    assert snow.optical_radius_um == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("name", "keywords", "message"),
    [
        ("red_dunes", {}, r"name = 'red_dunes': must be one of .*did you mean red_dune\?"),
        (3, {}, "name = 3: must be one of black_magnetite"),
        ("red_dune", {"saturation": 2}, r"saturation = 2: must be in \[0, 1\]"),
        ("red_dune", {"saturatoin": 0}, r"saturatoin: unknown key.*did you mean saturation\?"),
        ("red_dune", {"kind": "snow"}, "kind: unknown key"),
    ],
)
def test_invalid_names_and_keywords_are_rejected(name, keywords, message):
    with pytest.raises((InvalidValue, TypeError), match=message) as error:
        splits.load_medium(name, **keywords)
    assert "\n" not in str(error.value)


# --- files of users -------------------------------------------------------------------------------

STACK = "kind: stack\nground: 0.2\nlayers: [{depth_m: 0.1}, {kind: particle_layer, depth_m: 1}]\n"


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_media_in_yaml_files_equal_named_media(name, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(dump_yaml(read_named_medium(name)), encoding="utf-8")
    assert splits.load_medium(path) == splits.load_medium(name)


def test_yaml_files_may_hold_any_kind_of_medium(tmp_path):
    path = tmp_path / "mine.yml"
    path.write_text(STACK, encoding="utf-8")
    stack = splits.load_medium(str(path), ground="black")
    assert [layer.kind for layer in stack.layers] == ["snow", "particle_layer"]
    path.write_text("kind: natural_snow\noptical_radius_um: 100\n", encoding="utf-8")
    assert splits.load_medium(path) == splits.Snow.natural(optical_radius_um=100)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: ice\n", r"kind = 'ice': must be one of natural_snow, .*stack"),
        ("kind: stack\n", "layers = None: must be a list of layers, top first"),
        (STACK.replace("particle_layer", "ice"), r"layers\.1\.kind = 'ice': must be one of"),
        (STACK.replace("0.1", "-1"), r"layers\.0\.depth_m = -1: must be"),
        (f"{STACK}cover: 1\n", "cover: unknown key, must be one of layers, ground"),
        ("iron_oxide: 0.1\n", "iron_oxide: unknown key"),
        ("- 1\n", r"mine\.yaml: must be a mapping"),
    ],
)
def test_invalid_files_are_rejected(text, message, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises((ValueError, TypeError), match=message):
        splits.load_medium(path)


# --- experiments ----------------------------------------------------------------------------------


def test_experiments_use_named_media_and_own_files(tmp_path):
    media = tmp_path / "media"
    path = tmp_path / "both.yaml"
    path.write_text(
        "medium: {kind: sand}\ninstrument: {wavelength_nm: [500]}\n"
        "grid: {medium: {a: red_dune, b: {base: red_dune, saturation: 0.5}}}\n", encoding="utf-8"
    )  # fmt: skip
    points = [medium for _, medium, _ in load_experiment(path, media).iter_points()]
    assert points == [splits.load_medium("red_dune", saturation=s) for s in (0, 0.5)]
    media.mkdir()
    (media / "mine.yaml").write_text("kind: sand\niron_oxide: 0.02\n", encoding="utf-8")
    path.write_text(path.read_text("utf-8").replace("a: red_dune", "a: mine"), encoding="utf-8")
    points = [medium for _, medium, _ in load_experiment(path, media).iter_points()]
    assert points[0] == splits.load_medium(media / "mine.yaml")


def test_own_files_with_the_name_of_a_named_medium_are_rejected(tmp_path):
    (tmp_path / "red_dune.yaml").write_text("kind: sand\n", encoding="utf-8")
    path = tmp_path / "experiment.yaml"
    path.write_text("medium: {base: red_dune}\n", encoding="utf-8")
    message = (
        r"medium\.base = 'red_dune': must be the name of one medium only \(.*rename .*red_dune"
    )
    with pytest.raises(ConfigError, match=message) as error:
        load_experiment(path, tmp_path)
    assert "\n" not in str(error.value)


VALUES = {
    "specific_surface_area_m2_kg": 30.0, "optical_radius_um": 200.0, "liquid_water_content": 0.03,
    "impurities_ng_g.black_carbon": 50.0, "impurities_ng_g.dust_sahara": 7.0,
    "density_kg_m3": 350.0, "depth_m": 0.2, "facetness": 0.1, "saturation": 0.1,
    "temperature_c": -5.0,
}  # fmt: skip


def make_snow():
    return splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.1, liquid_water_content=0.02,
        impurities_ng_g={"black_carbon": 5.0},
    )  # fmt: skip


def replace_in_turn(medium, values):
    for name, value in values.items():
        medium = replace_parameter(medium, name, value)
    return medium


@pytest.mark.parametrize("seed", range(30))
def test_parameters_of_snow_are_replaced_in_any_order(seed):
    names = random.Random(seed).sample(list(VALUES), 2 + seed % 6)
    values = {name: VALUES[name] for name in names}
    assert replace_parameters(make_snow(), values) == replace_in_turn(make_snow(), values)


@pytest.mark.parametrize("seed", range(10))
def test_parameters_of_stacks_are_replaced_in_any_order(seed):
    stack = splits.Stack([make_snow(), make_snow()], ground=0.3)
    names = [f"layers.{number}.{name}" for number in (0, 1) for name in VALUES]
    names = random.Random(seed).sample([*names, "ground"], 6)
    values = {name: VALUES.get(name.split(".", 2)[-1], 0.5) for name in names}
    assert replace_parameters(stack, values) == replace_in_turn(stack, values)


def test_fractions_keep_their_sum():
    sand = splits.Sand()
    values = {"partition.coated": 0.3, "partition.pure": 0.2}
    assert set(values) <= set(list_parameters(sand))
    changed = replace_parameters(sand, values)
    assert changed == replace_in_turn(sand, values)
    assert sum(changed.partition) == pytest.approx(1.0)


WAVES = {"rms_height_m": 0.01, "wave_number_per_m": 50, "correlation": "gaussian"}
LIMITED_NORMAL = {"rms_height_m": 0.02, "wave_number_per_m": 50, "band_limit_per_m": 1000}
CALLS = [
    "Snow()",
    "Snow(specific_surface_area_m2_kg=18.3389)",
    "Snow(optical_radius_um=100, temperature_c=-10, depth_m=inf)",
    "Snow(liquid_water_content=0.1)",
    "Snow(saturation=0.1, ground='camborthid')",
    "Snow(grain_size_um=(100, 250))",
    "Snow(grain_size_um=(1000, 2500), interpretation='geometric')",
    "Snow(interpretation={'facet_sampling': 'projected'}, ground='black')",
    "Snow(refractive_index={'ice': 'warren_brandt_2008_picard_2016'}, ground=0.2)",
    "Snow(specific_surface_area_m2_kg=0.3, facetness=(0, 0, 0, 0))",
    "Snow.natural(specific_surface_area_m2_kg=40, depth_m=1, impurities_ng_g={'dust_sahara': 5})",
    "Snow.natural(optical_radius_um=163.6, saturation=0.1)",
    "Snow.natural(grain_size_um=(100, 200), refractive_index={'ice': '1.31+0j'})",
    "Sand()",
    "Sand(iron_oxide=0.02, partition=(0, 1, 0), interpretation={'water': 'film'})",
    "Sand(interpretation='geometric')",
    "ParticleLayer()",
    "ParticleLayer(optical_thickness=inf, ground=None, polarized=True)",
    f"ParticleLayer(surface={WAVES})",
    f"RoughSurface([{WAVES}, {LIMITED_NORMAL}])",
    "Interpretation.from_input('splitsnow_2021')",
    "Interpretation.from_input({'facet_sampling': 'projected'})",
    "SandInterpretation.from_input('splits_2007')",
    "Ground.from_input('quartzipsamment')",
    "Ground.from_input(0.25)",
    "Ground.from_input('black')",
    "Stack([\n"
    "    Snow.natural(specific_surface_area_m2_kg=40, depth_m=0.1),\n"
    "    Snow.natural(optical_radius_um=200, density_kg_m3=350, depth_m=0.3),\n"
    "], ground='camborthid')",
    "Stack([\n    Snow(depth_m=0.01, interpretation='geometric'),\n"
    "    ParticleLayer(ground=None),\n], interpretation='geometric')",
]
NAMES = {name: getattr(splits, name) for name in splits.__all__} | {
    "Ground": Ground,
    "inf": math.inf,
}


@pytest.mark.parametrize("call", CALLS)
def test_repr_is_the_constructing_call(call):
    obj = eval(call, NAMES)
    text = repr(obj)
    assert eval(text, NAMES).__class__ is obj.__class__
    assert sorted(text) == sorted(call)
    assert repr(eval(text, NAMES)) == text == repr(copy.deepcopy(obj))
    assert repr(pickle.loads(pickle.dumps(obj))) == text


def test_repr_keeps_the_surface_area_of_modified_snow():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=40, depth_m=0.1)
    assert repr(replace(snow, depth_m=1)) == (
        "Snow.natural(specific_surface_area_m2_kg=40, depth_m=1)"
    )
    assert "specific_surface_area_m2_kg=12," in repr(
        replace_parameter(snow, "specific_surface_area_m2_kg", 12)
    )
    text = repr(
        splits.Stack([splits.Snow(specific_surface_area_m2_kg=9)], interpretation="geometric")
    )
    assert "    Snow(specific_surface_area_m2_kg=9, interpretation='geometric'),\n" in text


def test_repr_of_tables_is_short():
    w = np.arange(300.0, 1001.0)
    table = {"wavelength_nm": w, "albedo": np.full(w.size, 0.2)}
    spectrum = {"wave_number_per_m": w.tolist(), "density": w.tolist()}
    for obj in (
        splits.Snow(ground=table),
        Ground.from_input(table),
        splits.Snow(refractive_index={"ice": {"wavelength_nm": w, "n": w / w, "k": 0.0 * w}}),
        splits.ParticleLayer(
            phase_function={"cosine": np.linspace(-1, 1, 900), "density": np.ones(900)}
        ),
        RandomHeightField(0.1, correlation="spectrum", spectrum=spectrum),
        splits.sky({"wavelength_nm": w, "direct": w, "diffuse": w}, zenith_deg=50),
        splits.sky("midlatitude_winter"),
        SpectralBand(w, w),
    ):
        assert "\n" not in repr(obj) and len(repr(obj)) < 200
    assert repr(splits.Snow(ground=table)) == (
        "Snow(ground={'wavelength_nm': [300, ..., 1000], 'albedo': [0.2, ..., 0.2]})"
    )


def test_repr_of_skies_names_their_source():
    assert repr(splits.sky("midlatitude_winter", 50)) == (
        "Sky('midlatitude_winter', zenith_deg=50, 305 to 3995 nm: "
        "SNICAR-ADv3 (Flanner et al. 2021))"
    )
    pytest.importorskip("pvlib")
    clear = repr(splits.sky("clear", 30, turbidity_500nm=0.2))
    assert clear.startswith("Sky('clear', zenith_deg=30, 300 to 4000 nm: Bird & Riordan")
    assert "turbidity_500nm 0.2" in clear and "\n" not in clear


FRESH_SNOW = splits.Snow(grain_size_um=(50, 100), density_kg_m3=120, saturation=0.0, depth_m=0.02)
SAND = splits.Sand(hematite_ratio=0.5, magnetite=0.05, depth_m=0.1)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ([], "1 to 200"),
        (FRESH_SNOW, "a list of media, top first"),
        ("snow", "a list of media, top first"),
        ([FRESH_SNOW, 3], r"layers\[1\] = 3: must be splits.Snow"),
        ([FRESH_SNOW, splits.Snow], r"layers\[1\]"),
        ([FRESH_SNOW, splits.RoughSurface], r"layers\[1\]"),
        (
            [FRESH_SNOW, splits.Snow(interpretation={"entry_point": "projected"})],
            r"layers\[1\].interpretation .*those of layers\[0\]",
        ),
    ],
)
def test_invalid_layers_are_rejected_by_number(layers, message):
    with pytest.raises(ValueError, match=message):
        splits.Stack(layers)


@pytest.mark.parametrize(
    "medium",
    [
        splits.Snow(depth_m=0.0005),
        splits.Sand(depth_m=0.002),
        splits.Stack([splits.Snow(depth_m=0.0003), splits.Snow(depth_m=0.0004)]),
    ],
)
def test_samples_thinner_than_a_grain_are_rejected(medium):
    with pytest.raises(ValueError, match=r"depth_m = .*more than the largest grain"):
        check_medium(medium)


def test_thin_layers_are_accepted_in_a_thick_stack():
    check_medium(splits.Stack([splits.Snow(depth_m=1e-7), splits.Snow()]))


def test_layers_keep_order_types_and_materials():
    stack = splits.Stack([FRESH_SNOW, SAND, splits.Snow()], interpretation="splits_2007")
    scene = build_scene(stack, 30.0, False)
    assert scene.layers.boundaries == pytest.approx([0.0, -0.02, -0.12, -0.24])
    assert stack.depth_m == pytest.approx(0.24)
    sand = SAND.make_grain_population()
    n_types = len(sand.type_cdf)
    assert list(scene.layers.first_type) == [0, 1, 1 + n_types]
    assert np.all(scene.layers.type_cdf[0] == 1.0)
    assert np.array_equal(scene.layers.type_cdf[1], sand.type_cdf)
    assert all(table.flags.c_contiguous for table in scene.types)
    names = stack.list_materials()
    assert names[:3] == ("layers.0.air", "layers.0.water", "layers.0.ice")
    for number, medium in enumerate(stack.layers):
        first, pore = scene.layers.first_type[number], scene.layers.first_pore_material[number]
        types = medium.make_grain_population().types
        for grain_type, shells in enumerate(types.n_shells):
            assert scene.types.n_shells[first + grain_type] == shells
            for shell in range(shells):
                row = scene.types.material[first + grain_type, shell]
                material = medium.list_materials()[types.material[grain_type, shell]]
                assert names[row] == f"layers.{number}.{material}"
        assert names[pore] == f"layers.{number}.{medium.list_materials()[0]}"
    wavelengths = np.array([450.0, 900.0])
    index = stack.compute_refractive_indices(wavelengths)
    assert index.shape == (2, len(names))
    assert np.array_equal(index[:, :3], FRESH_SNOW.compute_refractive_indices(wavelengths))


def test_interpolation_bound_covers_every_layer():
    wavelengths = np.arange(400.0, 1001.0, 20.0)
    for order in ([FRESH_SNOW, SAND], [SAND, FRESH_SNOW]):
        stack = splits.Stack(order, interpretation="splits_2007")
        nodes = choose_nodes(
            stack.compute_refractive_indices(wavelengths), stack.list_interfaces(), 1e-3
        )
        single = choose_nodes(
            SAND.compute_refractive_indices(wavelengths), SAND.list_interfaces(), 1e-3
        )
        assert len(nodes.index) >= len(single.index)
        assert nodes.interpolation_bound.max() <= 1e-3


def test_description_contains_all_inputs():
    attributes = splits.Stack([FRESH_SNOW, splits.Snow()]).describe()
    assert attributes["layers_0_grain_size_um"] == (50.0, 100.0)
    assert attributes["layers_1_grain_size_um"] == (300.0, 750.0)
    assert attributes["layers_1_kind"] == "snow"


@pytest.mark.parametrize("above", [True, False])
def test_wet_pores_have_boundaries_with_particle_matrices(above):
    layer = splits.ParticleLayer(refractive_index=1.5, depth_m=0.01, ground=None)
    snow = splits.Snow(saturation=0.25)
    stack = splits.Stack([layer, snow] if above else [snow, layer])
    names = stack.list_materials()
    boundaries = [i for i in stack.list_interfaces() if i.location == "boundary"]
    named = {(names[i.outer_material], names[i.inner_material], i.fraction) for i in boundaries}
    assert (f"layers.{1 - above}.matrix", f"layers.{1 * above}.water", 0.25) in named


def test_a_named_set_replaces_the_interpretation_of_layers():
    natural = splits.Snow.natural(optical_radius_um=100, depth_m=0.1)
    for name in INTERPRETATION_SETS:
        (layer,) = splits.Stack([natural], interpretation=name).scene_layers
        assert layer.interpretation == splits.Interpretation.from_input(name)


def test_layers_must_have_the_same_free_path_model():
    snow = {"optical_radius_um": 100, "depth_m": 0.1}
    other = splits.Snow.natural(**snow, interpretation={"mean_free_path": "pore_only"})
    with pytest.raises(ValueError, match=r"layers\[1\].interpretation"):
        splits.Stack([splits.Snow.natural(**snow), other])


def test_incompatible_attenuation_factor_is_rejected():
    message = "attenuation_factor = 'as_printed': must be solid_fraction"
    with pytest.raises(ValueError, match=message):
        splits.Sand(
            interpretation={"set": "radiative_transfer", "attenuation_factor": "as_printed"}
        )


W = np.array([450.0, 500.0, 900.0])


def test_a_number_is_a_constant_albedo():
    np.testing.assert_array_equal(Ground.from_input(0.3).albedo(W), 0.3)
    np.testing.assert_allclose(Ground.from_input(0.3).optical_depth(W), -np.log(0.3))
    assert Ground.from_input(1).optical_depth(W).max() == 0.0
    np.testing.assert_array_equal(Ground.from_input(0).optical_depth(W), BLACK_OPTICAL_DEPTH)


@pytest.mark.parametrize("value", [None, "open"])
def test_open_means_no_ground(value):
    assert Ground.from_input(value) is None
    assert splits.Snow(ground=value).describe()["ground"] == "open"


def test_black_ground_does_not_reflect():
    assert not Ground.from_input("black").is_reflecting and not Ground.from_input(0.0).is_reflecting
    assert Ground.from_input(1e-9).is_reflecting


def test_tables_are_interpolated_linearly():
    ground = Ground.from_input({"wavelength_nm": [400, 500, 1000], "albedo": [0.0, 0.2, 0.7]})
    np.testing.assert_allclose(ground.albedo(W), [0.1, 0.2, 0.6])
    attributes = splits.Snow(ground=ground).describe()
    assert attributes["ground"] == "table" and attributes["ground_albedo"][2] == 0.7


def test_soils_have_names_and_a_source():
    assert "camborthid" in load_soils()
    soil = Ground.from_input("camborthid")
    assert "ECOSTRESS" in soil.source and 0.0 < soil.albedo(W)[0] < soil.albedo(W)[2] < 1.0
    with pytest.raises(ValueError, match=r"in \[400, 1000\] nm, the range of ground camborthid"):
        soil.albedo(np.array([1200.0]))


def test_files_are_identified_by_content(tmp_path):
    path = tmp_path / "field.csv"
    path.write_text("# mine\nwavelength_nm, albedo\n400, 0.1\n1000, 0.3\n")
    ground = splits.Sand(ground=path).ground
    assert ground.albedo(np.array([700.0])) == pytest.approx(0.2)
    attributes = splits.Sand(ground=str(path)).describe()
    assert attributes["ground"] == "field.csv" and len(attributes["ground_sha256"]) == 64


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1.5, r"ground = 1.5: must be in \[0, 1\]"),
        (True, "ground = True: must be open, black"),
        ("blak", r"did you mean black\?"),
        ("chalk", "soils: quartzipsamment"),
        ("mine.csv", "an existing CSV file"),
        ({"albedo": [0.1]}, "a mapping of wavelength_nm, albedo"),
        ({"wavelength_nm": [400, 500], "albedo": [0.1]}, "2 wavelength_nm, 1 albedo"),
        ({"wavelength_nm": [500, 400], "albedo": [0.1, 0.2]}, "strictly increasing"),
        ({"wavelength_nm": [400, 500], "albedo": [0.1, 1.2]}, r"ground.albedo = 1.2"),
    ],
)
def test_invalid_grounds_are_rejected(value, message):
    with pytest.raises(ValueError, match=message):
        splits.Snow(ground=value)


def test_instruments_for_transmitted_light_reject_a_ground():
    snow = splits.Snow(depth_m=0.01, ground=0.5)
    with pytest.raises(ValueError, match="target = 'btdf': must be brdf over a ground"):
        splits.goniophotometer(snow, 500.0, target="btdf")


def test_particle_layers_have_a_ground_of_their_own_outside_of_stacks():
    layer = splits.ParticleLayer()
    assert layer.describe() == splits.ParticleLayer(ground=0.5).describe()
    assert layer.describe()["ground"] == "albedo 0.5"
    for one in (layer, copy.deepcopy(layer), pickle.loads(pickle.dumps(layer))):
        stack = splits.Stack([one, splits.Snow()], ground="black")
        assert stack.layers[0] == splits.ParticleLayer(ground="open")
    with pytest.raises(ValueError, match=r"layers\[0\].ground = 0.5: must be left out"):
        splits.Stack([splits.ParticleLayer(ground=0.5), splits.Snow()])


def test_a_stack_has_one_ground():
    with pytest.raises(ValueError, match=r"layers\[1\].ground = 0.5: must be left out"):
        splits.Stack([splits.Snow(), splits.Snow(ground=0.5)])
    stack = splits.Stack([splits.Snow()], ground="black")
    assert stack.describe()["ground"] == "black" and "layers_0_ground" not in stack.describe()
