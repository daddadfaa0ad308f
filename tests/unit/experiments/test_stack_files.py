"""Stacks in experiment files: layers, bases, paths, and one-line errors."""

import math

import pytest
from experiment_jobs import start_jobs
from shipped import CONFIG, ROOT

import splits
from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import load_experiment
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.media import make_grid_coordinates
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.io.netcdf import save
from splits.plotting.grammar import format_parameter

MEDIA = CONFIG / "media"
STACK_TEXT = """
medium:
  kind: stack
  layers:
    - {base: splitsnow_table1, density_kg_m3: 120, saturation: 0, depth_m: 0.02}
    - {kind: sand, depth_m: 0.05}
  ground: 0.2
  interpretation: splits_2007
instrument: {wavelength_nm: [500]}
"""


def load_text(folder, text):
    path = folder / "stack.yaml"
    path.write_text(text)
    return load_experiment(path, MEDIA)


def test_layers_inherit_from_their_bases(tmp_path):
    ((_, stack, _),) = load_text(tmp_path, STACK_TEXT).iter_points()
    assert [layer.kind for layer in stack.layers] == ["snow", "sand"]
    assert stack.layers[0].density_kg_m3 == 120.0 and stack.layers[0].temperature_c == -1.0
    assert stack.ground.name == "albedo 0.2"


def test_pores_with_custom_liquids(tmp_path):
    text = """
medium: {refractive_index: {brine: 1.38+2e-6j, oil: 1.47}, pores: {oil: 0.2}}
grid: {pores: {little: {brine: 0.1}, much: {brine: 0.3}}}
instrument: {wavelength_nm: [500]}
"""
    pores = [snow.pores for _, snow, _ in load_text(tmp_path, text).iter_points()]
    assert pores == [{"oil": 0.2, "brine": 0.1}, {"oil": 0.2, "brine": 0.3}]
    stack_text = STACK_TEXT.replace("depth_m: 0.05}", "depth_m: 0.05, pores: {brine: 0.1}}")
    with pytest.raises(ConfigError, match=r"layers\.1\.pores = 'brine'.*give refractive_index"):
        load_text(tmp_path, stack_text)


def test_grid_paths_set_parameters_of_layers(tmp_path):
    grid = "grid: {layers.0.depth_m: [0.01, 0.02], layers.1.depth_m: [0.02], ground: [0, 1]}\n"
    experiment = load_text(tmp_path, STACK_TEXT.replace("  ground: 0.2\n", "") + grid)
    points = [
        (*(layer.depth_m for layer in stack.layers), stack.ground.name)
        for _, stack, _ in experiment.iter_points()
    ]
    assert points == [
        (0.01, 0.02, "albedo 0.0"), (0.01, 0.02, "albedo 1.0"),
        (0.02, 0.02, "albedo 0.0"), (0.02, 0.02, "albedo 1.0"),
    ]  # fmt: skip
    attributes = make_grid_coordinates(experiment.grid)["layers.0.depth_m"][2]
    assert attributes == {"long_name": "thickness of the sample, layer 0", "units": "m"}
    assert format_parameter("layers.0.depth_m") == "layer 0: depth (m)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("medium: {kind: stack}", "medium.layers = None: must be a list of layers, top first"),
        ("medium: {kind: stack, layers: [3]}", "medium.layers.0 = 3: must be a mapping"),
        (
            "medium: {kind: stack, layers: [{kind: ice}]}",
            "one of natural_snow, particle_layer, sand, snow",
        ),
        (
            "medium: {kind: stack, layers: [{kind: particle_layer, ground: 1}]}",
            r"layers\[0\].ground = 1.0: must be left out",
        ),
        (
            STACK_TEXT + "grid: {layers: {a: [{kind: snw}]}}",
            "grid.layers.a.layers.0.kind = 'snw'",
        ),
        (STACK_TEXT + "grid: {layers: {a: [fresh]}}", "grid.layers.a.layers.0 = 'fresh'"),
        (
            STACK_TEXT + "grid: {layers.1.depth_m: [1], layers: {a: [{depth_m: 1}]}}",
            r"layers.1.depth_m = 'layer 1': must be 0 to 0",
        ),
        (
            "medium: {kind: stack, layers: [{dept_m: 1}]}",
            r"medium.layers.0.dept_m: unknown key.*did you mean depth_m\?",
        ),
        (
            "medium: {kind: stack, layers: [{depth_m: 1}, {depth_m: -3}]}",
            "medium.layers.1.depth_m = -3",
        ),
        (
            "medium: {kind: stack, layers: [{ground: 1}]}",
            r"layers.0..ground = .*must be left",
        ),
        ("medium: {kind: stack, layers: [{base: non}]}", "medium.layers.0.base = 'non'"),
        ("medium: {kind: stack, layers: [{depth_m: 1e-5}]}", "more than the largest grain"),
        (
            STACK_TEXT + "grid: {layers.2.depth_m: [1]}",
            r"must be 0 to 1 \(counted from the top\)",
        ),
        (
            STACK_TEXT + "grid: {layers.1.density_kg_m3: [1]}",
            "layers.1.density_kg_m3: unknown key",
        ),
        (STACK_TEXT + "grid: {layers.1.depth_m: [1, -2]}", r"grid.layers.1.depth_m = -2"),
        ("grid: {layers.1.depth_m: [1]}", "grid.layers.1.depth_m: unknown key"),
    ],
)
def test_invalid_stacks_are_rejected_in_one_line(tmp_path, text, message):
    (tmp_path / "stack.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        start_jobs(tmp_path / "stack.yaml", MEDIA)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("first", ["layers", "layers.0.depth_m"])
def test_grid_paths_apply_to_every_list_of_layers(tmp_path, first):
    values = {
        "layers": "{thin: [{depth_m: 0.02}], thick: [{depth_m: 0.03}, {depth_m: 0.01}]}",
        "layers.0.depth_m": "[0.05, 0.06]",
    }
    order = [first, *(set(values) - {first})]
    grid = "grid: {" + ", ".join(f"{key}: {values[key]}" for key in order) + "}\n"
    experiment = load_text(tmp_path, STACK_TEXT + grid)
    before = experiment.dump_simulation()
    depths = sorted(
        tuple(layer.depth_m for layer in stack.layers) for _, stack, _ in experiment.iter_points()
    )
    assert depths == [(0.05,), (0.05, 0.01), (0.06,), (0.06, 0.01)]
    assert experiment.dump_simulation() == before


def test_mappings_by_path_are_merged_with_the_layer(tmp_path):
    text = (
        "medium: {kind: stack, layers: [{interpretation: {size_definition: semi_axis}}]}\n"
        "grid: {layers.0.interpretation: {weighted: {size_sampling: uniform}}}\n"
    )
    ((_, stack, _),) = load_text(tmp_path, text).iter_points()
    interpretation = stack.layers[0].interpretation.as_dict()
    assert (interpretation["size_definition"], interpretation["size_sampling"]) == (
        "semi_axis",
        "uniform",
    )


def test_tables_by_path_are_identified_by_content(tmp_path):
    table = tmp_path / "ice.csv"
    table.write_text("wavelength_nm,n,k\n400,1.31,1e-8\n900,1.30,1e-7\n")
    text = STACK_TEXT + f"grid: {{layers.0.refractive_index: {{mine: {{ice: {table}}}}}}}\n"
    experiment = load_text(tmp_path, text)
    assert experiment.list_table_paths() == [str(table)]
    assert "ice.csv sha256:" in experiment.dump_configuration()
    assert str(tmp_path) not in experiment.dump_configuration()


def test_the_documented_example_is_valid(tmp_path):
    text = (ROOT / "docs" / "how-to" / "layers-of-snow.md").read_text(encoding="utf-8")
    example = text.partition("```yaml\n")[2].partition("```")[0]
    assert len(example.splitlines()) <= 12
    assert len(list(load_text(tmp_path, example).iter_points())) == 6


def make_semi_infinite_content(kind):
    return {
        "name": "semi_infinite",
        "medium": {"kind": "snow", "saturation": 0.0},
        "instrument": {"kind": kind, "wavelength_nm": [1300]},
        "grid": {"depth_m": [0.02, math.inf]},
    }


def test_semi_infinite_media_are_for_the_spectrophotometer():
    content = make_semi_infinite_content("goniophotometer")
    content["grid"] = {"depth_m": [math.inf, 0.02]}
    experiment = ExperimentConfig.model_validate(content)
    with pytest.raises(InvalidValue, match=r"grid.depth_m = inf: must be finite"):
        run(experiment, Accuracy(max_stderr=0.1))


def test_semi_infinite_depths_on_a_grid_are_simulated(tmp_path):
    experiment = ExperimentConfig.model_validate(make_semi_infinite_content("spectrophotometer"))
    save(run(experiment, Accuracy(max_stderr=0.1)), tmp_path / "semi_infinite.nc")
    ds = splits.load(tmp_path / "semi_infinite.nc")
    assert ds.depth_m.values.tolist() == [0.02, math.inf]
    assert ds.transmittance.sel(depth_m=math.inf).item() == 0.0
