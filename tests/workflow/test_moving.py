"""Moved clones with results: no job runs again, and no record has an absolute path."""

import os
import shutil
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.long]

ROOT = Path(__file__).parents[2]
INDICES = "title: Indices\ninstrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
CLONED_PATHS = ("Snakefile", "workflow", "profiles", "splits", "environment.yml", "benchmarks")


@pytest.fixture(scope="module")
def finished(make_project, tmp_path_factory):
    """Return the project of a clone whose experiment has run."""
    clone = tmp_path_factory.mktemp("moving") / "clone"
    project = make_project(clone)
    for part in CLONED_PATHS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
        copy(ROOT / part, clone / part)
    project = make_clone_project(project, clone)
    project.put("indices", INDICES)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    return project


def make_clone_project(project, clone, folder=None):
    """Return a project that uses the package and the rules of a clone, by default inside it."""
    environment = project.environment | {"PYTHONPATH": str(clone)}
    return type(project)(folder or clone, environment, clone / "Snakefile")


@pytest.fixture
def moved(finished, tmp_path):
    """Return a copy of the clone under another name, with the same modification times."""
    shutil.copytree(finished.folder, tmp_path / "elsewhere")
    return make_clone_project(finished, tmp_path / "elsewhere")


def has_nothing_to_do(project):
    run = project.snakemake("--dry-run")
    assert run.code == 0, run.text
    return "Nothing to be done" in run.text


def test_moved_clone_has_nothing_to_do(moved):
    assert has_nothing_to_do(moved)


def test_project_outside_the_clone_is_independent_of_its_path(finished, moved, tmp_path):
    shutil.copytree(finished.folder / "config", tmp_path / "own" / "config")
    project = make_clone_project(finished, finished.folder, tmp_path / "own")
    assert project.snakemake("--cores", 1).code == 0
    assert has_nothing_to_do(make_clone_project(finished, moved.folder, tmp_path / "own"))


def test_records_and_report_contain_no_absolute_path(finished):
    records = [p for p in (finished.folder / ".snakemake" / "metadata").rglob("*") if p.is_file()]
    assert records
    report = finished.folder / "results" / "tiny" / "report.html"
    assert "Indices" in report.read_text(encoding="utf-8")
    for path in [*records, report]:
        text = path.read_text(encoding="utf-8")
        # The home of some users is the root folder, which is in every path.
        for folder in {finished.folder, finished.folder.parent, ROOT, Path.home()} - {Path("/")}:
            assert str(folder) + os.sep not in text, path


def test_only_changed_physics_sources_rerun_simulations(moved):
    package = moved.folder / "splits"
    for touched in (package / "media" / "snow.py", package / "instruments" / "lens.py"):
        os.utime(touched)
    for name, jobs in (
        ("retrieval/retrieve.py", []),
        ("plotting/grammar.py", ["Drawing indices", "Writing the report"]),
    ):
        with open(package / name, "a", encoding="utf-8") as file:
            file.write("# changed\n")
        assert moved.snakemake("--dry-run").jobs() == jobs
    with open(package / "media" / "snow.py", "a", encoding="utf-8") as file:
        file.write("# changed\n")
    run = moved.snakemake("--dry-run")
    assert run.jobs() == ["Drawing indices", "Simulating indices", "Writing the report"]
