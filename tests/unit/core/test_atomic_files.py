"""Atomic writes: the old file or the new one, and no leftovers in the long run."""

import os
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.atomic import ABANDONED_AFTER_S, atomic_write
from splits.core.escaping import write_data_frame
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
WRITING_PROGRAM = """
import sys
from splits.core.atomic import atomic_write

with atomic_write(sys.argv[1]) as aside:
    aside.write_text(sys.argv[2])
    print(aside.name, flush=True)
    input()
"""


def list_names(folder):
    return sorted(path.name for path in folder.iterdir())


def kill_while_saving(path):
    """Save a dataset in a process that is killed while it writes."""
    result = subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(path)], env=os.environ)
    assert result.returncode == -signal.SIGKILL


def start_writing(path, text):
    """Return a process that is writing a file, and the name of its temporary file."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITING_PROGRAM, str(path), text],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return process, process.stdout.readline().strip()


def test_a_killed_save_leaves_the_old_file_and_a_leftover_that_a_later_write_removes(tmp_path):
    path = tmp_path / "made.nc"
    dataset = xr.Dataset({"x": 2.0}, attrs=to_netcdf_attributes(make_provenance()))
    splits.save(dataset, path)
    kill_while_saving(path)
    assert splits.load(path).equals(dataset)
    leftover, _ = list_names(tmp_path)
    assert leftover.startswith(".aside.")
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert list_names(tmp_path) == [leftover, "made.nc", "table.csv"]
    timestamp = time.time() - 1.01 * ABANDONED_AFTER_S
    os.utime(tmp_path / leftover, (timestamp, timestamp))
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert list_names(tmp_path) == ["made.nc", "table.csv"]


def test_old_files_of_others_are_kept(tmp_path):
    for name in (".aside.of.others", ".other", "aside"):
        (tmp_path / name).write_text("x")
        os.utime(tmp_path / name, (0, 0))
    write_data_frame(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert len(list_names(tmp_path)) == 4


def test_processes_write_the_same_file(tmp_path):
    path = tmp_path / "one.csv"
    writers = [start_writing(path, text) for text in ("first", "second")]
    assert list_names(tmp_path) == sorted(name for _, name in writers)
    for (process, _), text in zip(writers, ("first", "second"), strict=True):
        process.communicate("\n")
        assert process.returncode == 0
        assert path.read_text() == text
    assert list_names(tmp_path) == ["one.csv"]


def test_folders_are_written_atomically(tmp_path):
    path = tmp_path / "folder"
    path.mkdir()
    with atomic_write(path) as temporary:
        temporary.mkdir()
        (temporary / "a").write_text("whole")
        assert list_names(path) == []
    assert list_names(tmp_path) == ["folder"] and (path / "a").read_text() == "whole"
    with pytest.raises(ValueError, match="bad"), atomic_write(tmp_path / "other") as temporary:
        temporary.mkdir()
        (temporary / "a").write_text("half")
        raise ValueError("bad")
    assert list_names(tmp_path) == ["folder"]


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
