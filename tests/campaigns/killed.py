"""What is killed: the work of the workflow's jobs in one process, each step where its file lacks.

Processes come from a server that has all libraries, so that a kill costs a second.
"""

from __future__ import annotations

import multiprocessing
import os
from pathlib import Path

import numba

import splits
from splits.archive import pack
from splits.figures import save_figure, surface
from splits.files import whole
from splits.transport.compiling import folders as kernels
from splits.unpacking import unpack

DATA, TABLE, FIGURE = "data/made.nc", "tables/made.csv", "figures/made"
ARCHIVE = "archive/made.zip"
DRAWN = tuple(f"{FIGURE}{suffix}" for suffix in (".png", ".svg", ".pdf"))
UNPACKED = "unpacked"
MADE = (DATA, TABLE, *DRAWN, ARCHIVE, UNPACKED)
WAVES = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "waves": 8, "correlation": "gaussian"}
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload([__name__, "splits.instruments.surface_map"])


def work(results: Path, cache: Path) -> None:
    """Make what is missing in a folder of results, with kernels of a private cache."""
    os.environ["XDG_CACHE_HOME"] = str(cache)
    numba.config.CACHE_DIR = ""
    kernels.folders.cache_clear()
    data, table, archive = (results / name for name in (DATA, TABLE, ARCHIVE))
    if not data.exists():
        layer = splits.Layer(surface=WAVES, depth_m=10.0)
        splits.save(splits.surface_map(layer, 1.0, points=41, realisations=2), data)
    dataset = splits.load(data)
    if not table.exists():
        with whole(table) as aside:
            dataset.height.to_dataframe().to_csv(aside)
    if not all(path.exists() for path in (results / name for name in DRAWN)):
        save_figure(surface(dataset), results / FIGURE)
    if not archive.exists():
        pack([results / name for name in (DATA, TABLE, *DRAWN)], {}, archive)
    if not (results / UNPACKED).exists():
        unpack(archive, results / UNPACKED)


def started(results: Path, cache: Path) -> multiprocessing.Process:
    """Return a process that works."""
    process = PROCESSES.Process(target=work, args=(results, cache))
    process.start()
    return process
