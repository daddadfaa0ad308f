"""Kills: whatever a run of the workflow was at, nothing is half, and the next run leaves nothing.

Four kills by default, one of each kind.  The campaign proper is ``make campaign``, or

    KILLS=60 python -m pytest -s tests/workflow/test_kills.py
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import time
import zipfile

import matplotlib.image
import pytest
import xarray as xr

import splits
from splits.dataset import without_volatile

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("KILLS", "4"))
RESULTS = "results/tiny"
EXPERIMENTS = {
    "one": "medium: {base: splitsnow_table1, depth_m: 0.01}\n"
    "instrument: {wavelength_nm: [500, 1030]}\ngrid: {saturation: [0, 0.1]}\n",
    "two": "medium: {kind: layer, optical_thickness: 2}\ninstrument: {wavelength_nm: [550]}\n",
}
ARCHIVE = "archive/splits-results.zip"
MADE = [
    *(f"data/{name}.nc" for name in EXPERIMENTS),
    *(f"figures/{name}{suffix}" for name in EXPERIMENTS for suffix in (".png", ".svg", ".pdf")),
    ARCHIVE,
]
STAGES = {
    "simulation": ("data/one.nc", "logs/simulate/one.log"),
    "save": ("data/one.nc", "data/.aside.*"),
    "figure": ("figures/one.png", "figures/.aside.*"),
    "archive": (ARCHIVE, "archive/.aside.*"),
}
"""For each stage what is missing when a run starts, and what appears when it is there."""
_LONGEST_S = 300.0


def check_whole(folder):
    """Assert that every file that is there under its own name is whole."""
    for path in folder.rglob("*"):
        if path.name.startswith("."):
            continue
        if path.suffix == ".nc":
            splits.load(path)
        elif path.suffix == ".png":
            assert matplotlib.image.imread(path).size
        elif path.suffix == ".svg":
            assert path.read_text(encoding="utf-8").rstrip().endswith("</svg>")
        elif path.suffix == ".pdf":
            assert path.read_bytes().rstrip().endswith(b"%%EOF")
        elif path.suffix == ".zip":
            with zipfile.ZipFile(path) as file:
                assert file.testzip() is None


def leftovers(folder):
    return [p for p in folder.rglob(".*") if p.is_file() and not p.name.startswith(".snakemake")]


def kill_at(project, pattern, pause_s):
    """Start the workflow, kill all of its processes once a file appears, and tell if it did."""
    results = project.folder / RESULTS
    command = project.command("all", "archive", "--cores", 2)
    process = subprocess.Popen(
        command, env=project.environment, cwd=project.folder,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    end = time.monotonic() + _LONGEST_S
    seen = False
    while process.poll() is None and not seen and time.monotonic() < end:
        seen = any(results.glob(pattern))
        time.sleep(0.0005)
    time.sleep(pause_s)
    # Jobs are in the session of their snakemake.
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return seen


@pytest.fixture(scope="module")
def finished(make_project, tmp_path_factory):
    """Return a project whose archive is there."""
    project = make_project(tmp_path_factory.mktemp("finished"))
    for name, text in EXPERIMENTS.items():
        project.put(name, text)
    run = project.snakemake("all", "archive", "--cores", 2)
    assert run.code == 0, run.text
    return project


@pytest.mark.parametrize("number", range(KILLS))
def test_nothing_is_half_and_nothing_is_left(finished, tmp_path, number):
    chance = random.Random(number)
    stage = list(STAGES)[number % len(STAGES)]
    missing, appears = STAGES[stage]
    project = finished.copy(tmp_path / "project")
    results = project.folder / RESULTS
    (results / missing).unlink()
    shutil.rmtree(results / "logs")
    pause = chance.uniform(0.0, 0.5) if stage == "simulation" else chance.uniform(0.0, 0.02)
    seen = kill_at(project, appears, pause)
    check_whole(results)
    unlocked = project.snakemake("--unlock")
    assert unlocked.code == 0, unlocked.text
    run = project.snakemake("all", "archive", "--cores", 2)
    assert run.code == 0, run.text
    print(f"kill {number} during {stage} after {pause:.3f} s: {'hit' if seen else 'too late'}")
    assert leftovers(results) == []
    assert set(MADE) <= set(project.results(RESULTS))
    check_whole(results)
    for name in EXPERIMENTS:
        ours, reference = (
            splits.load(one.folder / RESULTS / "data" / f"{name}.nc") for one in (project, finished)
        )
        xr.testing.assert_identical(*map(without_volatile, (ours, reference)))
