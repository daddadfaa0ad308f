"""Interrupted experiments are resumed, with bitwise identical results."""

import signal
import subprocess
import sys

import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from run_attributes import drop_run_specific_attributes

import splits
from splits.experiments import run as run_points
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import write_run

pytestmark = NEEDS_JIT

TINY_ACCURACY = Accuracy(max_stderr=0.05, relative_stderr=0.3)
INDEPENDENT_POINTS = {
    "name": "some",
    "medium": {"kind": "snow", "depth_m": 0.005},
    "instrument": {"kind": "goniophotometer", "wavelength_nm": [800], "estimator": "bins",
                   "n_bins": [3, 4], "rays": 500},
    "grid": {"saturation": [0, 0.5, 1]},
}  # fmt: skip
PATH_SHARING_POINTS = {
    "name": "some",
    "medium": {"kind": "snow", "depth_m": 0.005},
    "instrument": {"wavelength_nm": [800, 1300]},
    "grid": {"impurities_ng_g.black_carbon": [0, 100], "incidence_deg": [0, 60]},
}
LAST_POINT = """
import signal
from splits import cli
from splits.experiments import run as run_points

signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)
simulate_point = run_points.simulate_point

def slowly(*given):
    if getattr(slowly, "again", False):
        print("begun", flush=True)
        signal.pause()
    slowly.again = True
    return simulate_point(*given)

run_points.simulate_point = slowly
cli.main()
"""


class InterruptedRun(Exception):
    pass


def write_dataset(content, folder, accuracy=TINY_ACCURACY, seed=1, threads=1):
    """Write the dataset of an experiment, and return the lines of its log."""
    lines = []
    experiment = SimulationConfig.model_validate(content)
    path = folder / "some.nc"
    write_run(experiment, accuracy, seed, folder / "blocks" / "some", path, threads, lines.append)
    return lines


def interrupt_after(monkeypatch, n_path_groups):
    """Interrupt a run after a number of path-sharing groups."""
    remaining = [n_path_groups]

    def count_calls(function):
        def wrapped(*arguments):
            if not remaining[0]:
                raise InterruptedRun
            remaining[0] -= 1
            return function(*arguments)

        return wrapped

    for name in ("simulate_point", "_simulate_group"):
        monkeypatch.setattr(run_points, name, count_calls(getattr(run_points, name)))


def list_cached_files(folder):
    return sorted(path.name for path in folder.glob("blocks/some/*"))


@pytest.mark.parametrize(
    ("content", "n_points"), [(INDEPENDENT_POINTS, 2), (PATH_SHARING_POINTS, 2)]
)
def test_interrupted_runs_are_resumed(tmp_path, monkeypatch, content, n_points):
    write_dataset(content, tmp_path / "whole")
    with monkeypatch.context() as patch, pytest.raises(InterruptedRun):
        interrupt_after(patch, 2 if content is INDEPENDENT_POINTS else 1)
        write_dataset(content, tmp_path / "cut")
    assert len(list_cached_files(tmp_path / "cut")) == n_points
    lines = write_dataset(content, tmp_path / "cut", threads=2)
    assert sum("kept from an earlier run" in line for line in lines) == n_points // (
        1 if content is INDEPENDENT_POINTS else 2
    )
    complete, resumed = (splits.load(tmp_path / name / "some.nc") for name in ("whole", "cut"))
    xr.testing.assert_identical(
        drop_run_specific_attributes(resumed), drop_run_specific_attributes(complete)
    )
    for name in complete.variables:
        assert resumed[name].values.tobytes() == complete[name].values.tobytes()
    assert [path.name for path in (tmp_path / "cut").iterdir()] == ["some.nc"]


def test_checkpoints_of_other_runs_are_not_used(tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(InterruptedRun):
        interrupt_after(patch, 2)
        write_dataset(INDEPENDENT_POINTS, tmp_path)
    first = list_cached_files(tmp_path)
    table = {"wavelength_nm": [400, 1000], "n": [1.3, 1.3], "k": [1e-7, 1e-7]}
    changes = [
        {"seed": 2},
        {"accuracy": TINY_ACCURACY.model_copy(update={"max_rays": 5000})},
        {
            "content": INDEPENDENT_POINTS
            | {"instrument": INDEPENDENT_POINTS["instrument"] | {"rays": 600}}
        },
        {
            "content": INDEPENDENT_POINTS
            | {"medium": {**INDEPENDENT_POINTS["medium"], "refractive_index": {"ice": table}}}
        },
    ]
    for change in changes:
        lines = write_dataset(**{"content": INDEPENDENT_POINTS, "folder": tmp_path} | change)
        assert not any("kept" in line for line in lines)
        assert list_cached_files(tmp_path) == first
    lines = write_dataset(INDEPENDENT_POINTS, tmp_path)
    assert sum("kept" in line for line in lines) == 2 and list_cached_files(tmp_path) == []


def test_a_damaged_checkpoint_is_computed_again(tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(InterruptedRun):
        interrupt_after(patch, 2)
        write_dataset(INDEPENDENT_POINTS, tmp_path)
    path = tmp_path / "blocks" / "some" / list_cached_files(tmp_path)[0]
    path.write_bytes(path.read_bytes()[:-1])
    assert sum("kept" in line for line in write_dataset(INDEPENDENT_POINTS, tmp_path)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_the_last_line_states_the_command_to_resume(tmp_path):
    text = (
        "medium: {kind: snow, depth_m: 0.005}\ngrid: {saturation: [0, 1]}\nfigure: none\n"
        "instrument: {kind: goniophotometer, wavelength_nm: [800], estimator: bins, rays: 500}\n"
    )
    (tmp_path / "two points.yaml").write_text(text + "name: some\n", encoding="utf-8")
    arguments = ["run", "two points.yaml", "--accuracy", "tiny"]
    process = subprocess.Popen(
        [sys.executable, "-c", LAST_POINT, *arguments], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    command = "splits run 'two points.yaml' --accuracy tiny"
    assert stderr.splitlines()[-2:] == [
        "splits run: interrupted", f"to resume, type: {command}",
    ]  # fmt: skip
    assert len(list_cached_files(tmp_path)) == 1
