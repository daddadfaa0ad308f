"""Random damage to datasets, archives, kernels and configuration is reported in one line.

A few by default.  The campaign proper is ``make campaign``, or

    DAMAGES=30 python -m pytest -s tests/campaigns/test_damages.py

with that number of each kind.
"""

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from chi2 import NEEDS_JIT
from shipped import CONFIG

import splits
from splits.core.validation import ConfigError
from splits.experiments import load_experiment
from splits.experiments.archive import pack_archive
from splits.io.netcdf import DamagedFileError
from splits.io.unarchive import ArchiveError, unpack_archive

N_DAMAGES = int(os.environ.get("DAMAGES", "4"))
pytestmark = pytest.mark.long

SHIPPED_FILES = sorted((CONFIG / "experiments").rglob("*.yaml"))
PROGRAM = """
import splits
dataset = splits.spectrophotometer(splits.ParticleLayer(), [500], max_stderr=0.3, seed=1, threads=1)
print(dataset.reflectance.values[0].hex())
"""


def flip_bit(content: bytes, rng: random.Random) -> bytes:
    """Return the content with one bit inverted."""
    i = rng.randrange(len(content))
    return content[:i] + bytes([content[i] ^ 1 << rng.randrange(8)]) + content[i + 1 :]


def truncate(content: bytes, rng: random.Random) -> bytes:
    """Return the content, truncated at a random position."""
    return content[: rng.randrange(len(content))]


def zero_range(content: bytes, rng: random.Random) -> bytes:
    """Return the content with a range of zeros, as after the loss of a sector."""
    i = rng.randrange(len(content))
    length = min(512, len(content) - i)
    other = bytes(length) if any(content[i : i + length]) else b"\xff" * length
    return content[:i] + other + content[i + length :]


def insert_noise(content: bytes, rng: random.Random) -> bytes:
    """Return the content with inserted random bytes."""
    i = rng.randrange(len(content))
    return content[:i] + rng.randbytes(16) + content[i:]


DAMAGE_FUNCTIONS = (flip_bit, truncate, zero_range, insert_noise)


def damage_content(content: bytes, number: int) -> bytes:
    """Return a damaged content, which differs from the original."""
    rng = random.Random(number)
    damaged = DAMAGE_FUNCTIONS[number % len(DAMAGE_FUNCTIONS)](content, rng)
    assert damaged != content
    return damaged


def read_contents(folder: Path) -> dict[Path, bytes]:
    """Return the contents of all files of a folder, by relative path."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "data" / "made.nc"
    waves = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "waves": 8, "correlation": "gaussian"}
    layer = splits.ParticleLayer(surface=waves, depth_m=10.0)
    splits.save(splits.surface_map(layer, half_width_m=1.0, points=41, realizations=2), path)
    return path


@pytest.mark.parametrize("number", range(N_DAMAGES))
def test_damaged_dataset_is_reported(dataset, tmp_path, number):
    path = tmp_path / "made.nc"
    path.write_bytes(damage_content(dataset.read_bytes(), number))
    with pytest.raises(DamagedFileError) as caught:
        splits.load(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: damaged, ") and line.isprintable()


@pytest.fixture(scope="module")
def archive(dataset):
    path = dataset.parents[1] / "archive" / "made.zip"
    pack_archive([dataset], {"config/config.yaml": b"seed: 1\n"}, path)
    return path


@pytest.mark.parametrize("number", range(N_DAMAGES))
def test_damaged_archive_is_rejected_or_unpacks_unchanged(archive, tmp_path, number, counter):
    """A zip file has bytes that are not used, such as the time of a member."""
    path, whole, target = (tmp_path / name for name in ("made.zip", "whole", "target"))
    path.write_bytes(damage_content(archive.read_bytes(), number))
    unpack_archive(archive, whole)
    try:
        unpack_archive(path, target)
    except ArchiveError as error:
        line = str(error)
        assert line.startswith(f"{path}: rejected, ") and line.isprintable()
        assert not target.exists()
        counter("damaged archives", number, "rejected")
    else:
        assert read_contents(target) == read_contents(whole)
        counter("damaged archives", number, "unchanged")
    assert sorted(tmp_path.iterdir()) == sorted(p for p in (path, whole, target) if p.exists())


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    """Return a folder of cached kernels, and the output of a process that uses them."""
    folder = tmp_path_factory.mktemp("kernels")
    return folder, run_simulation(folder).stdout


def run_simulation(folder):
    """Run a small simulation with the kernels of a folder."""
    variables = {k: v for k, v in os.environ.items() if k != "NUMBA_DISABLE_JIT"}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM], env=variables | {"NUMBA_CACHE_DIR": str(folder)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("number", range(N_DAMAGES))
def test_damaged_kernel_is_compiled_again(kernels, tmp_path, number):
    folder, printed = kernels
    copy = tmp_path / "kernels"
    shutil.copytree(folder, copy)
    files = sorted(path for path in copy.rglob("*.nbc"))
    path = random.Random(number).choice(files)
    path.write_bytes(damage_content(path.read_bytes(), number))
    done = run_simulation(copy)
    assert done.stdout == printed
    # A kernel that is inlined in others is not read on its own.
    lines = done.stderr.splitlines()
    assert len(lines) <= 1 and all(str(copy) in line for line in lines)
    again = run_simulation(copy)
    assert (again.stdout, again.stderr) == (printed, done.stderr if not lines else "")


@pytest.mark.parametrize("number", range(N_DAMAGES))
def test_damaged_configuration_is_read_or_rejected_in_one_line(tmp_path, number):
    path = tmp_path / "made.yaml"
    source = random.Random(number).choice(SHIPPED_FILES)
    path.write_bytes(damage_content(source.read_bytes(), number))
    try:
        load_experiment(path, CONFIG / "media")
    except ConfigError as error:
        line = str(error)
        assert line.startswith(str(path)) and line.isprintable()
        assert len(line) - len(str(path)) < 500
