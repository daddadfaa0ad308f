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
from splits.io.data_frame import write_data_frame
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
    """Save a dataset in a process that is killed while it writes."""
    result = subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(path)], env=os.environ)
    assert result.returncode == -signal.SIGKILL


def test_leftovers_of_a_killed_save_are_removed(tmp_path):
    kill_while_saving(tmp_path / "made.nc")
    leftover = list_names(tmp_path)
    assert len(leftover) == 2 and all(name.startswith(".") for name in leftover)
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


def start_writing(path, *prefix):
    """Return a process that is writing a file, and the name of its temporary file."""
    command = [*prefix, sys.executable, "-c", WRITE_FUNCTIONS, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    return process, process.stdout.readline().strip()


def make_stale_name(name, machine=None):
    """Return the temporary name of a writer that has ended, possibly on another machine."""
    _, first, system, number, *rest = name.split(".")
    return ".".join(["", first, machine or system, number[::-1], *rest])


def test_only_leftovers_of_ended_writers_are_removed(tmp_path):
    process, live = start_writing(tmp_path / "live.csv")
    try:
        with atomic_write(tmp_path / "mine.csv") as temporary:
            temporary.write_text("x")
            stale, remote = (
                make_stale_name(temporary.name),
                make_stale_name(temporary.name, "0123456789abcdef"),
            )
            for name in (stale, remote):
                for leftover in (name, name.rsplit(".", 3)[0]):
                    (tmp_path / leftover).write_text("x")
            (tmp_path / ".aside.of.others").write_text("x")
            removed = remove_stale_files(tmp_path)
            assert removed == [tmp_path / stale, tmp_path / stale.rsplit(".", 3)[0]]
            assert (
                temporary.exists() and (tmp_path / live).exists() and (tmp_path / remote).exists()
            )
    finally:
        process.communicate("\n")
    assert process.returncode == 0
    assert remove_stale_files(tmp_path) == []
    assert (tmp_path / "live.csv").read_text() == "whole"


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run([*OTHER_MACHINE, "true"]).returncode != 0,
    reason="needs process namespaces",
)
def test_files_of_another_container_are_kept(tmp_path):
    process, name = start_writing(tmp_path / "live.csv", *OTHER_MACHINE)
    script = (
        "import sys; from splits.core.atomic import remove_stale_files; "
        "print(len(remove_stale_files(sys.argv[1])))"
    )
    cleanup = [sys.executable, "-c", script, str(tmp_path)]
    for command in (cleanup, [*OTHER_MACHINE, *cleanup]):
        assert subprocess.run(command, capture_output=True, text=True).stdout == "0\n"
    assert (tmp_path / name).exists()
    process.communicate("\n")
    assert process.returncode == 0
    assert list_names(tmp_path) == ["live.csv"]


@pytest.mark.parametrize("case", ["another machine", "no lock", "locks unavailable"])
def test_files_without_lock_information_are_removed_by_age(tmp_path, monkeypatch, case):
    monkeypatch.setattr(atomic, "_get_lock_domain", lambda folder: "0123456789abcdef")
    with atomic_write(tmp_path / "mine.csv") as temporary:
        temporary.write_text("x")
        name = make_stale_name(temporary.name)
    (tmp_path / "mine.csv").unlink()
    (tmp_path / name).write_text("x")
    if case != "no lock":
        (tmp_path / name.rsplit(".", 3)[0]).write_text("x")
    if case == "another machine":
        monkeypatch.setattr(atomic, "_get_lock_domain", lambda folder: "another system")
    if case == "locks unavailable":
        monkeypatch.setattr(atomic, "fcntl", None)
    files = list_names(tmp_path)
    assert remove_stale_files(tmp_path) == []
    for leftover in files:
        timestamp = time.time() - 2.0 * atomic.ABANDONED_AFTER_S
        os.utime(tmp_path / leftover, (timestamp, timestamp))
    assert len(remove_stale_files(tmp_path)) == len(files)
    assert list_names(tmp_path) == []


def test_write_errors_name_the_given_path(tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(OSError, match="No such file") as error, atomic_write(path) as temporary:
        temporary.read_bytes()
    assert error.value.filename == str(path)


def test_a_failed_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("before")
    with pytest.raises(OSError, match="disk full"), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise OSError("disk full")
    assert list_names(tmp_path) == ["table.csv"]
    assert path.read_text() == "before"


def test_names_of_maximum_length_are_written(tmp_path):
    name = "x" * 251 + ".csv"
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / name)
    assert list_names(tmp_path) == [name]
