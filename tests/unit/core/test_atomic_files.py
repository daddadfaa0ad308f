"""Atomic writes, and removal of temporary files left by killed processes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core import atomic
from splits.core.atomic import atomic_write, remove_stale_files
from splits.experiments.papers.paper_tables import write_data_frame
from splits.io.netcdf import make_provenance, to_netcdf_attributes

KILLED_PROGRAM = """
import os, signal, sys
import xarray as xr
import splits
from splits.io.netcdf import to_netcdf_attributes, make_provenance

def die(dataset, target, **options):
    open(target, "wb").write(b"half a fi")
    os.kill(os.getpid(), signal.SIGKILL)

xr.Dataset.to_netcdf = die
splits.save(xr.Dataset({"x": 1.0}, attrs=to_netcdf_attributes(make_provenance())), sys.argv[1])
"""


def list_names(folder):
    return sorted(path.name for path in folder.iterdir())


def kill_while_saving(path):
    """Save in a process that is killed in the midst of it."""
    done = subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(path)], env=os.environ)
    assert done.returncode == -signal.SIGKILL


def test_what_a_killed_save_leaves_is_swept_by_the_next(tmp_path):
    kill_while_saving(tmp_path / "made.nc")
    left = list_names(tmp_path)
    assert len(left) == 2 and all(name.startswith(".") for name in left)
    dataset = xr.Dataset({"x": 2.0}, attrs=to_netcdf_attributes(make_provenance()))
    splits.save(dataset, tmp_path / "other.nc")
    assert list_names(tmp_path) == ["other.nc"]
    kill_while_saving(tmp_path / "made.nc")
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert list_names(tmp_path) == ["other.nc", "table.csv"]


WRITE_FUNCTIONS = """
import sys
from splits.core.atomic import atomic_write

with atomic_write(sys.argv[1]) as aside:
    aside.write_text("whole")
    print(aside.name, flush=True)
    input()
"""
OTHER_MACHINE = ["unshare", "--pid", "--fork", "--mount-proc"]
"""Command that runs another one in a new process namespace, as in a container."""


def start_writing(path, *before):
    """Return a process that has written half a file, and that file's hidden name."""
    command = [*before, sys.executable, "-c", WRITE_FUNCTIONS, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    return process, process.stdout.readline().strip()


def make_stale_name(name, machine=None):
    """Return the hidden name that a writer that has ended has left, perhaps on another machine."""
    _, first, system, number, *rest = name.split(".")
    return ".".join(["", first, machine or system, number[::-1], *rest])


def test_only_what_writers_that_have_ended_left_is_swept(tmp_path):
    process, live = start_writing(tmp_path / "live.csv")
    try:
        with atomic_write(tmp_path / "mine.csv") as mine:
            mine.write_text("x")
            dead, far = make_stale_name(mine.name), make_stale_name(mine.name, "0123456789abcdef")
            for name in (dead, far):
                for left in (name, name.rsplit(".", 3)[0]):
                    (tmp_path / left).write_text("x")
            (tmp_path / ".aside.of.somebody").write_text("x")
            gone = remove_stale_files(tmp_path)
            assert gone == [tmp_path / dead, tmp_path / dead.rsplit(".", 3)[0]]
            assert mine.exists() and (tmp_path / live).exists() and (tmp_path / far).exists()
    finally:
        process.communicate("\n")
    assert process.returncode == 0
    assert remove_stale_files(tmp_path) == []
    assert (tmp_path / "live.csv").read_text() == "whole"


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run([*OTHER_MACHINE, "true"]).returncode != 0,
    reason="no namespaces of processes here",
)
def test_what_another_container_writes_stays(tmp_path):
    process, name = start_writing(tmp_path / "live.csv", *OTHER_MACHINE)
    script = (
        "import sys; from splits.core.atomic import remove_stale_files; "
        "print(len(remove_stale_files(sys.argv[1])))"
    )
    sweeps = [sys.executable, "-c", script, str(tmp_path)]
    for command in (sweeps, [*OTHER_MACHINE, *sweeps]):
        assert subprocess.run(command, capture_output=True, text=True).stdout == "0\n"
    assert (tmp_path / name).exists()
    process.communicate("\n")
    assert process.returncode == 0
    assert list_names(tmp_path) == ["live.csv"]


@pytest.mark.parametrize("why", ["another machine", "no lock", "locks are not to be had"])
def test_where_locks_say_nothing_age_decides(tmp_path, monkeypatch, why):
    monkeypatch.setattr(atomic, "_get_lock_domain", lambda folder: "0123456789abcdef")
    with atomic_write(tmp_path / "mine.csv") as mine:
        mine.write_text("x")
        name = make_stale_name(mine.name)
    (tmp_path / "mine.csv").unlink()
    (tmp_path / name).write_text("x")
    if why != "no lock":
        (tmp_path / name.rsplit(".", 3)[0]).write_text("x")
    if why == "another machine":
        monkeypatch.setattr(atomic, "_get_lock_domain", lambda folder: "another system")
    if why == "locks are not to be had":
        monkeypatch.setattr(atomic, "fcntl", None)
    there = list_names(tmp_path)
    assert remove_stale_files(tmp_path) == []
    for left in there:
        then = time.time() - 2.0 * atomic.ABANDONED_AFTER_S
        os.utime(tmp_path / left, (then, then))
    assert len(remove_stale_files(tmp_path)) == len(there)
    assert list_names(tmp_path) == []


def test_what_cannot_be_written_is_named_as_it_was_given(tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(OSError, match="No such file") as caught, atomic_write(path) as aside:
        aside.read_bytes()
    assert caught.value.filename == str(path)


def test_a_block_that_raises_leaves_what_was_there(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("before")
    with pytest.raises(OSError, match="disk full"), atomic_write(path) as aside:
        aside.write_text("half")
        raise OSError("disk full")
    assert list_names(tmp_path) == ["table.csv"]
    assert path.read_text() == "before"


def test_names_as_long_as_a_folder_takes(tmp_path):
    name = "x" * 251 + ".csv"
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / name)
    assert list_names(tmp_path) == [name]
