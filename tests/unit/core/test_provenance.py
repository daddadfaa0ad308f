"""Digest of the sources of a simulation, for datasets and for the workflow."""

from __future__ import annotations

import shutil

import pytest

from splits.core import provenance
from splits.core.provenance import FIT_SOURCES, PACKAGE_FOLDER, hash_physics_sources

digest = hash_physics_sources.__wrapped__


@pytest.fixture
def package(monkeypatch, tmp_path):
    """Return a copy of the package that is asked instead."""
    copy = tmp_path / "elsewhere"
    shutil.copytree(PACKAGE_FOLDER, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "PACKAGE_FOLDER", copy)
    return copy


def test_the_place_of_the_package_does_not_matter(package):
    there, fit = digest(), digest(fit=True)
    assert (there, fit) == (hash_physics_sources(), hash_physics_sources(fit=True))
    assert there != fit


def test_the_ends_of_lines_do_not_matter(package):
    before = digest()
    path = package / "media" / "snow.py"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert digest() == before


@pytest.mark.parametrize(
    "name",
    [
        "materials/mixing.py",
        "media/snow.py",
        "kernels/vectorized/batch.py",
        "simulation/runner.py",
        "experiments/run.py",
        "experiments/run_points.py",
    ],
)
def test_a_change_of_physics_changes_both_digests(package, name):
    before = digest(), digest(fit=True)
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert all(
        one != other for one, other in zip(before, (digest(), digest(fit=True)), strict=True)
    )


@pytest.mark.parametrize("name", FIT_SOURCES)
def test_a_change_of_fitting_changes_the_digest_of_fits_only(package, name):
    before = digest(), digest(fit=True)
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert digest() == before[0] and digest(fit=True) != before[1]


def test_a_moved_file_changes_the_digest(package):
    before = digest()
    (package / "media" / "snow.py").rename(package / "materials" / "snow.py")
    assert digest() != before


def test_what_draws_and_compares_does_not_count(package):
    before = digest(fit=True)
    for name in ("plotting/lines.py", "analysis/colour.py", "kernels/notes.txt"):
        with open(package / name, "a", encoding="utf-8") as file:
            file.write("# changed\n")
    assert digest(fit=True) == before
