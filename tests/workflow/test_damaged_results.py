"""Damaged datasets in a workflow are reported, set aside and computed again."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
import xarray as xr

import splits
from splits.io.netcdf import drop_run_specific_attributes

pytestmark = [pytest.mark.slow, pytest.mark.long]

EXPERIMENT = "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
NAMES = ("damaged", "swapped", "sound")
KILLED_PROGRAM = """
import os, signal, sys
from splits.core.atomic import atomic_write

with atomic_write(sys.argv[1]) as aside:
    aside.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_damaged_and_swapped_datasets_are_computed_again(project):
    for name in NAMES:
        project.put(name, EXPERIMENT)
    files = [f"results/tiny/data/{name}.nc" for name in NAMES]
    run = project.snakemake(*files, "--cores", 2)
    assert run.code == 0, run.text
    data = project.folder / "results" / "tiny" / "data"
    before = {name: splits.load(data / f"{name}.nc") for name in NAMES}
    content = bytearray((data / "damaged.nc").read_bytes())
    content[len(content) // 2 :] = bytes(len(content) - len(content) // 2)
    (data / "damaged.nc").write_bytes(content)
    shutil.copy(data / "sound.nc", data / "swapped.nc")
    subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(data / "sound.nc")])
    (temporary_file,) = data.glob(".aside.*.sound.nc")

    dry = project.snakemake(*files, "--dry-run")
    assert "damaged.nc: damaged" in dry.text
    assert (data / "damaged.nc").read_bytes() == content
    assert temporary_file.exists()

    run = project.snakemake(*files, "--cores", 2)
    assert run.code == 0, run.text
    assert run.jobs() == ["Simulating damaged", "Simulating swapped"]
    for name, reason in (("damaged", "damaged, "), ("swapped", "holds the dataset of")):
        (line,) = [x for x in run.text.splitlines() if f"data/{name}.nc: " in x]
        assert reason in line
        assert f"set aside as {name}.nc.damaged" in line
        xr.testing.assert_identical(
            drop_run_specific_attributes(splits.load(data / f"{name}.nc")),
            drop_run_specific_attributes(before[name]),
        )
    assert (data / "damaged.nc.damaged").read_bytes() == content
    assert not list(data.glob(".aside.*"))


@pytest.mark.parametrize(
    "command",
    [
        "--summary", "--lint", "--list-rules", "--dag", "--rulegraph", "--unlock", "--touch -c 1",
        "--dry-run", "-n", "--workflow-profile plan", "--report made.html",
    ],
)  # fmt: skip
def test_commands_that_run_no_job_change_no_file(project, command):
    project.put("plain", EXPERIMENT)
    data = project.folder / "results" / "tiny" / "data"
    data.mkdir(parents=True)
    names = ("plain.nc", ".aside.host.2147483647.abcdefgh.plain.nc")
    for name in names:
        (data / name).write_text("not a dataset", "utf-8")
    stale = data / names[1]
    os.utime(stale, (0, 0))
    (project.folder / "plan").mkdir()
    (project.folder / "plan" / "config.yaml").write_text("dry-run: true\n", "utf-8")
    run = project.snakemake("results/tiny/data/plain.nc", *command.split())
    assert {path.name for path in data.iterdir()} == set(names), run.text
    reports = command in ("--dry-run", "-n", "--workflow-profile plan", "--touch -c 1")
    assert ("plain.nc: damaged" in run.text) == reports, run.text


def test_stale_files_are_removed_before_jobs_run(project):
    project.put("plain", EXPERIMENT)
    data = project.folder / "results" / "tiny" / "data"
    data.mkdir(parents=True)
    (data / "plain.nc").write_text("not a dataset", "utf-8")
    run = project.snakemake("results/tiny/data/plain.nc", "--cores", 1)
    assert run.code == 0 and run.jobs() == ["Simulating plain"], run.text
    assert (data / "plain.nc.damaged").exists()
