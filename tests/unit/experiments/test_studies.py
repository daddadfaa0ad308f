"""Studies: validation, and unique names of their outputs."""

import shutil
import sys
from pathlib import Path

import pytest
from shipped import CONFIG

from splits.core.validation import ConfigError
from splits.experiments import ExperimentConfig, load_experiments, load_settings
from splits.experiments.config.load import read_yaml, validate_content
from splits.experiments.config.settings import (
    Study,
    find_incomplete_studies,
    hash_function,
    read_parameters,
    select_studies,
)

ROOT = Path(__file__).parents[3]
SETTINGS_CONTENT = read_yaml(CONFIG / "config.yaml")
SETTINGS_CONTENT |= {
    f"{name}_folder": str(CONFIG / name) for name in ("media", "measured", "published")
}


@pytest.fixture(scope="module")
def shipped():
    return load_experiments(CONFIG / "experiments", CONFIG / "media")


@pytest.fixture
def settings():
    return load_settings(SETTINGS_CONTENT)


def make_settings(studies):
    return load_settings({**SETTINGS_CONTENT, "studies": SETTINGS_CONTENT["studies"] | studies})


def test_shipped_studies_are_complete(shipped):
    settings = load_settings(SETTINGS_CONTENT)
    assert set(
        load_settings(SETTINGS_CONTENT | {"experiments": "everything"}).select_experiments(shipped)
    ) == set(shipped)
    papers = settings.select_experiments(shipped)
    assert {one.group for one in papers.values()} == {"papers"}
    assert find_incomplete_studies(settings.studies, shipped) == {}
    paths = {
        path
        for name, study in settings.studies.items()
        for product_paths in study.list_product_paths(name).values()
        for path in product_paths
    }
    figures = (
        "fig23_sensitivity", "interpretation_ranking", "letcher2022_measured",
        "surface_area_spectra_found", "surface_area_law", "sobol_indices_by_wavelength",
        "wet_sand_anisotropy", "band_selection", "sensitivity_by_interpretation_index",
    )  # fmt: skip
    figure_paths = {
        f"figures/{name}{suffix}" for name in figures for suffix in (".png", ".svg", ".pdf")
    }
    assert paths == figure_paths | {
        "data/fig23_sensitivity.nc", "tables/sensitivity.csv", "tables/table2.csv",
        "data/sensitivity_by_interpretation_index.nc", "tables/sensitivity_by_interpretation.csv",
        "tables/sensitivity_by_interpretation_chosen.csv",
        "tables/agreement.csv", "tables/interpretation_ranking.csv",
        "tables/sobol_indices_by_wavelength.csv", "tables/band_selection.csv",
        "tables/wet_sand_anisotropy.csv", "tables/wet_sand_anisotropy_by_angle.csv",
        "tables/interpretation_ranking_statements.csv", "tables/interpretation_ranking_without.csv",
        "tables/measured_bands.csv", "tables/table1.csv", "tables/table3.csv",
        "tables/sand_trends.csv", "tables/sand_weights.csv",
        "tables/sand_colours.csv", "tables/sand_compositions.csv", "tables/angular_trends.csv",
        "tables/layer_trends.csv", "tables/surface_area.csv", "tables/surface_area_law.csv",
    }  # fmt: skip


def test_code_does_not_depend_on_experiment_names(shipped):
    rules = [*(ROOT / "workflow").rglob("*.smk"), *(ROOT / "workflow").rglob("*.py")]
    for path in [*rules, *(ROOT / "splits").rglob("*.py"), ROOT / "Snakefile"]:
        text = path.read_text(encoding="utf-8")
        for name in shipped:
            # The docstring of the Snakefile names an experiment, without quotes.
            assert f'"{name}"' not in text, (path, name)


@pytest.mark.parametrize(
    "name",
    ["fig23_sensitivity", "letcher2022_measured", "sensitivity", "table2", "agreement",
     "retrieved_sand_retrieved", "angular_trends", "sand_colours"],
)  # fmt: skip
def test_experiment_names_of_studies_are_rejected(shipped, name):
    experiment = ExperimentConfig.model_validate({"name": name})
    with pytest.raises(ConfigError, match=f"^experiment {name}: name = '{name}': must be unique"):
        load_settings(SETTINGS_CONTENT).select_experiments({**shipped, name: experiment})


LAYERS = "workflow.papers.layer.make_layer_trend_table"
COMPOSITIONS = SETTINGS_CONTENT["studies"]["sand_compositions"]["function"]
TABLE1 = {"function": "workflow.papers.splitsnow.make_table1", "inputs": {"sample": "a"}}
TABLE3 = {**SETTINGS_CONTENT["studies"]["table3"], "outputs": {}}


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ({"inputs": {}}, r"studies\.mine\.function = None: must be given"),
        ({**TABLE1, "outpts": {}}, r"mine\.outpts: unknown key.*did you mean outputs"),
        ({"function": "layer"}, r"mine\.function = 'layer': must be MODULE\.NAME, a function"),
        ({"function": LAYERS.replace("layer.", "layers.")}, "there is no module workflow.papers"),
        ({"function": LAYERS + "s"}, r"function = .*trend_tables': .*did you mean make_layer"),
        ({"function": "numpy.core_functions.a"}, "there is no module numpy.core_functions"),
        ({**TABLE1, "function": LAYERS}, r"mine\.inputs\.sample: unknown key, must be one of lens"),
        ({"function": LAYERS, "options": {"lense": 1}}, r"options\.lense: .*did you mean lens"),
        ({**TABLE1, "inputs": {}}, r"mine\.inputs = {}: must be with sample, which the function"),
        ({**TABLE3, "measured": {}}, "inputs = .*: must be with aviris, which the function needs"),
        ({**TABLE3, "options": {"aviris": 1}}, r"options \(key\) = 'aviris'.*measured has it"),
        ({**TABLE1, "options": {"threads": 2}}, r"options \(key\) = 'threads'.*the workflow has"),
        ({**TABLE3, "published": {"published": "splitsnow.csv"}},
         r"published\.published = 'splitsnow\.csv': .*did you mean splitsnow2021\.csv"),
        ({**TABLE1, "outputs": {"table": {}}}, r"outputs \(key\) = 'table': must be NAME\.csv"),
        ({**TABLE1, "outputs": {"nul.csv": {}}}, r"outputs \(key\) = 'nul\.csv': .*lower-case"),
        ({**TABLE1, "outputs": {"a.csv": {"place": "Figure 3"}}}, r"a\.csv\.place = 'Figure 3'"),
        ({**TABLE1, "outputs": {"a.csv": {"comparison": True}}},
         r"outputs\.a\.csv\.comparison = True: must be left out"),
        ({**TABLE1, "outputs": {"table2.csv": {}}},
         r"studies\.mine: name = 'table2': must be unique \(the study sens"),
        ({**TABLE1, "outputs": {"fig08_grain_size.csv": {}}},
         "experiment fig08_grain_size: name = 'fig08_grain_size': must be unique"),
    ],
)  # fmt: skip
def test_invalid_studies_are_rejected_in_one_line(shipped, study, message):
    with pytest.raises(ConfigError, match=message) as error:
        make_settings({"mine": study}).select_experiments(shipped)
    assert "\n" not in str(error.value)


def test_missing_experiments_of_a_study_are_reported(shipped):
    study = {"function": LAYERS, "inputs": {"lens": "layer_fig02_len"}}
    studies = make_settings({"mine": study}).studies
    assert find_incomplete_studies(studies, shipped) == {
        "mine": "study mine is left out: no such experiment: layer_fig02_len "
        "(did you mean layer_fig02_lens?)"
    }
    incomplete = find_incomplete_studies(studies, {})
    assert incomplete["sand_compositions"].endswith("no experiment is in its group papers")
    assert "sensitivity_density" in incomplete["agreement"], "it reads the dataset of a study"


def test_missing_names_are_always_reported(shipped):
    assert load_settings(SETTINGS_CONTENT).list_warnings(shipped) == []
    studies = {
        "a": {"function": LAYERS, "inputs": {"lens": "layer_fig02_len"}},
        "b": {"function": LAYERS, "group": "exploer", "inputs": {"lens": "layer_fig02_lens"}},
        "c": {"function": LAYERS, "inputs": {"lens": "zzzzzzz"}},
    }
    content = {**SETTINGS_CONTENT, "studies": studies, "explorer": {"snow": "nosuch"}}
    content["explorer_directions"] = {"snow": "explorer_snow_direction"}
    assert load_settings(content).list_warnings(shipped) == [
        "study a is left out: no such experiment: layer_fig02_len (did you mean layer_fig02_lens?)",
        "study b is left out: no experiment is in its group exploer",
        "explorer: no such experiment: nosuch",
        "explorer: no such experiment: explorer_snow_direction (did you mean "
        "explorer_snow_directions?)",
        "none of their experiments exists: studies c",
    ]


def test_a_study_may_read_the_dataset_of_a_study_that_reads_one():
    studies = {
        "first": Study(function="a.b", inputs={"x": "one"}, outputs={"made.nc": {}}),
        "second": Study(function="a.b", inputs={"x": "made", "y": "two"}, outputs={"more.nc": {}}),
        "third": Study(function="a.b", inputs={"x": "more"}),
        "circle": Study(function="a.b", inputs={"x": "round"}, outputs={"round.nc": {}}),
    }
    assert sorted(studies["third"].list_experiments(studies)) == ["one", "two"]
    assert studies["circle"].list_experiments(studies) == ["round"]


MODULE = """\
import numpy as np
from . import helpers
from {package}.more import extra as other

def draw(first, second=1, *, third, fourth=np.pi, **runs):
    raise RuntimeError
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return the folder of a package of a user."""
    folder = tmp_path / "users_studies"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    module = MODULE.format(package=folder.name)
    (folder / "mine.py").write_text(module, "utf-8")
    (folder / "helpers.py").write_text("import json\n", "utf-8")
    (folder / "more.py").write_text("from .deep import extra\n", "utf-8")
    (folder / "deep.py").write_text("extra = 1\n", "utf-8")
    (folder / "other.py").write_text("", "utf-8")
    (folder / "broken.py").write_text(f"{module}\ndef broken(", "utf-8")
    return folder


@pytest.mark.usefixtures("package")
def test_functions_of_any_module_are_read_without_importing_it():
    parameters = read_parameters("users_studies.mine.draw")
    needed = {"first": True, "second": False, "third": True, "fourth": False, "**": False}
    assert parameters == needed
    with pytest.raises(ValueError, match=r"broken\.py, line 8"):
        read_parameters("users_studies.broken.draw")


@pytest.mark.parametrize(
    ("name", "changes"),
    [("mine", True), ("helpers", True), ("more", True), ("deep", True), ("other", False)],
)
def test_digest_of_a_function_covers_what_its_module_imports(package, name, changes):
    before = hash_function("users_studies.mine.draw")
    assert not {"users_studies", "users_studies.mine"} & sys.modules.keys(), "it is not imported"
    with open(package / f"{name}.py", "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert (hash_function("users_studies.mine.draw") != before) == changes


def test_functions_of_shipped_studies_have_digests(settings):
    digests = {name: hash_function(one.function) for name, one in settings.studies.items()}
    assert len(digests["interpretation_ranking"]) == 5, "runs, angles, sensitivity, statements"


@pytest.mark.parametrize(
    ("experiments", "message"),
    [
        (["fig08_grain", "own"], r"experiments = 'fig08_grain': no such experiment or group \(did"),
        ("papers,papers", r"experiments = \['papers', 'papers'\]: must be different names"),
        (["own"], "experiments = own: must select at least one"),
        ("wet_sands", "experiments = 'wet_sands': no such experiment or group .*wet_sand"),
    ],
)
def test_invalid_selections_are_rejected(shipped, experiments, message):
    with pytest.raises(ConfigError, match=message):
        load_settings(SETTINGS_CONTENT | {"experiments": experiments}).select_experiments(shipped)


def test_groups_and_experiments_are_selected(shipped):
    chosen = {"experiments": "wet_sand,fig08_grain_size"}
    selected = load_settings(SETTINGS_CONTENT | chosen).select_experiments(shipped)
    assert set(selected) == {"fig08_grain_size", "wet_sand_directions", "retrieved_wet_sand",
                             "retrieved_wet_sand_by_volume"}  # fmt: skip


@pytest.mark.parametrize("group", ["all", "everything", "Wet sand", "simulate"])
def test_invalid_groups_are_rejected(group):
    with pytest.raises(ValueError, match=f"group = '{group}'"):
        ExperimentConfig.model_validate({"name": "a", "group": group})


@pytest.mark.parametrize(
    ("name", "group"),
    [("a", "fig08_grain_size"), ("own", "examples"), ("papers", "own"), ("wet_sand", "own")],
)
def test_groups_differ_from_experiments(shipped, name, group):
    experiment = ExperimentConfig.model_validate({"name": name, "group": group})
    with pytest.raises(ConfigError, match=f"group = '({name}|{group})': must differ"):
        load_settings(SETTINGS_CONTENT).select_experiments({**shipped, name: experiment})


def test_names_of_retrieval_tables_are_unique(shipped):
    studies = {**SETTINGS_CONTENT["studies"], "retrieved_dozier_retrieved": TABLE1}
    with pytest.raises(ConfigError, match="'retrieved_dozier_retrieved': must be unique"):
        load_settings({**SETTINGS_CONTENT, "studies": studies}).select_experiments(shipped)


def test_tables_of_studies_are_read_before_the_run(shipped, tmp_path):
    shutil.copytree(CONFIG / "measured", tmp_path / "measured")
    file = tmp_path / "measured" / "aviris_ng_varsa2021.csv"
    file.write_text(file.read_text(encoding="utf-8").replace("0.890", "89%"), encoding="utf-8")
    content = {**SETTINGS_CONTENT, "measured_folder": str(tmp_path / "measured")}
    with pytest.raises(ConfigError, match=r"studies\.agreement\.measured\.aviris = .*line 4: refl"):
        load_settings(content).select_experiments(shipped)


@pytest.mark.parametrize("name", ["con", "nul", "com1", "lpt9"])
def test_reserved_device_names_are_rejected(name):
    with pytest.raises(ValueError, match=f"name = '{name}'.*no device such as con"):
        validate_content(ExperimentConfig, {"name": name})


def test_studies_are_selected_with_all_that_they_read(settings, shipped):
    agreement = settings.studies["agreement"]
    both = {name: shipped[name] for name in agreement.list_experiments(settings.studies)}
    own = {name: one for name, one in both.items() if name in agreement.inputs.values()}
    alone = {"letcher2022_measured", "measured_bands", "table1"}
    assert set(select_studies(settings.studies, own, ())) == alone
    assert {"agreement", "sensitivity", *alone} == set(select_studies(settings.studies, both, ()))
    without_sand = {"fig08_grain_size": shipped["fig08_grain_size"]}
    assert select_studies(settings.studies, without_sand, ()) == {}


def test_archive_keeps_the_groups_of_its_studies(settings, shipped):
    everything = settings.model_copy(update={"experiments": "everything"})
    archived = everything.select_archived(shipped)
    assert archived.select_experiments(shipped) == shipped
    assert {"interpretations", *shipped} <= set(archived.experiments)
    papers = {name: one for name, one in shipped.items() if one.group == "papers"}
    archived = settings.select_archived(papers)
    assert "interpretation_ranking" not in archived.studies and "agreement" in archived.studies
    partial = settings.model_copy(update={"archive": ("fig08_grain_size", "retrieved_dozier")})
    with pytest.raises(ConfigError, match="archive = 'retrieved_dozier': must be a selected exp"):
        partial.select_archived(papers)


def test_study_of_a_group_without_experiments_is_incomplete(shipped):
    settings = make_settings({"a": {"function": COMPOSITIONS, "group": "paper"}})
    messages = find_incomplete_studies(settings.studies, shipped)
    assert messages == {"a": "study a is left out: no experiment is in its group paper"}
