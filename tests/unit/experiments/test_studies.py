"""Studies: validation, and unique names of their outputs."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from shipped import CONFIG

from splits.core.yaml import ConfigError
from splits.experiments import ExperimentConfig, load_experiments, load_settings
from splits.experiments.config.load import read_yaml
from splits.experiments.config.messages import validate_content
from splits.experiments.papers.brdf_trends import make_brdf_trend_rows
from splits.experiments.studies.checks import find_incomplete_studies, select_studies

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
    rules = [*(ROOT / "workflow").rglob("*.smk"), *(ROOT / "workflow" / "scripts").glob("*.py")]
    for path in [*rules, *(ROOT / "splits").rglob("*.py"), ROOT / "Snakefile"]:
        text = path.read_text(encoding="utf-8")
        for name in shipped:
            # The docstring of the Snakefile names an experiment, without quotes.
            assert f'"{name}"' not in text, (path, name)


@pytest.mark.parametrize(
    "name",
    ["fig23_sensitivity", "letcher2022_measured", "sensitivity", "table2", "agreement",
     "sand_fit_parameters", "angular_trends", "sand_colours"],
)  # fmt: skip
def test_experiment_names_of_studies_are_rejected(shipped, name):
    experiment = ExperimentConfig.model_validate({"name": name})
    with pytest.raises(ConfigError, match=f"^experiment {name}: name = '{name}': must be unique"):
        load_settings(SETTINGS_CONTENT).select_experiments({**shipped, name: experiment})


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ({"kind": "trends"}, r"studies\.mine\.kind = 'trends': must be one of .*angular_trends"),
        ({"kind": "bands", "inputs": {"a": "explorer_snow"}, "bands": "sentinel"},
         r"mine\.bands = 'sentinel': must be one of"),
        ({"kind": "bands", "inputs": {"a": "explorer_snow"}, "noise": 0},
         r"mine\.noise = 0"),
        ({"kind": "bands", "inputs": {"a": "explorer_snow"}, "n_bands": 0},
         r"mine\.n_bands = 0"),
        ({"kind": "bands", "inputs": {"a": "explorer_snow"}, "fixed": {"incidence": 40}},
         r"mine\.fixed\.incidence: unknown key.*did you mean incidence_deg"),
        ({"kind": "bands", "inputs": {"a": "explorer_snow"}, "fixed": {"incidence_deg": 85}},
         r"mine\.fixed\.incidence_deg = 85.*0 to 82"),
        ({"kind": "sobol", "inputs": {"a b": "explorer_snow", "a_b": "explorer_sand"}},
         r"mine\.inputs = \['a b', 'a_b'\]: must be names that differ"),
        ({"kind": "sobol", "inputs": {"a": "explorer_snow"}, "outputs": {"table": "nul"}},
         r"mine\.outputs\.table = 'nul': must be lower-case letters"),
        ({"kind": "sobol", "inputs": {"a": "explorer_snow"}, "n_bands": 2},
         r"mine\.n_bands = 2: must be left out for sobol \(it belongs to bands\)"),
        ({"kind": "anisotropy", "inputs": {"directions": "sand_fig11_brdf"},
          "files": {"directions": "wet_sand_directions.csv"}},
         r"'sand_fig11_brdf': must be .*over interpretation and saturation"),
        ({"kind": "anisotropy", "inputs": {"directions": "wet_sand_directions"}},
         r"mine\.files: missing, must be a mapping"),
        ({"kind": "anisotropy", "inputs": {"directions": "wet_sand_directions"}, "files": {}},
         r"mine\.files = {}: must be with directions"),
        ({"kind": "layer_trends"}, r"mine\.inputs: missing, must be a mapping"),
        ({"kind": "layer_trends", "inputs": {}},
         r"mine\.inputs = {}: must be with one of lens, volume"),
        ({"kind": "angular_trends", "inputs": {"facets": "a"}},
         r"mine\.inputs\.facets: unknown key.*did you mean facetness"),
        ({"kind": "angular_trends", "inputs": {"facetness": "fig21_grain_size"}},
         r"mine\.inputs\.facetness = 'fig21_grain_size': must be .*over facetness"),
        ({"kind": "angular_trends", "inputs": {"incidence": "fig16_incidence"}},
         r"incidence = 'fig16_incidence': must be .*incidence_deg = 0"),
        ({"kind": "angular_trends", "inputs": {"grain_size_infrared": "fig20_grain_size"}},
         r"'fig20_grain_size': must be an experiment with wavelength 1450 nm"),
        ({"kind": "angular_trends", "inputs": {"wavelength": "fig08_grain_size"}},
         r"'fig08_grain_size': must be an experiment with a goniophotometer"),
        ({"kind": "sand_compositions", "inputs": {"lens": "a"}},
         r"mine\.inputs = .*: must be left out for sand_compositions \(it belongs to agreement"),
        ({"kind": "sensitivity"}, r"mine\.pairs: missing, must be a mapping"),
        ({"kind": "sensitivity", "pairs": {}}, r"mine\.pairs = {}: must be at least one pair"),
        ({"inputs": {}}, r"mine\.kind: missing, must be one of agreement, interpretation"),
        ({**SETTINGS_CONTENT["studies"]["agreement"], "outputs": {}, "sensitivity": "agreement"},
         r"mine\.sensitivity = 'agreement': must be .*sensitivity"),
        ({"kind": "layer_trends", "sensitivity": "sensitivity", "inputs": {"lens": "a"}},
         r"mine\.sensitivity = .*: must be left out for layer_trends \(it belongs to agreement"),
        ({"kind": "sensitivity", "files": {"published": "splitsnow.csv"},
          "pairs": {"a": {"parameter": "saturation", "experiment": "b", "low": 0, "high": 1}}},
         r"files\.published = 'splitsnow\.csv': must be one of.*did you mean splitsnow2021\.csv"),
        ({"kind": "sensitivity", "pairs": {"a": {"parameter": "b"}}},
         r"studies\.mine\.pairs\.a\.experiment: missing"),
        ({"kind": "sensitivity", "pairs": {"a": {
            "parameter": "saturation", "experiment": "fig13_saturation", "low": 0, "high": 0.3}}},
         r"pairs\.a\.experiment = 'fig13_saturation': must be .*saturation and depth_m"),
        ({"kind": "sand_compositions", "outputs": {"table": "table2"}},
         r"studies\.mine: name = 'table2': must be unique \(the study sens"),
        ({"kind": "sand_compositions", "outputs": {"table": "fig08_grain_size"}},
         "experiment fig08_grain_size: name = 'fig08_grain_size': must be unique"),
    ],
)  # fmt: skip
def test_invalid_studies_are_rejected_in_one_line(shipped, study, message):
    with pytest.raises(ConfigError, match=message) as error:
        make_settings({"mine": study}).select_experiments(shipped)
    assert "\n" not in str(error.value)


def test_missing_experiments_of_a_study_are_reported(shipped):
    study = {"kind": "angular_trends", "inputs": {"facetness": "fig22_facetnes"}}
    studies = make_settings({"mine": study}).studies
    assert find_incomplete_studies(studies, shipped) == {
        "mine": "study mine is left out: no such experiment: fig22_facetnes "
        "(did you mean fig22_facetness?)"
    }
    incomplete = find_incomplete_studies(studies, {})
    assert incomplete["sand_compositions"].endswith("no experiment has sand")
    assert "sensitivity_density" in incomplete["agreement"], "it reads its sensitivity study"


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


def test_a_study_of_some_inputs_has_their_rows():
    polar, azimuth = np.arange(0.0, 90.0, 2.5), np.array([0.0, 180.0])
    value = 0.3 + 0.1 * np.sin(np.radians(polar))[:, np.newaxis] * np.cos(np.radians(azimuth))
    shape = (1, *value.shape)
    coordinates = {"incidence_deg": [0.0, 40.0], "wavelength": [700.0], "polar": polar,
             "azimuth": azimuth}  # fmt: skip
    values = np.stack([0.3 + 0.0 * value, value]).reshape(2, *shape)
    dataset = xr.Dataset(
        {
            "brdf": (tuple(coordinates), values),
            "brdf_stderr": (tuple(coordinates), 0.0 * values + 1e-3),
        },
        coordinates,
    )
    rows = make_brdf_trend_rows({"incidence": dataset})
    assert [row["quantity"] for row in rows] == [
        "nearly Lambertian at 0°, 700 nm: 0.2 less the relative range within 60°",
        "forward peak above the nadir at 40°, 700 nm",
        "forward side (60°) over the nadir rises with incidence, 0°, 40°: smallest step",
    ]
    assert all(row["verdict"] == "agrees" for row in rows)
    assert (
        len(make_brdf_trend_rows({"grazing": dataset.assign_coords(incidence_deg=[20.0, 60.0])}))
        == 2
    )


def test_names_of_retrieval_tables_are_unique(shipped):
    study = {"kind": "sobol", "inputs": {"a": "explorer_snow"}}
    studies = {**SETTINGS_CONTENT["studies"], "retrieved_dozier_retrieved": study}
    with pytest.raises(ConfigError, match="'retrieved_dozier_retrieved': must be unique"):
        load_settings({**SETTINGS_CONTENT, "studies": studies}).select_experiments(shipped)


def test_tables_of_studies_are_read_before_the_run(shipped, tmp_path):
    shutil.copytree(CONFIG / "measured", tmp_path / "measured")
    file = tmp_path / "measured" / "aviris_ng_varsa2021.csv"
    file.write_text(file.read_text(encoding="utf-8").replace("0.890", "89%"), encoding="utf-8")
    content = {**SETTINGS_CONTENT, "measured_folder": str(tmp_path / "measured")}
    with pytest.raises(ConfigError, match=r"studies\.agreement\.files\.aviris = .*line 4: refl"):
        load_settings(content).select_experiments(shipped)


@pytest.mark.parametrize("name", ["con", "nul", "com1", "lpt9"])
def test_reserved_device_names_are_rejected(name):
    with pytest.raises(ValueError, match=f"name = '{name}'.*no device such as con"):
        validate_content(ExperimentConfig, {"name": name})


def test_studies_are_selected_with_all_that_they_read(settings, shipped):
    agreement = settings.studies["agreement"]
    own = {name: shipped[name] for name in agreement.list_experiments()}
    sensitivity = settings.studies[agreement.sensitivity].list_experiments()
    both = own | {name: shipped[name] for name in sensitivity}
    assert set(select_studies(settings.studies, own, ())) == set()
    assert {"agreement", "sensitivity"} <= set(select_studies(settings.studies, both, ()))
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
    settings = make_settings({"a": {"kind": "sand_compositions", "group": "paper"}})
    messages = find_incomplete_studies(settings.studies, shipped)
    assert messages == {"a": "study a is left out: no experiment is in its group paper"}
