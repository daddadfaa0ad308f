"""A full disk gives a one-line error and leaves no partial file."""

import errno
import os
import subprocess
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits import cli
from splits.core.atomic import check_writable
from splits.core.escaping import write_data_frame
from splits.experiments.archive import pack_archive
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.plotting.grammar import save_figure
from splits.tables.blocks import write_table_blockwise

VALUES = np.random.default_rng(1).random(300_000)
"""Values of 2.4 MB, more than the disk holds."""


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """Return a folder on a disk of 1 MiB."""
    folder = tmp_path_factory.mktemp("disk")
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    try:
        result = subprocess.run(command, capture_output=True)
    except OSError:
        pytest.skip("needs permission to mount file systems")
    if result.returncode:
        pytest.skip("needs permission to mount file systems")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def make_dataset(values=VALUES):
    return xr.Dataset({"x": ("n", values)}, attrs=to_netcdf_attributes(make_provenance()))


def save_dataset(folder):
    splits.save(make_dataset(), folder / "made.nc")


def save_table(folder):
    write_data_frame(pd.DataFrame({"x": VALUES}), folder / "made.csv")


def save_image(folder):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(40, 40))
    figure.figimage(VALUES[:250_000].reshape(500, 500), resize=False)
    save_figure(figure, folder / "made")


def save_archive(folder):
    (folder.parent / "data").mkdir(exist_ok=True)
    (folder.parent / "data" / "a.nc").write_bytes(VALUES.tobytes())
    pack_archive([folder.parent / "data" / "a.nc"], {}, folder / "made.zip")


def list_open_files():
    """Return the paths of all open files of this process; deleted ones are marked by Linux."""
    links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")]
    return [os.readlink(link) for link in links if os.path.islink(link)]


@pytest.mark.long
@pytest.mark.parametrize("write", [save_dataset, save_table, save_image, save_archive])
def test_a_full_disk_is_reported_without_leftovers(disk, write):
    for _ in range(2):
        with pytest.raises(OSError, match=r"No space left on device: '.*/made\.") as error:
            write(disk)
        assert error.value.errno == errno.ENOSPC
        assert os.listdir(disk) == []
        assert not [path for path in list_open_files() if "deleted" in path and str(disk) in path]
    status = os.statvfs(disk)
    assert status.f_bavail == status.f_blocks


def test_a_table_larger_than_the_disk_is_not_started(disk, monkeypatch):
    monkeypatch.setattr("splits.tables.blocks.compute_table_bytes", lambda plan: 2**22)
    with pytest.raises(OSError, match=r"No space left on device: '.*made\.nc'"):
        write_table_blockwise(disk / "made.nc", None, list, lambda table: table)
    assert os.listdir(disk) == []


def test_a_disk_that_fills_during_writing_is_cleaned(disk, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=2**40))
    with pytest.raises(OSError, match=r"perhaps no space is left .*made\.nc'"):
        save_dataset(disk)
    assert os.listdir(disk) == []


def test_a_run_without_disk_space_gives_one_line(disk, tmp_path, capsys):
    file = tmp_path / "small.yaml"
    text = "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\nfigure: none\n"
    file.write_text(text, encoding="utf-8")
    (disk / "other").write_bytes(bytes(2**19))
    code = cli.main(["run", str(file), "--output", str(disk)])
    (disk / "other").unlink()
    assert code == 1
    assert capsys.readouterr().err == f"splits: {disk}/small.nc: No space left on device\n"


def test_memory_errors_are_reported_in_one_line(monkeypatch, capsys):
    def fail(given):
        raise MemoryError("Unable to allocate 9 TiB")

    monkeypatch.setattr(cli, "_print_versions", fail)
    assert cli.main(["versions"]) == 1
    assert capsys.readouterr().err == "splits: not enough memory (Unable to allocate 9 TiB)\n"


@pytest.mark.parametrize("obstacle", ["a folder", "below a file"])
def test_unwritable_output_is_rejected_at_the_start(tmp_path, capsys, obstacle):
    file = tmp_path / "small.yaml"
    file.write_text("instrument: {wavelength_nm: [800]}\n", encoding="utf-8")
    output = tmp_path / "made"
    if obstacle == "a folder":
        (output / "small.nc").mkdir(parents=True)
    else:
        output.write_text("a file")
    assert cli.main(["run", str(file), "--output", str(output)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"splits: {output}")


def test_checking_a_writable_path_changes_nothing(tmp_path):
    path = tmp_path / "new" / "made.nc"
    check_writable(path)
    assert os.listdir(path.parent) == []
    path.write_text("before")
    check_writable(path)
    assert path.read_text() == "before" and os.listdir(path.parent) == ["made.nc"]
