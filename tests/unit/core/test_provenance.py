"""Digest of the sources of a simulation, for datasets and for the workflow."""

import shutil

import pytest

from splits.core import provenance
from splits.core.provenance import (
    PACKAGE_FOLDER,
    STUDY_SOURCES,
    hash_physics_sources,
    hash_sources,
)

digest = hash_physics_sources.__wrapped__


@pytest.fixture
def package(monkeypatch, tmp_path):
    """Return a copy of the package, from which digests are computed."""
    copy = tmp_path / "elsewhere"
    shutil.copytree(PACKAGE_FOLDER, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "PACKAGE_FOLDER", copy)
    return copy


def test_digest_is_independent_of_the_location(package):
    assert digest() == hash_physics_sources()


def test_digest_is_independent_of_line_endings(package):
    before = digest()
    path = package / "media" / "snow.py"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert digest() == before


@pytest.mark.parametrize(
    "name",
    [
        "materials/refractive_index.py",
        "media/snow.py",
        "kernels/vectorized/trace.py",
        "simulation/engine.py",
        "experiments/run.py",
        "experiments/config/instruments.py",
        "experiments/config/simulation.py",
        "experiments/config/media.py",
    ],
)
def test_physics_sources_change_the_digest(package, name):
    before = digest()
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert digest() != before


def test_a_moved_file_changes_the_digest(package):
    before = digest()
    (package / "media" / "snow.py").rename(package / "materials" / "snow.py")
    assert digest() != before


def test_plotting_and_analysis_do_not_change_the_digest(package):
    before = digest()
    for name in ("plotting/lines.py", "analysis/colour.py", "kernels/notes.txt"):
        with open(package / name, "a", encoding="utf-8") as file:
            file.write("# changed\n")
    assert digest() == before


@pytest.mark.parametrize(
    "name", ["analysis/colour.py", "illumination/bands.py", "plotting/paper.mplstyle"]
)
def test_sources_of_studies_change_their_digest(package, name):
    before = hash_sources(STUDY_SOURCES)
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert hash_sources(STUDY_SOURCES) != before


@pytest.mark.parametrize("names", [value for key, value in vars(provenance).items()
                                   if key.endswith("_SOURCES")])  # fmt: skip
def test_all_listed_sources_exist(names):
    for name in names:
        assert list(PACKAGE_FOLDER.glob(name)), name
