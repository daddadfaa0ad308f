"""Killed runs leave only complete files and hidden leftovers, and the next run completes.

One of five kills is of a whole workflow, the others of one process that runs the same steps,
compilation included.  Five by default.  The campaign proper is ``make campaign``, or

    KILLS=200 python -m pytest -s tests/campaigns/test_kills.py
"""

import hashlib
import os
import random
import shutil
import signal
import subprocess
import time
import zipfile

import killed
import matplotlib.image
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from run_attributes import drop_run_specific_attributes

import splits

pytestmark = [NEEDS_JIT, pytest.mark.slow, pytest.mark.long]

N_KILLS = int(os.environ.get("KILLS", "5"))
N_WORKFLOW_KILLS = max(1, N_KILLS // 5)
RESULTS = "results/tiny"
EXPERIMENTS = {
    "one": "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n",
    "two": "medium: {kind: particle_layer, optical_thickness: 2}\n"
    "instrument: {wavelength_nm: [550]}\n",
}
ARCHIVE = "archive/splits-results.zip"
ALL_OUTPUTS = [
    *(f"data/{name}.nc" for name in EXPERIMENTS),
    *(f"figures/{name}{suffix}" for name in EXPERIMENTS for suffix in (".png", ".svg", ".pdf")),
    ARCHIVE,
]
WORKFLOW_STAGES = {
    "simulation": ("data/two.nc", "logs/simulate/two.log"),
    "save": ("data/one.nc", "data/.aside.*"),
    "figure": ("figures/two.png", "figures/.aside.*"),
    "archive": (ARCHIVE, "archive/.aside.*"),
    "any moment": ("data/one.nc", None),
}
"""For each stage the output that is missing at the start, and a file that marks the stage."""
PROCESS_STEPS = {
    "any moment": (killed.ALL_OUTPUTS, None),
    "compiling": (("cache", *killed.ALL_OUTPUTS), None),
    "kernel": (("waves", *killed.ALL_OUTPUTS), "cache/splits/*/.*"),
    "save": (killed.ALL_OUTPUTS, "results/data/.aside.*"),
    "table": (killed.ALL_OUTPUTS[1:], "results/tables/.aside.*"),
    "png": (killed.ALL_OUTPUTS[2:], "results/figures/.aside.*.png"),
    "svg": (killed.ALL_OUTPUTS[2:], "results/figures/.aside.*.svg"),
    "pdf": (killed.ALL_OUTPUTS[2:], "results/figures/.aside.*.pdf"),
    "archive": (killed.ALL_OUTPUTS[-2:], "results/archive/.aside.*"),
    "unpack": (killed.ALL_OUTPUTS[-1:], "results/.aside.*"),
}
"""The same for steps of one process; "cache" is all kernels, "waves" those of one module."""
_MAX_WAIT_S = 300.0


def check_files_complete(folder):
    """Assert that every file that is not hidden is complete."""
    for path in folder.rglob("*"):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        if path.suffix == ".nc":
            splits.load(path)
        elif path.suffix == ".png":
            assert matplotlib.image.imread(path).size
        elif path.suffix == ".svg":
            assert path.read_text(encoding="utf-8").rstrip().endswith("</svg>")
        elif path.suffix == ".pdf":
            assert path.read_bytes().rstrip().endswith(b"%%EOF")
        elif path.suffix == ".csv":
            assert path.read_text(encoding="utf-8").endswith("\n")
        elif path.suffix == ".nbc":
            content = path.read_bytes()
            assert hashlib.sha256(content[32:]).digest() == content[:32]
        elif path.suffix == ".zip":
            with zipfile.ZipFile(path) as file:
                assert file.testzip() is None


def read_contents(folder):
    """Return the contents of all files of a folder, by path."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def list_names(folder, pattern):
    """Return the sorted names of files other than leftovers, which a later write removes."""
    names = (path.name for path in folder.glob(pattern))
    return sorted(name for name in names if not name.startswith(".aside."))


def wait_for_file(running, folder, pattern, pause_s):
    """Wait for a file, if a pattern is given, and a pause; return whether it still runs."""
    end = time.monotonic() + _MAX_WAIT_S
    seen = pattern is None
    while running() and not seen and time.monotonic() < end:
        seen = any(folder.glob(pattern))
        time.sleep(0.0002)
    time.sleep(pause_s)
    return seen and running()


def kill_workflow(project, pattern, pause_s):
    """Start the workflow, kill all of its processes, and return whether it was still running."""
    command = project.command("all", "archive", "--cores", 2)
    process = subprocess.Popen(
        command, env=project.environment, cwd=project.folder,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    hit = wait_for_file(lambda: process.poll() is None, project.folder / RESULTS, pattern, pause_s)
    # Jobs belong to the session of their Snakemake process.
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return hit


@pytest.fixture(scope="module")
def finished_project(make_project, tmp_path_factory):
    """Return a project with its archive, and the time of the run (s)."""
    project = make_project(tmp_path_factory.mktemp("finished"))
    for name, text in EXPERIMENTS.items():
        project.put(name, text)
    start = time.monotonic()
    run = project.snakemake("all", "archive", "--cores", 2)
    assert run.code == 0, run.text
    return project, time.monotonic() - start


@pytest.mark.parametrize("number", range(N_WORKFLOW_KILLS))
def test_killed_workflow_leaves_only_complete_files(finished_project, tmp_path, number, counter):
    rng = random.Random(number)
    stage = list(WORKFLOW_STAGES)[number % len(WORKFLOW_STAGES)]
    missing, appears = WORKFLOW_STAGES[stage]
    before, whole_run = finished_project
    project = before.copy(tmp_path / "project")
    results = project.folder / RESULTS
    if stage == "any moment":
        shutil.rmtree(results / "data")
    else:
        (results / missing).unlink()
    shutil.rmtree(results / "logs")
    longest = {"simulation": 0.5, "any moment": 0.8 * whole_run}.get(stage, 0.02)
    pause = rng.uniform(0.0, longest)
    hit = kill_workflow(project, appears, pause)
    counter("kills of workflows", number, f"{stage} {'hit' if hit else 'too late'}")
    check_files_complete(results)
    unlocked = project.snakemake("--unlock")
    assert unlocked.code == 0, unlocked.text
    run = project.snakemake("all", "archive", "--cores", 2)
    assert run.code == 0, run.text
    assert set(ALL_OUTPUTS) <= set(project.results(RESULTS))
    check_files_complete(results)
    for name in EXPERIMENTS:
        ours, reference = (
            splits.load(one.folder / RESULTS / "data" / f"{name}.nc") for one in (project, before)
        )
        xr.testing.assert_identical(*map(drop_run_specific_attributes, (ours, reference)))


@pytest.fixture(scope="module")
def finished_folder(tmp_path_factory):
    """Return a folder with all outputs, and the times of a run with and without compiling (s)."""
    folder = tmp_path_factory.mktemp("worked")
    times = []
    for missing in ("cache", "results"):
        shutil.rmtree(folder / missing, ignore_errors=True)
        shutil.rmtree(folder / "results", ignore_errors=True)
        start = time.monotonic()
        run_all_steps(folder)
        times.append(time.monotonic() - start)
    return folder, {"compiling": times[0], "any moment": times[1]}


def run_all_steps(folder):
    """Run all steps in a separate process."""
    process = killed.start_worker(folder / "results", folder / "cache")
    process.join(_MAX_WAIT_S)
    assert process.exitcode == 0


@pytest.mark.parametrize("number", range(N_KILLS - N_WORKFLOW_KILLS))
def test_killed_process_leaves_only_complete_files(finished_folder, tmp_path, number, counter):
    rng = random.Random(number)
    step = list(PROCESS_STEPS)[number % len(PROCESS_STEPS)]
    missing, appears = PROCESS_STEPS[step]
    before, longest = finished_folder
    folder = tmp_path / "folder"
    shutil.copytree(before, folder)
    for name in missing:
        if name == "cache":
            shutil.rmtree(folder / name)
        elif name == "waves":
            for path in folder.glob("cache/splits/*/waves.*"):
                path.unlink()
        elif name == killed.UNPACKED_FOLDER:
            shutil.rmtree(folder / "results" / name)
        else:
            (folder / "results" / name).unlink()
    contents = read_contents(folder)
    process = killed.start_worker(folder / "results", folder / "cache")
    hit = wait_for_file(
        process.is_alive, folder, appears, rng.uniform(0.0, longest.get(step, 0.005))
    )
    process.kill()
    process.join()
    counter("kills of processes", number, f"{step} {'hit' if hit else 'too late'}")
    assert read_contents(folder).items() >= contents.items()
    check_files_complete(folder)
    run_all_steps(folder)
    check_files_complete(folder)
    assert all((folder / "results" / name).exists() for name in killed.ALL_OUTPUTS)
    assert list_names(folder, "cache/splits/*/*") == list_names(before, "cache/splits/*/*")
    data = [splits.load(one / "results" / killed.DATA_FILE) for one in (folder, before)]
    xr.testing.assert_identical(*map(drop_run_specific_attributes, data))
