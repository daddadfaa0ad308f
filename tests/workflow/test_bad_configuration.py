"""Configurations that cannot be run: one clear message each, and nothing is started."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.slow

GOOD = "instrument: {wavelength_nm: [500]}\n"
# What is wrong, the experiment file, and what the message must hold.
BAD = {
    "misspelt key": ("medium: {saturaton: 0.1}", "medium.saturaton", "did you mean saturation?"),
    "density above that of ice": ("medium: {density_kg_m3: 950}", "density_kg_m3 = 950", "916.9"),
    "largest grain below smallest": (
        "medium: {grain_size_um: [750, 300]}",
        "grain_size_um = [750, 300]",
        "min <= max",
    ),
    "negative depth": ("medium: {depth_m: -0.1}", "depth_m = -0.1", "(0, 10000] m"),
    "wavelength too short": (
        "instrument: {wavelength_nm: [100]}",
        "wavelength_nm = 100.0",
        "[200, 100000] nm",
    ),
    "mean outside its range": (
        "medium: {facetness: [0.2, 0.4, 0.5, 0.072]}",
        "facetness = [0.2, 0.4, 0.5, 0.072]",
        "min <= mean <= max",
    ),
    "too much water": ("medium: {saturation: 1.2}", "saturation = 1.2", "[0, 1]"),
    "nothing on a grid": (
        "grid: {saturation: []}",
        "grid.saturation = []",
        "at least one value",
    ),
    "name with a slash": ("name: a/b", "name = 'a/b'", "letters, digits and underscores"),
    "not YAML": ("title: [1, 2\nmedium: {}", "line 2", "not YAML"),
}


@pytest.fixture(scope="module")
def refused(make_project, tmp_path_factory):
    """Return a run with all bad files beside a good one, and the project."""
    project = make_project(tmp_path_factory.mktemp("refused"))
    project.put("good", GOOD)
    for what, (text, *_) in BAD.items():
        project.put(file_of(what), f"{text}\n")
    return project.snakemake("--cores", 1), project


def file_of(what):
    return what.replace(" ", "_")


def check_refusal(run, file, key, allowed):
    """Assert that one line tells of a file, whole and by its place."""
    lines = [line for line in run.text.splitlines() if f"{file}.yaml" in line]
    assert len(lines) == 1, run.text
    assert lines[0].startswith(f"config/experiments/{file}.yaml")
    assert key in lines[0]
    assert allowed in lines[0]


def check_nothing_ran(run, project):
    assert run.code != 0
    assert "Traceback" not in run.text
    assert run.jobs() == []
    assert not (project.folder / "results").exists()


@pytest.mark.parametrize("what", BAD)
def test_bad_experiments_are_refused_before_anything_runs(refused, what):
    run, project = refused
    check_refusal(run, file_of(what), *BAD[what][1:])
    check_nothing_ran(run, project)


@pytest.mark.parametrize("what", ["misspelt key", "not YAML"])
def test_one_bad_experiment_stops_the_good_one(project, what):
    text, key, allowed = BAD[what]
    project.put("good", GOOD)
    project.put("wrong", f"{text}\n")
    run = project.snakemake("--cores", 1)
    check_refusal(run, "wrong", key, allowed)
    check_nothing_ran(run, project)


def test_all_bad_experiments_are_told_at_once(project):
    project.put("good", GOOD)
    project.put("one", "titel: x\n")
    project.put("two", "instrument: {wavelength_nm: 500}\n")
    run = project.snakemake("--cores", 1, "good")
    lines = [line for line in run.text.splitlines() if line.startswith("config/experiments")]
    assert len(lines) == 2, run.text
    assert lines[0].startswith("config/experiments/one.yaml: titel: unknown key")
    assert lines[1].startswith("config/experiments/two.yaml: instrument.wavelength_nm = 500: must")
    check_nothing_ran(run, project)


def test_a_misspelt_setting_on_the_command_line_is_refused(project):
    project.put("good", GOOD)
    run = project.snakemake("--cores", 1, config="accuracy=drafd")
    lines = [line for line in run.text.splitlines() if line.startswith("config/config.yaml")]
    assert len(lines) == 1, run.text
    assert "accuracy = 'drafd'" in lines[0]
    assert "did you mean draft?" in lines[0]
    check_nothing_ran(run, project)
