"""Files that appear whole or not at all, and what killed writers leave behind."""

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
from splits import files
from splits.analysis.tables import write_table
from splits.dataset import attributes, provenance
from splits.files import sweep, whole

KILLED = """
import os, signal, sys
import xarray as xr
import splits
from splits.dataset import attributes, provenance

def die(dataset, target, **options):
    open(target, "wb").write(b"half a fi")
    os.kill(os.getpid(), signal.SIGKILL)

xr.Dataset.to_netcdf = die
splits.save(xr.Dataset({"x": 1.0}, attrs=attributes(provenance())), sys.argv[1])
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def killed_while_saving(path):
    """Save in a process that is killed in the midst of it."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], env=os.environ)
    assert done.returncode == -signal.SIGKILL


def test_what_a_killed_save_leaves_is_swept_by_the_next(tmp_path):
    killed_while_saving(tmp_path / "made.nc")
    left = names(tmp_path)
    assert len(left) == 2 and all(name.startswith(".") for name in left)
    dataset = xr.Dataset({"x": 2.0}, attrs=attributes(provenance()))
    splits.save(dataset, tmp_path / "other.nc")
    assert names(tmp_path) == ["other.nc"]
    killed_while_saving(tmp_path / "made.nc")
    write_table(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert names(tmp_path) == ["other.nc", "table.csv"]


WRITES = """
import sys
from splits.files import whole

with whole(sys.argv[1]) as aside:
    aside.write_text("whole")
    print(aside.name, flush=True)
    input()
"""
ELSEWHERE = ["unshare", "--pid", "--fork", "--mount-proc"]
"""Runs a command where processes have other numbers, as in a container."""


def writing(path, *before):
    """Return a process that has written half a file, and that file's hidden name."""
    command = [*before, sys.executable, "-c", WRITES, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    return process, process.stdout.readline().strip()


def ended(name, machine=None):
    """Return the hidden name that a writer that has ended has left, perhaps on another machine."""
    _, first, system, number, *rest = name.split(".")
    return ".".join(["", first, machine or system, number[::-1], *rest])


def test_only_what_writers_that_have_ended_left_is_swept(tmp_path):
    process, live = writing(tmp_path / "live.csv")
    try:
        with whole(tmp_path / "mine.csv") as mine:
            mine.write_text("x")
            dead, far = ended(mine.name), ended(mine.name, "0123456789abcdef")
            for name in (dead, far):
                for left in (name, name.rsplit(".", 3)[0]):
                    (tmp_path / left).write_text("x")
            (tmp_path / ".aside.of.somebody").write_text("x")
            gone = sweep(tmp_path)
            assert gone == [tmp_path / dead, tmp_path / dead.rsplit(".", 3)[0]]
            assert mine.exists() and (tmp_path / live).exists() and (tmp_path / far).exists()
    finally:
        process.communicate("\n")
    assert process.returncode == 0
    assert sweep(tmp_path) == []
    assert (tmp_path / "live.csv").read_text() == "whole"


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run([*ELSEWHERE, "true"]).returncode != 0,
    reason="no namespaces of processes here",
)
def test_what_another_container_writes_stays(tmp_path):
    process, name = writing(tmp_path / "live.csv", *ELSEWHERE)
    script = "import sys; from splits.files import sweep; print(len(sweep(sys.argv[1])))"
    sweeps = [sys.executable, "-c", script, str(tmp_path)]
    for command in (sweeps, [*ELSEWHERE, *sweeps]):
        assert subprocess.run(command, capture_output=True, text=True).stdout == "0\n"
    assert (tmp_path / name).exists()
    process.communicate("\n")
    assert process.returncode == 0
    assert names(tmp_path) == ["live.csv"]


@pytest.mark.parametrize("why", ["another machine", "no lock", "locks are not to be had"])
def test_where_locks_say_nothing_age_decides(tmp_path, monkeypatch, why):
    monkeypatch.setattr(files, "_machine", lambda folder: "0123456789abcdef")
    with whole(tmp_path / "mine.csv") as mine:
        mine.write_text("x")
        name = ended(mine.name)
    (tmp_path / "mine.csv").unlink()
    (tmp_path / name).write_text("x")
    if why != "no lock":
        (tmp_path / name.rsplit(".", 3)[0]).write_text("x")
    if why == "another machine":
        monkeypatch.setattr(files, "_machine", lambda folder: "another system")
    if why == "locks are not to be had":
        monkeypatch.setattr(files, "fcntl", None)
    there = names(tmp_path)
    assert sweep(tmp_path) == []
    for left in there:
        then = time.time() - 2.0 * files.ABANDONED_S
        os.utime(tmp_path / left, (then, then))
    assert len(sweep(tmp_path)) == len(there)
    assert names(tmp_path) == []


def test_what_cannot_be_written_is_named_as_it_was_given(tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(OSError, match="No such file") as caught, whole(path) as aside:
        aside.read_bytes()
    assert caught.value.filename == str(path)


def test_a_block_that_raises_leaves_what_was_there(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("before")
    with pytest.raises(OSError, match="disk full"), whole(path) as aside:
        aside.write_text("half")
        raise OSError("disk full")
    assert names(tmp_path) == ["table.csv"]
    assert path.read_text() == "before"


def test_names_as_long_as_a_folder_takes(tmp_path):
    name = "x" * 251 + ".csv"
    write_table(pd.DataFrame({"x": [1]}), tmp_path / name)
    assert names(tmp_path) == [name]
