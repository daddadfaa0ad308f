"""The command line interface `splits`."""

import subprocess
import sys

import pandas as pd
import pytest
import yaml
from chi2 import NEEDS_JIT
from shipped import CONFIG

import splits
from splits import cli
from splits.kernels.compiler import cache

SMALL = """
title: Small
medium: {kind: snow, depth_m: 0.005}
instrument: {wavelength_nm: [800, 1300]}
grid: {saturation: [0, 0.5]}
"""


def test_accuracy_presets_match_the_shipped_configuration():
    shipped = yaml.safe_load((CONFIG / "config.yaml").read_text("utf-8"))
    presets = {
        name: {"max_stderr": absolute, "relative_stderr": relative}
        for name, (absolute, relative) in cli.ACCURACY_PRESETS.items()
    }
    assert presets == shipped["accuracies"]


@pytest.mark.long
@NEEDS_JIT
def test_run_writes_a_dataset_and_a_figure(tmp_path, capsys):
    file = tmp_path / "small.yaml"
    file.write_text(SMALL, encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-m", "splits.cli", "run", file, "--output", tmp_path / "made",
         "--accuracy", "tiny", "--seed", "3", "--threads", "1"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    dataset = splits.load(tmp_path / "made" / "small.nc")
    assert dataset.reflectance.dims == ("saturation", "wavelength")
    assert dataset.attrs["seed"] == 3
    assert (tmp_path / "made" / "small.png").is_file()
    assert result.stdout.splitlines() == [
        str(tmp_path / "made" / "small.nc"), str(tmp_path / "made" / "small.png"),
    ]  # fmt: skip
    assert "small 1/2 saturation=0: done" in result.stderr


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("medium: {saturation: 2}\n", [], "medium.saturation = 2: must be in [0, 1]"),
        (SMALL, ["--seed", "-1"], "--seed = -1: must be a whole number of at least 0"),
        (SMALL, ["--threads", "0"], "threads = 0: must be a whole number of at least 1"),
    ],
)
def test_invalid_runs_are_reported_in_one_line(tmp_path, capsys, text, options, message):
    file = tmp_path / "bad.yaml"
    file.write_text(text, encoding="utf-8")
    assert cli.main(["run", str(file), "--output", str(tmp_path / "made"), *options]) == 1
    line = capsys.readouterr().err
    assert line.startswith("splits: ") and message in line and line.count("\n") == 1
    assert not (tmp_path / "made").exists()


def test_a_result_does_not_replace_an_input(tmp_path, capsys):
    rows = {"time": ["2024-02-01"], "layer": [0], "thickness_m": [0.5], "density_kg_m3": [300.0],
            "specific_surface_area_m2_kg": [20.0]}  # fmt: skip
    season, file = tmp_path / "season.nc", tmp_path / "season.yaml"
    splits.save(splits.SnowPacks(pd.DataFrame(rows)).dataset, season)
    before = season.read_bytes()
    file.write_text(
        f"medium: {{kind: snow_packs, file: {season}}}\ninstrument: {{wavelength_nm: [500]}}\n"
        "figure: {kind: none}\n"
    )
    assert cli.main(["run", str(file), "--output", str(tmp_path)]) == 1
    message = f"'season': must be another name: the result would replace the input {season} (set"
    assert message in capsys.readouterr().err and season.read_bytes() == before
    assert cli.main(["run", str(file), "--output", str(tmp_path / "made")]) == 0


def test_a_missing_file_is_reported_in_one_line(tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "none.yaml")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_missing_extra_is_reported(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "yaml", None)
    assert cli.main(["run", str(tmp_path / "any.yaml")]) == 1
    message = "experiment files need the package yaml: pip install '.[experiments]' "
    assert message in capsys.readouterr().err


def test_versions_list_the_package_and_its_dependencies(capsys):
    assert cli.main(["versions"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"splits-optics {splits.__version__} (commit ")
    assert {"numba", "xarray"} <= {line.split()[0] for line in lines}


def test_cached_kernels_are_counted_and_cleared(tmp_path, capsys, monkeypatch):
    (tmp_path / "a.nbc").write_bytes(b"x" * 2000)
    monkeypatch.setattr(cache, "find_cache_folder", lambda: tmp_path)
    assert cli.main(["cache"]) == 0
    assert (
        capsys.readouterr().out
        == f"{tmp_path}: 1 compiled kernels, 0 results of paths through grains, 0.0 MB\n"
    )
    assert cli.main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out.endswith("deleted 1\n")
    assert list(tmp_path.iterdir()) == []


def test_the_package_runs_the_same_command():
    outputs = [
        subprocess.run(
            [sys.executable, "-m", name, "run", "--help"], capture_output=True, text=True
        )
        for name in ("splits", "splits.cli")
    ]
    assert outputs[0].returncode == 0 and outputs[0].stdout == outputs[1].stdout
