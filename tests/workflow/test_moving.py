"""A clone with its results, moved: nothing is made again, and nothing says where it lay."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
INDICES = "title: Indices\ninstrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
PARTS = ("Snakefile", "workflow", "profiles", "splits", "environment.yml", "benchmarks")


@pytest.fixture(scope="module")
def finished(make_project, tmp_path_factory):
    """Return a folder with a clone whose experiment has run and been reported."""
    clone = tmp_path_factory.mktemp("moving") / "clone"
    project = make_project(clone)
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
        copy(ROOT / part, clone / part)
    project = at(project, clone)
    project.put("indices", INDICES)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    run = project.snakemake("--report", "report.html")
    assert run.code == 0, run.text
    assert "indices" in (clone / "report.html").read_text(encoding="utf-8")
    return project


def at(project, clone, folder=None):
    """Return a project that uses the package and the rules of a clone, by default inside it."""
    environment = project.environment | {"PYTHONPATH": str(clone)}
    return type(project)(folder or clone, environment, clone / "Snakefile")


@pytest.fixture
def moved(finished, tmp_path):
    """Return a copy of the clone under another name; its files are as old as they were."""
    shutil.copytree(finished.folder, tmp_path / "elsewhere")
    return at(finished, tmp_path / "elsewhere")


def nothing_to_do(project):
    run = project.snakemake("--dry-run")
    assert run.code == 0, run.text
    return "Nothing to be done" in run.text


def test_a_moved_clone_has_nothing_to_do(moved):
    assert nothing_to_do(moved)


def test_a_project_outside_of_the_clone_does_not_ask_where_that_lies(finished, moved, tmp_path):
    shutil.copytree(finished.folder / "config", tmp_path / "own" / "config")
    project = at(finished, finished.folder, tmp_path / "own")
    assert project.snakemake("--cores", 1).code == 0
    assert nothing_to_do(at(finished, moved.folder, tmp_path / "own"))


def test_records_and_the_report_hold_no_absolute_path(finished):
    records = [p for p in (finished.folder / ".snakemake" / "metadata").rglob("*") if p.is_file()]
    assert records
    for path in [*records, finished.folder / "report.html"]:
        text = path.read_text(encoding="utf-8")
        # The home of a user without one is the root, which is in every path.
        for place in {finished.folder, finished.folder.parent, ROOT, Path.home()} - {Path("/")}:
            assert str(place) + os.sep not in text, path


def test_only_a_changed_source_of_physics_reruns_simulations(moved):
    package = moved.folder / "splits"
    for touched in (package / "media" / "snow.py", package / "instruments" / "lens.py"):
        os.utime(touched)
    for name in (
        "experiments/papers/paper_tables.py",
        "plotting/style.py",
        "retrieval/sand_fit.py",
    ):
        with open(package / name, "a", encoding="utf-8") as file:
            file.write("# changed\n")
    assert nothing_to_do(moved)
    with open(package / "media" / "snow.py", "a", encoding="utf-8") as file:
        file.write("# changed\n")
    run = moved.snakemake("--dry-run")
    assert run.jobs() == ["Drawing indices", "Simulating indices"]
