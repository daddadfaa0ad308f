"""Files that appear whole or not at all, and what killed writers leave behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pandas as pd
import pytest
import xarray as xr

import splits
from splits.analysis.tables import write_table
from splits.dataset import attributes, provenance

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
    (left,) = names(tmp_path)
    assert left.startswith(".")
    dataset = xr.Dataset({"x": 2.0}, attrs=attributes(provenance()))
    splits.save(dataset, tmp_path / "other.nc")
    assert names(tmp_path) == ["other.nc"]
    killed_while_saving(tmp_path / "made.nc")
    write_table(pd.DataFrame({"x": [1]}), tmp_path / "table.csv")
    assert names(tmp_path) == ["other.nc", "table.csv"]


def test_files_of_running_processes_and_other_hosts_stay(tmp_path):
    from splits.files import sweep, whole

    running = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        with whole(tmp_path / "mine.csv") as mine:
            mine.write_text("x")
            _, _, host, process, mark, *_ = mine.name.split(".")
            assert process == str(os.getpid())
            live = tmp_path / f".aside.{host}.{running.pid}.{mark}.live.csv"
            far = tmp_path / f".aside.not_{host}.{running.pid}.{mark}.far.csv"
            own = tmp_path / f".aside.{host}.{process}.00000000.before_us.csv"
            strange = tmp_path / ".aside.of.somebody"
            for path in (live, far, own, strange):
                path.write_text("x")
            assert sweep(tmp_path) == [own]
            assert mine.exists()
    finally:
        running.communicate()
    assert sweep(tmp_path) == [live]
    assert names(tmp_path) == sorted([far.name, strange.name, "mine.csv"])


def test_a_block_that_raises_leaves_what_was_there(tmp_path):
    from splits.files import whole

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
