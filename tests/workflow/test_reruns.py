"""A workflow of two small experiments: what it makes, and what a change makes it do again."""

from __future__ import annotations

import pytest
import xarray as xr

import splits
from splits.io.netcdf import drop_run_specific_attributes

pytestmark = pytest.mark.slow

FIRST = """\
title: First
caption: Of two.
medium: {base: splitsnow_table1, depth_m: 0.01}
instrument: {wavelength_nm: [500, 1030]}
"""
SECOND = """\
title: Second
medium: {base: splitsnow_table1, depth_m: 0.01}
instrument: {wavelength_nm: [500, 800, 1500], incidence_deg: diffuse}
grid: {saturation: [0, 0.1]}
figure: {quantity: [reflectance, transmittance]}
"""
THIRD = """\
title: Third
medium: {base: splitsnow_table1, depth_m: 0.01}
instrument: {wavelength_nm: [700]}
grid:
  density_kg_m3: [200, 300]
figure: {kind: points}
"""
RESULTS = "results/tiny"


def made_by(name):
    return [f"data/{name}.nc", *(f"figures/{name}.{kind}" for kind in ("pdf", "png", "svg"))]


def data_file(project, name):
    return project.folder / RESULTS / "data" / f"{name}.nc"


@pytest.fixture(scope="module")
def finished(make_project, tmp_path_factory):
    """Return a project whose two experiments have run on one core."""
    project = make_project(tmp_path_factory.mktemp("finished"))
    project.put("first", FIRST)
    project.put("second", SECOND)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    return project


@pytest.fixture
def again(finished, tmp_path):
    """Return a copy of the finished project, to be changed."""
    return finished.copy(tmp_path)


def test_data_and_figures_are_made(finished):
    assert finished.results(RESULTS) == sorted(made_by("first") + made_by("second"))
    assert (finished.folder / RESULTS / "logs" / "simulate" / "first.log").stat().st_size > 0
    first = splits.load(data_file(finished, "first"))
    assert first.sizes["wavelength"] == 2
    assert first.attrs["experiment"] == "first"
    second = splits.load(data_file(finished, "second"))
    assert second.reflectance.dims == ("saturation", "wavelength")
    assert second.attrs["max_stderr_reached"] <= 0.05
    for variable in [*first.variables.values(), *second.data_vars.values()]:
        assert variable.attrs["long_name"] and variable.attrs["units"]


def test_a_second_run_has_nothing_to_do(again):
    run = again.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert "Nothing to be done" in run.text
    assert run.jobs() == []


def test_a_change_reruns_what_depends_on_it(again):
    """Words of the first, a value of the second, and a third that is new."""
    assert len(THIRD.splitlines()) <= 12
    untouched = data_file(again, "first").stat().st_mtime_ns
    words = FIRST.replace("title: First", "title: Number one").replace("Of two", "Of several")
    again.put("first", words)
    again.put("second", SECOND.replace("depth_m: 0.01", "depth_m: 0.02"))
    again.put("third", THIRD)
    run = again.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert run.jobs() == [
        "Drawing first", "Drawing second", "Drawing third", "Simulating second", "Simulating third",
    ]  # fmt: skip
    assert data_file(again, "first").stat().st_mtime_ns == untouched
    assert splits.load(data_file(again, "second")).attrs["snow_depth_m"] == 0.02
    assert set(made_by("third")) <= set(again.results(RESULTS))


def test_a_name_plans_that_experiment_only(project):
    project.put("second", SECOND)
    project.put("third", THIRD)
    run = project.snakemake("third", "--dry-run")
    assert run.code == 0, run.text
    assert run.jobs() == ["Drawing third", "Simulating third"]


def test_threads_do_not_change_the_numbers(finished, project):
    project.put("first", FIRST)
    project.put("second", SECOND)
    names = ("first", "second")
    targets = [f"{RESULTS}/data/{name}.nc" for name in names]
    run = project.snakemake(*targets, "--cores", 2, "--set-threads", "simulate=2")
    assert run.code == 0, run.text
    assert run.jobs() == ["Simulating first", "Simulating second"]
    for name in names:
        two, one = (splits.load(data_file(p, name)) for p in (project, finished))
        assert (two.attrs["threads"], one.attrs["threads"]) == (2, 1)
        xr.testing.assert_identical(
            drop_run_specific_attributes(two), drop_run_specific_attributes(one)
        )
