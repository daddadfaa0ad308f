"""Damaged datasets in a workflow: one line that names the file, and what makes it again."""

import subprocess
import sys

import pytest
import xarray as xr
from run_attributes import drop_run_specific_attributes

import splits

pytestmark = [pytest.mark.slow, pytest.mark.long]

EXPERIMENT = "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
NAMES = ("damaged", "sound")
KILLED_PROGRAM = """
import os, signal, sys
from splits.core.atomic import atomic_write

with atomic_write(sys.argv[1]) as aside:
    aside.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_damaged_datasets_are_named_and_made_again_after_deletion(project):
    for name in NAMES:
        project.put(name, EXPERIMENT)
    figures = [f"results/tiny/figures/{name}.png" for name in NAMES]
    run = project.snakemake(*figures, "--cores", 2)
    assert run.code == 0, run.text
    data = project.folder / "results" / "tiny" / "data"
    before = {name: splits.load(data / f"{name}.nc") for name in NAMES}
    content = bytearray((data / "damaged.nc").read_bytes())
    content[len(content) // 2 :] = bytes(len(content) - len(content) // 2)
    (data / "damaged.nc").write_bytes(content)
    subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(data / "sound.nc")])

    run = project.snakemake(*figures, "--cores", 2)
    assert run.code != 0 and "Traceback" not in run.text
    (line,) = [line for line in run.text.splitlines() if "damaged.nc: damaged, " in line]
    assert line.startswith("results/tiny/data/damaged.nc: damaged, ")
    assert line.endswith("(type: rm results/tiny/data/damaged.nc, and run again)")
    assert (data / "damaged.nc").read_bytes() == content

    (data / "damaged.nc").unlink()
    run = project.snakemake(*figures, "--cores", 2)
    assert run.code == 0, run.text
    assert run.jobs() == ["Drawing damaged", "Simulating damaged"]
    for name in NAMES:
        xr.testing.assert_identical(
            drop_run_specific_attributes(splits.load(data / f"{name}.nc")),
            drop_run_specific_attributes(before[name]),
        )
