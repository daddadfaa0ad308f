"""Digest of the sources of a simulation, for datasets and for the workflow."""

import shutil

import pytest

from splits.core import provenance
from splits.core.provenance import (
    FIT_SOURCES,
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
    copied, copied_fit = digest(), digest(fit=True)
    assert (copied, copied_fit) == (hash_physics_sources(), hash_physics_sources(fit=True))
    assert copied != copied_fit


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
def test_physics_sources_change_both_digests(package, name):
    before = digest(), digest(fit=True)
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert all(old != new for old, new in zip(before, (digest(), digest(fit=True)), strict=True))


@pytest.mark.parametrize("name", FIT_SOURCES)
def test_fit_sources_change_the_digest_of_fits_only(package, name):
    before = digest(), digest(fit=True)
    with open(package / name, "a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert digest() == before[0] and digest(fit=True) != before[1]


def test_a_moved_file_changes_the_digest(package):
    before = digest()
    (package / "media" / "snow.py").rename(package / "materials" / "snow.py")
    assert digest() != before


def test_plotting_and_analysis_do_not_change_the_digest(package):
    before = digest(fit=True)
    for name in ("plotting/lines.py", "analysis/colour.py", "kernels/notes.txt"):
        with open(package / name, "a", encoding="utf-8") as file:
            file.write("# changed\n")
    assert digest(fit=True) == before


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
