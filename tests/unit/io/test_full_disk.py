"""A full disk gives a one-line error and leaves no partial file."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT

import splits
from splits import cli
from splits.core.atomic import check_writable
from splits.experiments.archive import pack_archive
from splits.experiments.papers.paper_tables import write_data_frame
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.plotting.style import save_figure
from splits.tables.storage import write_table_blockwise

VALUES = np.random.default_rng(1).random(300_000)
"""Of which a file has 2.4 MB."""


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """Return a folder on a disk of 1 MiB."""
    folder = tmp_path_factory.mktemp("disk")
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True)
    except OSError:
        pytest.skip("no file systems can be mounted here")
    if done.returncode:
        pytest.skip("no file systems can be mounted here")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def make_dataset(values=VALUES):
    return xr.Dataset({"x": ("n", values)}, attrs=to_netcdf_attributes(make_provenance()))


def save_dataset(folder):
    splits.save(make_dataset(), folder / "made.nc")


def save_table(folder):
    write_data_frame(pd.DataFrame({"x": VALUES}), folder / "made.csv")


def save_drawing(folder):
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(40, 40))
    drawn.figimage(VALUES[:250_000].reshape(500, 500), resize=False)
    save_figure(drawn, folder / "made")


def save_archive(folder):
    (folder.parent / "data").mkdir(exist_ok=True)
    (folder.parent / "data" / "a.nc").write_bytes(VALUES.tobytes())
    pack_archive([folder.parent / "data" / "a.nc"], {}, folder / "made.zip")


def list_open_files():
    """Return files that this process holds open although they are deleted."""
    links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")]
    return [os.readlink(link) for link in links if os.path.islink(link)]


@pytest.mark.parametrize("write", [save_dataset, save_table, save_drawing, save_archive])
def test_a_full_disk_is_reported_and_nothing_stays(disk, write):
    for _ in range(2):
        with pytest.raises(OSError, match=r"No space left on device: '.*/made\.") as caught:
            write(disk)
        assert caught.value.errno == errno.ENOSPC
        assert os.listdir(disk) == []
        assert not [path for path in list_open_files() if "deleted" in path and str(disk) in path]
    left = os.statvfs(disk)
    assert left.f_bavail == left.f_blocks


def test_a_large_table_is_not_begun_where_it_does_not_fit(disk, monkeypatch):
    monkeypatch.setattr("splits.tables.storage.compute_table_bytes", lambda plan, order: 2**22)
    with pytest.raises(OSError, match=r"No space left on device: '.*made\.nc'"):
        write_table_blockwise(disk / "made.nc", None, None, list, lambda table: table)
    assert os.listdir(disk) == []


def test_a_disk_that_fills_meanwhile_gets_its_space_back(disk, monkeypatch):
    monkeypatch.setattr("splits.io.integrity.check_disk_space", lambda path, size: None)
    with pytest.raises(OSError, match=r"perhaps no space is left .*made\.nc'"):
        save_dataset(disk)
    assert os.listdir(disk) == []


@NEEDS_JIT
def test_a_run_without_space_ends_with_one_line(disk, tmp_path, capsys):
    file = tmp_path / "small.yaml"
    text = "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\nfigure: none\n"
    file.write_text(text, encoding="utf-8")
    (disk / "other").write_bytes(bytes(2**19))
    words = [sys.executable, "-m", "splits.cli", "run", str(file), "--output", str(disk)]
    done = subprocess.run(words, capture_output=True, text=True)
    (disk / "other").unlink()
    assert done.returncode == 1
    assert done.stderr == f"splits: {disk}/small.nc: No space left on device\n"


def test_too_little_memory_is_one_line(monkeypatch, capsys):
    def fail(given):
        raise MemoryError("Unable to allocate 9 TiB")

    monkeypatch.setattr(cli, "_print_versions", fail)
    assert cli.main(["versions"]) == 1
    assert capsys.readouterr().err == "splits: not enough memory (Unable to allocate 9 TiB)\n"


@pytest.mark.parametrize("way", ["a folder", "below a file"])
def test_an_output_that_cannot_be_written_is_rejected_at_the_start(tmp_path, capsys, way):
    file = tmp_path / "small.yaml"
    file.write_text("instrument: {wavelength_nm: [800]}\n", encoding="utf-8")
    output = tmp_path / "made"
    if way == "a folder":
        (output / "small.nc").mkdir(parents=True)
    else:
        output.write_text("a file")
    assert cli.main(["run", str(file), "--output", str(output)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"splits: {output}")


def test_a_path_that_can_be_written_stays_as_it_is(tmp_path):
    path = tmp_path / "new" / "made.nc"
    check_writable(path)
    assert os.listdir(path.parent) == []
    path.write_text("before")
    check_writable(path)
    assert path.read_text() == "before" and os.listdir(path.parent) == ["made.nc"]
