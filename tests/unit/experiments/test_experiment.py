"""Experiments and settings: defaults, grids, labels, names."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from shipped import CONFIG

from splits import Snow
from splits.core.inputs import check_wavelengths
from splits.core.validation import ConfigError
from splits.experiments import ExperimentConfig, load_experiments, load_settings
from splits.experiments.config.experiment import RESERVED_NAMES
from splits.experiments.config.load import read_yaml, validate_content
from splits.experiments.config.media import make_label
from splits.experiments.config.simulation import SimulationConfig

ROOT = Path(__file__).parents[3]
SHIPPED = load_experiments(CONFIG / "experiments", CONFIG / "media")
SETTINGS = read_yaml(CONFIG / "config.yaml")
SETTINGS |= {f"{name}_folder": str(CONFIG / name) for name in ("measured", "published")}


def list_points(**content):
    return list(ExperimentConfig(name="made", **content).iter_points())


def test_reserved_names_are_those_of_the_rules():
    files = [ROOT / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    pattern = r"^(?:rule|checkpoint|use rule \w+ as)\s+(\w+)\s*(?:with)?:"
    assert set(re.findall(pattern, text, re.MULTILINE)) == {*RESERVED_NAMES} - {"explorer"}, (
        "the target of the explorer is in the loop over groups"
    )


@pytest.mark.parametrize("name", RESERVED_NAMES)
def test_names_of_rules_are_rejected(name):
    with pytest.raises(ValueError, match=f"name = '{name}': must be none of"):
        ExperimentConfig(name=name)


@pytest.mark.parametrize("name", ["", "A", "1a", "a-b", "a/b", "a b", "../a", "é", "a" * 65])
def test_names_must_be_valid_file_names(name):
    with pytest.raises(ValueError, match="lower-case letters, digits and underscores"):
        ExperimentConfig(name=name)
    assert ExperimentConfig(name="a" * 64).name == "a" * 64


def test_only_the_name_of_an_experiment_is_required():
    experiment = ExperimentConfig(name="made")
    ((labels, medium, incidence),) = experiment.iter_points()
    assert (labels, incidence) == ({}, 0.0)
    assert medium.describe() == Snow().describe()
    np.testing.assert_array_equal(
        experiment.instrument.get_wavelengths(), np.arange(400.0, 2501, 10)
    )
    assert experiment.instrument.kind == "spectrophotometer"
    assert experiment.figure == {}
    assert experiment.resolve_figure()["kind"] == "spectra"


@pytest.mark.parametrize(
    ("value", "label"),
    [
        (0.1, "0.1"), (275.0, "275"), (300, "300"), ([300, 750], "300-750"),
        ([0.2, 0.4, 0.3, 0.072], "0.3"), ("diffuse", "diffuse"),
    ],
)  # fmt: skip
def test_labels_of_values(value, label):
    assert make_label("parameter", value) == label


def test_mappings_on_a_grid_need_labels():
    with pytest.raises(ValueError, match=r"grid\.interpretation = .*a mapping from labels"):
        ExperimentConfig(name="made", grid={"interpretation": [{"entry_point": "projected"}]})


def test_a_grid_runs_all_combinations():
    grid = {"saturation": [0, 0.1, 0.2], "depth_m": [0.1, 0.2], "incidence_deg": [0, "diffuse"]}
    grid_points = list_points(grid=grid, medium={"density_kg_m3": 300})
    assert len(grid_points) == 12
    expected = list(itertools.product(*grid.values()))
    assert [(m.saturation, m.depth_m, i) for _, m, i in grid_points] == expected
    assert grid_points[-1][0] == {"saturation": "0.2", "depth_m": "0.2", "incidence_deg": "diffuse"}
    assert all(medium.density_kg_m3 == 300 for _, medium, _ in grid_points)


def test_custom_labels_are_used():
    grid_points = list_points(grid={"grain_size_um": {"fine": [50, 100], "coarse": [500, 1000]}})
    assert [labels["grain_size_um"] for labels, _, _ in grid_points] == ["fine", "coarse"]
    assert [medium.grain_size_um for _, medium, _ in grid_points] == [(50, 100), (500, 1000)]


def test_interpretations_on_a_grid_are_merged():
    ((_, medium, _),) = list_points(
        medium={"interpretation": {"entry_point": "projected"}},
        grid={"interpretation": {"any": {"facet_sampling": "any"}}},
    )
    assert (medium.interpretation.entry_point, medium.interpretation.facet_sampling) == (
        "projected",
        "any",
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"grid": {"saturation": [0.1, 1.2]}}, "saturation = 1.2"),
        ({"grid": {"saturation": [0.1, 0.1]}}, "grid.saturation = .*different values"),
        ({"grid": {"saturation": 0.1}}, "grid.saturation = 0.1.*at least one value"),
        ({"grid": {"saturaton": [0.1]}}, "grid.saturaton: unknown key.*did you mean saturation"),
        ({"grid": {"incidence_deg": [0, 90]}}, "incidence_deg = 90"),
        ({"grid": [1]}, "grid = .*mapping"),
        (
            {"medium": {"kind": "salt"}},
            "medium.kind = 'salt': must be one of natural_snow, particle_layer, sand, snow",
        ),
        ({"instrument": {"incidence_deg": True}}, "incidence_deg = True"),
        (
            {
                "medium": {"interpretation": 3},
                "grid": {"interpretation": {"any": {"facet_sampling": "any"}}},
            },
            "interpretation = 3",
        ),
        ({"instrument": {"stderr_scale": 0}}, "stderr_scale = 0"),
        ({"figure": {"select": {"depth_m": 0.1}}}, "figure.select = 'depth_m'"),
        ({"figure": {"quantity": "colour"}}, "colour"),
    ],
)
def test_invalid_simulations_are_rejected(content, message):
    with pytest.raises(ValueError, match=message):
        validate_content(ExperimentConfig, {"name": "made", **content})


def test_wavelength_grids_include_both_ends():
    given = {"start": 400, "stop": 500, "step": 50}
    for change, expected in (
        ({}, [400, 450, 500]),
        ({"stop": 400, "step": 0.1}, [400]),
        ({"stop": 400.3, "step": 0.1}, [400, 400.1, 400.2, 400.3]),
        ({"stop": 400, "also": [842.25]}, [400, 842.25]),
    ):
        assert check_wavelengths("wavelength_nm", given | change).tolist() == expected
    for invalid in ({"stop": 300}, {"step": 1e-9}):
        with pytest.raises(ValueError, match=f"wavelength_nm.{next(iter(invalid))}"):
            check_wavelengths("wavelength_nm", given | invalid)


def test_captions_and_figures_do_not_affect_simulations():
    plain = ExperimentConfig(name="made")
    captioned = ExperimentConfig(
        name="made", title="T", caption="C", figure={"quantity": "transmittance"}
    )
    assert captioned.dump_simulation() == plain.dump_simulation()
    assert (
        ExperimentConfig(name="made", medium={"depth_m": 1}).dump_simulation()
        != plain.dump_simulation()
    )


@pytest.mark.parametrize("name", SHIPPED)
def test_dumped_simulations_are_the_same_experiment(name):
    experiment = SHIPPED[name]
    reloaded = SimulationConfig.model_validate(experiment.dump_simulation())
    assert reloaded.dump_simulation() == experiment.dump_simulation()
    assert experiment.title and experiment.caption


def test_experiments_are_selected_by_name():
    everything = load_settings({**SETTINGS, "experiments": "everything"})
    assert everything.select_experiments(SHIPPED) == SHIPPED
    two = load_settings({**SETTINGS, "experiments": "fig08_grain_size,fig05_refractive_indices"})
    assert set(two.select_experiments(SHIPPED)) == {"fig08_grain_size", "fig05_refractive_indices"}
    for key in ("experiments", "archive"):
        invalid = load_settings({**SETTINGS, key: ["fig08_grainsize"]})
        with pytest.raises(ConfigError, match=f"{key} = 'fig08_grainsize'.*fig08_grain_size"):
            invalid.select_experiments(SHIPPED)


def test_accuracies_have_separate_folders():
    assert load_settings(SETTINGS).results_folder == "results"
    tiny = load_settings({**SETTINGS, "accuracy": "tiny", "results": "out"})
    assert tiny.results_folder == "out/tiny"
    assert tiny.accuracies["tiny"].max_stderr == 0.05
