"""Shipped experiments: plan and lint of the workflow, and a few runs at lowest accuracy."""

import re

import numpy as np
import pandas as pd
import pytest
from _numbers import values

import splits
from splits.experiments import load_experiments
from splits.experiments.run_table import count_parts

pytestmark = pytest.mark.slow

WITH_FIGURES = ("table1_sample", "fig05_refractive_indices", "fig24b_aviris")
FEW_EXPERIMENTS = (*WITH_FIGURES, "snow_beam_spread", "layer_fig02_lens")


@pytest.fixture(scope="module")
def shipped(make_project, tmp_path_factory):
    """Return a project with the shipped configuration."""
    return make_project(tmp_path_factory.mktemp("shipped"), shipped=True)


@pytest.fixture(scope="module")
def few_datasets(shipped):
    """Run a few experiments, and return the datasets."""
    paths = [f"results/tiny/data/{name}.nc" for name in FEW_EXPERIMENTS]
    run = shipped.snakemake(*WITH_FIGURES, *paths, "--cores", 2)
    assert run.code == 0, run.text
    for name in WITH_FIGURES:
        for suffix in (".png", ".svg", ".pdf"):
            figure = shipped.folder / "results" / "tiny" / "figures" / f"{name}{suffix}"
            assert figure.stat().st_size > 1000
    return {
        name: splits.load(shipped.folder / path)
        for name, path in zip(FEW_EXPERIMENTS, paths, strict=True)
    }


def test_workflow_plans_all_experiments(shipped):
    run = shipped.snakemake("everything", "--dry-run", config="accuracy=standard")
    assert run.code == 0, run.text
    experiments = load_experiments(
        shipped.folder / "config" / "experiments", shipped.folder / "config" / "media"
    )
    retrieved = [one for one in experiments.values() if one.retrieve]
    returns = [one for one in experiments.values() if one.retrieve_return]
    with_figure = [
        experiment for experiment in experiments.values() if experiment.figure.get("kind") != "none"
    ]
    tables = [
        experiment for experiment in experiments.values() if experiment.instrument.kind == "table"
    ]
    for rule, count in (
        ("simulate", len(experiments) - len(tables)),
        ("figure", len(with_figure) - len(retrieved) - len(returns)),
        ("retrieve", len(retrieved)), ("retrieve_return", len(returns)),
        ("table", len(tables)), ("table_part", sum(map(count_parts, tables))), ("explorer_page", 1),
    ):  # fmt: skip
        assert re.search(rf"^{rule} +{count}$", run.text, re.MULTILINE)
    for rule in (
        "sensitivity", "agreement", "sand_trends", "sand_compositions", "angular_trends",
        "layer_trends", "surface_area", "interpretation_ranking", "sobol_indices_by_wavelength",
    ):  # fmt: skip
        assert re.search(rf"^{rule} +1$", run.text, re.MULTILINE)
    assert not (shipped.folder / "results" / "data").exists()


def test_rules_do_not_use_workflow_cores(shipped):
    """Snakemake rejects `workflow.cores` if `--cores` is missing, as in a check of the rules."""
    for path in (shipped.folder / "workflow").rglob("*.smk"):
        assert "workflow.cores" not in path.read_text(encoding="utf-8"), path


def test_snakemake_lint_reports_no_issue(shipped):
    run = shipped.snakemake("--lint", config="accuracy=standard")
    assert run.code == 0, run.text
    assert "in a good condition" in run.text


def test_representative_sample_has_published_values(few_datasets):
    sample = few_datasets["table1_sample"]
    assert sample.mean_grain_distance.sel(density_kg_m3=450) == pytest.approx(4.3e-4, rel=0.03)
    assert sample.specific_surface_area.values == pytest.approx(20.33, abs=0.01)
    assert sample.attrs["rays"] == int(sample.rays.sum())


@pytest.mark.usefixtures("few_datasets")
def test_quoted_numbers_can_be_read_from_these_runs(shipped, monkeypatch):
    results = shipped.folder / "results" / "tiny"
    numbers = values.QUOTED_NUMBERS.items()
    available = {key: one for key, one in numbers if one.source and (results / one.source).exists()}
    monkeypatch.setattr(values, "QUOTED_NUMBERS", available)
    assert set(values.collect_quoted_numbers(results)) == set(available)
    sources = {one.source for one in available.values()}
    assert {"data/snow_beam_spread.nc", "data/layer_fig02_lens.nc"} <= sources


def test_refractive_indices_have_published_values(few_datasets):
    indices = few_datasets["fig05_refractive_indices"]
    assert indices.material.values.tolist() == ["air", "water", "ice"]
    assert indices.n.sel(material="ice", wavelength=600) == pytest.approx(1.3094, abs=1e-4)
    assert (indices.n.sel(material="air") == 1.0).all()
    assert (indices.k >= 0.0).all()


def test_aviris_scene_matches_published_reflectance(few_datasets):
    scene = few_datasets["fig24b_aviris"]
    assert scene.attrs["incidence_deg"] == 62.3
    assert {842.25, 1073.76, 1237.93} <= set(scene.wavelength.values)
    total = scene.reflectance + scene.transmittance + scene.absorptance
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    selected = scene.sel(wavelength=[842.25, 1073.76, 1237.93])
    published = np.array([0.878, 0.692, 0.495])
    assert (
        np.abs(selected.reflectance - published) < 0.03 + 4.0 * selected.reflectance_stderr
    ).all()


@pytest.mark.long
def test_sand_studies_write_their_tables(shipped):
    studies = ("sand_trends", "sand_weights", "sand_colours", "sand_compositions")
    run = shipped.snakemake(*studies, "--cores", 2)
    assert run.code == 0, run.text
    tables = {
        path.stem: pd.read_csv(path)
        for path in (shipped.folder / "results" / "tiny" / "tables").glob("sand_*.csv")
    }
    # A run at this accuracy resolves few trends, but none may be opposite to those stated.
    assert not (tables["sand_trends"].verdict == "outside").any()
    volumes = tables["sand_compositions"].groupby(["experiment", "sample"]).volume_fraction.sum()
    np.testing.assert_allclose(volumes, 1.0, rtol=1e-5)
    assert len(tables["sand_colours"]) == 25
    assert len(tables["sand_weights"]) == 5 * (5 + 9 + 2)
