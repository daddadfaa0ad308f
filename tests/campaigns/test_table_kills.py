"""A killed build of a table loses one ensemble at most, and the next build continues.

Two by default.  The campaign proper is ``make campaign``, or

    KILLS=200 python -m pytest -s tests/campaigns/test_table_kills.py

A quarter of that number of kills is of a table.
"""

import os
import random
import time

import killed
import pytest
import xarray as xr
from chi2 import NEEDS_JIT

import splits
from splits.tables import build

pytestmark = [NEEDS_JIT, pytest.mark.slow, pytest.mark.long]

N_KILLS = max(2, int(os.environ.get("KILLS", "5")) // 4)
N_ENSEMBLES = 6
_MAX_WAIT_S = 300.0


def make_table(folder, queue=None):
    """Build a table; put the number of measured ensembles into a queue."""
    measured = []
    original = build.compute_block

    def count_ensemble(ensemble, *given):
        measured.append(ensemble.number)
        return original(ensemble, *given)

    build.compute_block = count_ensemble
    table = splits.build_table(
        splits.Snow.natural,
        {"optical_radius_um": [50.0, 100.0], "incidence_deg": [0.0, 30.0, 60.0],
         "liquid_water_content": [0.0, 0.03]},
        [600.0, 1030.0], max_stderr=0.02, folder=folder, solver="monte_carlo",
    ).dataset  # fmt: skip
    build.compute_block = original
    if queue is not None:
        queue.put(len(measured))
    return table


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return a table built without interruption, and its time with compiled kernels (s)."""
    make_table(tmp_path_factory.mktemp("warm"))
    start = time.monotonic()
    table = make_table(tmp_path_factory.mktemp("reference"))
    return table, time.monotonic() - start


@pytest.mark.parametrize("number", range(N_KILLS))
def test_killed_table_build_continues(reference, tmp_path, number, counter):
    expected_table, longest = reference
    rng = random.Random(number)
    folder = tmp_path / "blocks"
    process = killed.PROCESSES.Process(target=make_table, args=(folder,))
    process.start()
    while not folder.exists() and process.is_alive():
        time.sleep(0.001)
    time.sleep(rng.uniform(0.0, longest))
    hit = process.is_alive()
    process.kill()
    process.join()
    counter("kills of tables", number, "hit" if hit else "too late")
    blocks = sorted(folder.glob("block_*.nc"))
    for block in blocks:
        splits.load(block)
    queue = killed.PROCESSES.Queue()
    again = killed.PROCESSES.Process(target=make_table, args=(folder, queue))
    again.start()
    measured = queue.get(timeout=_MAX_WAIT_S)
    again.join(_MAX_WAIT_S)
    assert measured == N_ENSEMBLES - len(blocks)
    assert [path for path in folder.rglob(".*")] == []
    xr.testing.assert_equal(make_table(folder), expected_table)
