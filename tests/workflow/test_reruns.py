"""Outputs of a workflow of two small experiments, and jobs that run again after changes."""

import pytest
import xarray as xr
from run_attributes import drop_run_specific_attributes

import splits

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


def list_outputs(name):
    return [f"data/{name}.nc", *(f"figures/{name}.{kind}" for kind in ("pdf", "png", "svg"))]


def get_data_path(project, name):
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
def project_copy(finished, tmp_path):
    """Return a copy of the finished project that a test may change."""
    return finished.copy(tmp_path)


def test_data_and_figures_are_written(finished):
    outputs = [*list_outputs("first"), *list_outputs("second"), "report.html"]
    assert finished.results(RESULTS) == sorted(outputs)
    assert (finished.folder / RESULTS / "logs" / "simulate" / "first.log").stat().st_size > 0
    first = splits.load(get_data_path(finished, "first"))
    assert first.sizes["wavelength"] == 2
    assert first.attrs["experiment"] == "first"
    second = splits.load(get_data_path(finished, "second"))
    assert second.reflectance.dims == ("saturation", "wavelength")
    assert second.attrs["max_stderr_reached"] <= 0.05
    for variable in [*first.variables.values(), *second.data_vars.values()]:
        assert variable.attrs["long_name"] and variable.attrs["units"]


@pytest.mark.long
def test_second_run_has_nothing_to_do(project_copy):
    run = project_copy.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert "Nothing to be done" in run.text
    assert run.jobs() == []


@pytest.mark.long
def test_changed_title_writes_only_the_report_again(project_copy):
    project_copy.put("first", FIRST.replace("title: First", "title: Number {one}"))
    assert project_copy.snakemake("--dry-run").jobs() == ["Writing the report"]


def test_change_reruns_only_dependent_jobs(project_copy):
    """Changes are a caption of the first, a value of the second, and a new third experiment."""
    assert len(THIRD.splitlines()) <= 12
    untouched = get_data_path(project_copy, "first").stat().st_mtime_ns
    changed = FIRST.replace("title: First", "title: Number one").replace("Of two", "Of several")
    project_copy.put("first", changed)
    project_copy.put("second", SECOND.replace("depth_m: 0.01", "depth_m: 0.02"))
    project_copy.put("third", THIRD)
    run = project_copy.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert run.jobs() == [
        "Drawing second", "Drawing third", "Simulating second", "Simulating third",
        "Writing the report",
    ]  # fmt: skip
    report = (project_copy.folder / RESULTS / "report.html").read_text(encoding="utf-8")
    assert "Number one" in report and "Of several." in report and ">Third<" in report
    assert get_data_path(project_copy, "first").stat().st_mtime_ns == untouched
    assert splits.load(get_data_path(project_copy, "second")).attrs["snow_depth_m"] == 0.02
    assert set(list_outputs("third")) <= set(project_copy.results(RESULTS))


@pytest.mark.long
def test_target_name_plans_that_experiment_only(project):
    project.put("second", SECOND)
    project.put("third", THIRD)
    run = project.snakemake("third", "--dry-run")
    assert run.code == 0, run.text
    assert run.jobs() == ["Drawing third", "Simulating third"]


@pytest.mark.long
def test_number_of_threads_does_not_change_results(finished, project):
    project.put("first", FIRST)
    project.put("second", SECOND)
    names = ("first", "second")
    targets = [f"{RESULTS}/data/{name}.nc" for name in names]
    run = project.snakemake(*targets, "--cores", 2, "--set-threads", "simulate=2")
    assert run.code == 0, run.text
    assert run.jobs() == ["Simulating first", "Simulating second"]
    for name in names:
        two, one = (splits.load(get_data_path(p, name)) for p in (project, finished))
        assert (two.attrs["threads"], one.attrs["threads"]) == (2, 1)
        xr.testing.assert_identical(
            drop_run_specific_attributes(two),
            drop_run_specific_attributes(one),
        )


@pytest.mark.long
def test_changed_files_of_media_run_their_experiments_again(project):
    layer = "kind: particle_layer, optical_thickness: 1, single_scattering_albedo: 0.9"
    (project.folder / "kept").mkdir()
    table = project.folder / "kept" / "mie.txt"
    rows = [f"{angle},{angle + 1},0,0,0" for angle in (0, 90, 180)]
    table.write_text("\n".join(["angle_deg,P11,P12,P33,P34", *rows, ""]), encoding="utf-8")
    (project.folder / "link").symlink_to(table)
    for name, path in (("linked", "link"), ("dotted", "./kept/mie.txt"), ("full", table)):
        instrument = "{wavelength_nm: [550]}\nfigure: none"
        text = f"medium: {{{layer}, scattering_matrix: {path}}}\ninstrument: {instrument}\n"
        project.put(name, text)
    names = ("linked", "dotted", "full")
    run = project.snakemake(*names, "--cores", 1)
    assert run.code == 0, run.text
    assert project.snakemake(*names, "--dry-run").jobs() == []
    table.write_text(table.read_text("utf-8").replace("0,1,0", "0,300,0"), encoding="utf-8")
    expected = ["Simulating dotted", "Simulating full", "Simulating linked"]
    assert project.snakemake(*names, "--dry-run").jobs() == expected
