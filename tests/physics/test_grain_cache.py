"""Kept results of paths through single grains: damage, foreign files, several processes, size."""

import os
import subprocess
import sys

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.progress import warn_once
from splits.discrete_ordinates import grains
from splits.discrete_ordinates.grains import MIN_RAYS, GrainTracing, load_grains

WAVELENGTHS = np.array([1300.0])
SNOW = splits.Snow(interpretation="radiative_transfer", saturation=0.0)
RAYS = MIN_RAYS // 16


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder for the results, and count how often grains are traced."""
    monkeypatch.setattr(grains, "find_cache_folder", lambda: tmp_path)
    warn_once.cache_clear()
    return tmp_path


@pytest.fixture
def traced(monkeypatch):
    """Return the digests of the grains that are traced."""
    digests, trace = [], GrainTracing.trace

    def count(self, digest, threads):
        digests.append(digest)
        return trace(self, digest, threads)

    monkeypatch.setattr(GrainTracing, "trace", count)
    return digests


def load(snow=SNOW, **settings):
    return load_grains(snow, WAVELENGTHS, **{"rays": RAYS, "threads": 1, **settings})


@NEEDS_JIT
def test_grains_are_traced_once(folder, traced):
    first, second = load(), load(threads=2)
    assert len(traced) == 1 and len(list(folder.iterdir())) == 1
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, two)
    # Depth, density, ground and the absorption of pores have no effect on grains.
    load(splits.Snow(
        interpretation="radiative_transfer", saturation=0.0, depth_m=0.5, ground=0.2,
        density_kg_m3=100.0, impurities_ng_g={"black_carbon": 50.0}, impurities_in="pores",
    ))  # fmt: skip
    assert len(traced) == 1
    load(splits.Snow(interpretation="radiative_transfer", saturation=0.0, temperature_c=-1.0,
                     impurities_ng_g={"black_carbon": 50.0}))  # fmt: skip
    load(splits.Snow(interpretation="radiative_transfer", saturation=0.1))
    load(rays=2 * RAYS)
    assert len(set(traced)) == 4


@NEEDS_JIT
@pytest.mark.parametrize("damage", ["empty", "cut", "bit", "text", "foreign", "folder"])
def test_damaged_and_foreign_files_are_not_used(folder, traced, caplog, damage):
    expected = load()
    (path,) = folder.iterdir()
    content = path.read_bytes()
    if damage == "foreign":
        load(rays=2 * RAYS)
        (other,) = set(folder.iterdir()) - {path}
        path.write_bytes(other.read_bytes())
    elif damage == "folder":
        path.unlink()
        path.mkdir()
    else:
        middle = len(content) // 2
        changed = bytes([content[middle] ^ 1])
        path.write_bytes({
            "empty": b"", "cut": content[:middle], "text": b"no numbers\n",
            "bit": content[:middle] + changed + content[middle + 1 :],
        }[damage])  # fmt: skip
    n_before = len(traced)
    found = load()
    assert len(traced) == n_before + 1
    np.testing.assert_array_equal(found.moments, expected.moments)
    messages = [record.getMessage() for record in caplog.records]
    assert all("made again" in one or "not kept" in one for one in messages) and messages
    if damage != "folder":
        load()
        assert len(traced) == n_before + 1


@NEEDS_JIT
def test_files_unused_for_long_are_removed(folder, monkeypatch):
    load()
    (first,) = folder.iterdir()
    os.utime(first, (1.0, 1.0))
    (folder / "kernel.nbc").write_bytes(b"0")
    monkeypatch.setattr(grains, "MAX_CACHE_BYTES", first.stat().st_size)
    load(rays=2 * RAYS)
    assert not first.exists() and len(list(folder.glob("grains_*.nc"))) == 1
    assert (folder / "kernel.nbc").exists()


@NEEDS_JIT
def test_without_a_folder_results_are_the_same(folder, traced, monkeypatch):
    expected = load()
    monkeypatch.setattr(grains, "find_cache_folder", lambda: None)
    np.testing.assert_array_equal(load().moments, expected.moments)
    assert len(traced) == 2


SCRIPT = """
import sys, numpy as np, pathlib, splits
from splits.discrete_ordinates import grains
grains.find_cache_folder = lambda: pathlib.Path(sys.argv[1])
snow = splits.Snow(interpretation="radiative_transfer", saturation=0.0)
loaded = grains.load_grains(snow, np.array([1300.0]), int(sys.argv[2]), 1)
print(loaded.moments.tobytes().hex()[:4000])
"""


@NEEDS_JIT
@pytest.mark.slow
def test_two_processes_at_once_have_the_same_result(tmp_path):
    command = [sys.executable, "-c", SCRIPT, str(tmp_path), str(RAYS)]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(2)]
    outputs = {process.communicate()[0] for process in processes}
    assert [process.returncode for process in processes] == [0, 0]
    assert len(outputs) == 1 and len(list(tmp_path.iterdir())) == 1
