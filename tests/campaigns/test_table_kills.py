"""Kills of a table: whatever ensemble it was at, that is all that is lost, and it goes on.

Two by default.  The campaign proper is ``make campaign``, or

    KILLS=200 python -m pytest -s tests/campaigns/test_table_kills.py

One of four of these kills hits a table.
"""

from __future__ import annotations

import os
import random
import time

import killed
import pytest
import xarray as xr
from chi2 import NEEDS_JIT

import splits
from splits.tables import build

pytestmark = [NEEDS_JIT, pytest.mark.slow]

N_KILLS = max(2, int(os.environ.get("KILLS", "5")) // 4)
N_PATH_GROUPS = 6
_MAX_WAIT_S = 300.0


def make_table(folder, told=None):
    """Make a table, and tell how many ensembles were measured."""
    measured = []
    original = build.compute_block

    def counting(ensemble, *given):
        measured.append(ensemble.number)
        return original(ensemble, *given)

    build.compute_block = counting
    found = splits.build_table(
        splits.Snow.natural,
        {"optical_radius_um": [50.0, 100.0], "incidence_deg": [0.0, 30.0, 60.0],
         "liquid_water_content": [0.0, 0.03]},
        [600.0, 1030.0], max_stderr=0.02, folder=folder,
    )  # fmt: skip
    build.compute_block = original
    if told is not None:
        told.put(len(measured))
    return found


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return the table made at one go, and how long that takes when kernels are there (s)."""
    make_table(tmp_path_factory.mktemp("warm"))
    begun = time.monotonic()
    found = make_table(tmp_path_factory.mktemp("reference"))
    return found, time.monotonic() - begun


@pytest.mark.parametrize("number", range(N_KILLS))
def test_a_killed_table_goes_on(reference, tmp_path, number, counted):
    whole, longest = reference
    chance = random.Random(number)
    folder = tmp_path / "blocks"
    process = killed.PROCESSES.Process(target=make_table, args=(folder,))
    process.start()
    while not folder.exists() and process.is_alive():
        time.sleep(0.001)
    time.sleep(chance.uniform(0.0, longest))
    hit = process.is_alive()
    process.kill()
    process.join()
    counted("kills of tables", number, "hit" if hit else "too late")
    blocks = sorted(folder.glob("block_*.nc"))
    for block in blocks:
        splits.load(block)
    told = killed.PROCESSES.Queue()
    again = killed.PROCESSES.Process(target=make_table, args=(folder, told))
    again.start()
    measured = told.get(timeout=_MAX_WAIT_S)
    again.join(_MAX_WAIT_S)
    assert measured == N_PATH_GROUPS - len(blocks)
    assert [path for path in folder.rglob(".*")] == []
    xr.testing.assert_equal(make_table(folder), whole)
