"""The archive: data, figures, configuration and versions, with checksums that verify."""

from __future__ import annotations

import hashlib
import json
import zipfile

import pytest

import splits
from splits.archive import pack

EXPERIMENT = "title: Alone\nmedium: {depth_m: 0.01}\ninstrument: {wavelength_nm: [500, 900]}\n"
ALWAYS = {"README.md", "SHA256SUMS", "versions.json"}


def contents(path):
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        return {name: file.read(name) for name in file.namelist()}


def verify(members):
    """Check that SHA256SUMS lists every other member, and rightly so."""
    lines = members["SHA256SUMS"].decode().splitlines()
    sums = {name: digest for digest, name in (line.split("  ") for line in lines)}
    assert set(sums) == set(members) - {"SHA256SUMS"}
    for name, digest in sums.items():
        assert hashlib.sha256(members[name]).hexdigest() == digest


@pytest.mark.slow
def test_the_archive_target(project, tmp_path):
    project.put("alone", EXPERIMENT)
    run = project.snakemake("archive", "--cores", 1)
    assert run.code == 0, run.text
    members = contents(tmp_path / "results" / "tiny" / "archive" / "splits-results.zip")
    assert set(members) >= ALWAYS
    assert {"data/alone.nc", "figures/alone.png", "figures/alone.svg"} <= set(members)
    assert {"config/config.yaml", "config/media/splitsnow_table1.yaml"} <= set(members)
    assert members["config/experiments/alone.yaml"].decode() == EXPERIMENT
    versions = json.loads(members["versions.json"])
    assert {"numpy", "numba", "snakemake", "xarray"} <= {name.lower() for name in versions}
    verify(members)
    (tmp_path / "from_archive.nc").write_bytes(members["data/alone.nc"])
    assert splits.load(tmp_path / "from_archive.nc").attrs["experiment"] == "alone"


@pytest.mark.slow
def test_the_report_needs_no_cores(project, tmp_path):
    project.put("alone", EXPERIMENT)
    assert project.snakemake("alone", "--cores", 1).code == 0
    run = project.snakemake("alone", "--report", "report.html")
    assert run.code == 0, run.text
    assert "alone" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_packing_keeps_relative_places(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("out/data/a.nc", "out/tables/b.csv", "config/c.yaml", "config/deep/d.yaml"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    pack(["out/data/a.nc", "out/tables/b.csv"], ["config"], "out/archive/made.zip")
    members = contents("out/archive/made.zip")
    assert set(members) - ALWAYS == {
        "data/a.nc", "tables/b.csv", "config/c.yaml", "config/deep/d.yaml",
    }  # fmt: skip
    assert members["config/deep/d.yaml"] == b"config/deep/d.yaml"
    verify(members)


def test_nothing_is_left_when_a_result_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.nc"):
        pack([tmp_path / "out" / "data" / "a.nc"], [], tmp_path / "out" / "archive" / "made.zip")
    assert not list(tmp_path.rglob("*.zip"))
