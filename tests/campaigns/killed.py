"""The process that is killed: all steps of the workflow, each run if its output is missing.

Processes are forked from a server that has imported all libraries, which makes a kill cheap.
"""

import multiprocessing
import os
from pathlib import Path

import numba

import splits
from splits.core.atomic import atomic_write
from splits.experiments.archive import pack_archive
from splits.io.unarchive import unpack_archive
from splits.kernels.compiler.cache import find_cache_folder
from splits.plotting import draw_surface, save_figure

DATA_FILE, TABLE_FILE, FIGURE_STEM = "data/made.nc", "tables/made.csv", "figures/made"
ARCHIVE_FILE = "archive/made.zip"
FIGURE_FILES = tuple(f"{FIGURE_STEM}{suffix}" for suffix in (".png", ".svg", ".pdf"))
UNPACKED_FOLDER = "unpacked"
ALL_OUTPUTS = (DATA_FILE, TABLE_FILE, *FIGURE_FILES, ARCHIVE_FILE, UNPACKED_FOLDER)
ROUGH_SURFACE = {
    "rms_height_m": 0.1,
    "wave_number_per_m": 1.0,
    "waves": 8,
    "correlation": "gaussian",
}
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload([__name__, "splits.instruments.surface_map"])


def make_missing_outputs(results: Path, cache: Path) -> None:
    """Make the missing outputs of a folder of results, with kernels of a private cache."""
    os.environ["XDG_CACHE_HOME"] = str(cache)
    numba.config.CACHE_DIR = ""
    find_cache_folder.cache_clear()
    data, table, archive = (results / name for name in (DATA_FILE, TABLE_FILE, ARCHIVE_FILE))
    if not data.exists():
        layer = splits.ParticleLayer(surface=ROUGH_SURFACE, depth_m=10.0)
        splits.save(splits.surface_map(layer, half_width_m=1.0, points=41, realizations=2), data)
    dataset = splits.load(data)
    if not table.exists():
        with atomic_write(table) as aside:
            dataset.height.to_dataframe().to_csv(aside)
    if not all(path.exists() for path in (results / name for name in FIGURE_FILES)):
        save_figure(draw_surface(dataset), results / FIGURE_STEM)
    if not archive.exists():
        pack_archive(
            [results / name for name in (DATA_FILE, TABLE_FILE, *FIGURE_FILES)], {}, archive
        )
    if not (results / UNPACKED_FOLDER).exists():
        unpack_archive(archive, results / UNPACKED_FOLDER)


def start_worker(results: Path, cache: Path) -> multiprocessing.Process:
    """Start a process that makes missing outputs, and return it."""
    process = PROCESSES.Process(target=make_missing_outputs, args=(results, cache))
    process.start()
    return process
