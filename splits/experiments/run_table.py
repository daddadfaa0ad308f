"""Execution of tables: simulation of some of their path groups, and assembly of all."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.convergence import log_missed_error
from splits.core.progress import LogCallback, Progress
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.config.instrument_kinds import TableInstrument
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.config.snow_packs import count_pack_parts
from splits.experiments.run_packs import run_pack_part, run_packs
from splits.experiments.run_points import MAX_RAYS
from splits.instruments.spectral_run import SpectralRequest
from splits.io.cache import Cache, compute_digest
from splits.io.netcdf import save
from splits.simulation.run_options import RunOptions
from splits.tables.assembly import (
    MAX_BYTES_IN_MEMORY,
    allocate_arrays,
    assemble_dataset,
    compute_table_bytes,
    insert_block,
    write_table_blockwise,
)
from splits.tables.axes import ViewGrid, check_quantities, drop_view_axes, has_diffuse
from splits.tables.block import TableRequest
from splits.tables.build import (
    BLOCK_PREFIX,
    compute_table,
    iterate_blocks,
    list_block_inputs,
    warn_of_wide_intervals,
)
from splits.tables.comparison import add_comparisons
from splits.tables.plan import PathGroup, TablePlan


def count_parts(experiment: SimulationConfig) -> int:
    """Return the number of parts of a table, or of the snowpacks of a file."""
    if experiment.has_packs:
        return count_pack_parts(experiment.load_packs())
    instrument = experiment.instrument
    assert isinstance(instrument, TableInstrument)
    return instrument.parts


def prepare_table(
    experiment: SimulationConfig, accuracy: Accuracy, seed: int, threads: int | None = None
) -> tuple[TablePlan, TableRequest]:
    """Return the plan of a table and the settings of its simulation.

    Raises
    ------
    ValueError
        For points that cannot be simulated, or to which a required solver does not apply.
    """
    instrument, axes = experiment.instrument, experiment.make_axes()
    assert isinstance(instrument, TableInstrument)
    wavelengths, incidence = instrument.get_wavelengths(), instrument.get_incidence()
    has_covariance = instrument.covariance == "keep"
    views = ViewGrid.from_grid(axes)
    quantities = check_quantities(instrument.quantities, views, has_covariance)
    plan = TablePlan.from_grid(
        experiment.make_medium, drop_view_axes(axes), wavelengths, incidence,
        has_views=views is not None, with_diffuse=has_diffuse(quantities),
    )  # fmt: skip
    error, rays = instrument.scale_stderr(accuracy.max_stderr), accuracy.max_rays or MAX_RAYS
    run = RunOptions.from_arguments(instrument.get_seed(seed), threads)
    request = SpectralRequest.from_arguments(wavelengths, 0.0, error, rays, run)
    solver = instrument.choose_solver(plan.list_media(), error)
    return plan, TableRequest(request, quantities, has_covariance, solver, views)


def run_part(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    part: int,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> list[Path]:
    """Simulate the path groups of one part of a table, and return the files of their blocks.

    Likewise for the snowpacks of a file.  Existing blocks in the folder are kept.  `part` is a
    number from 0 to `count_parts` − 1; for the other arguments, see `splits.experiments.run.run`.
    """
    if experiment.has_packs:
        return run_pack_part(experiment, accuracy, folder, part, threads, log)
    plan, request = prepare_table(experiment, accuracy, seed, threads)
    groups = plan.select_part(part, count_parts(experiment), request.solver)
    log(f"{experiment.name}: {plan}")
    for _ in _simulate_blocks(experiment, request, groups, folder, log):
        pass
    cache, keys = Cache(folder, BLOCK_PREFIX), [list_block_inputs(one, request) for one in groups]
    return [cache.find_path(compute_digest(*key)) for key in keys]


def run_table(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path | None,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> xr.Dataset:
    """Return a table, or all snowpacks of a file, from the blocks in a folder.

    Missing blocks are simulated.
    """
    if experiment.has_packs:
        return run_packs(experiment, accuracy, folder, threads, log)
    plan, request = prepare_table(experiment, accuracy, seed, threads)
    return _make_table(experiment, plan, request, folder, log)


def _make_table(
    experiment: SimulationConfig,
    plan: TablePlan,
    request: TableRequest,
    folder: Path | None,
    log: LogCallback,
) -> xr.Dataset:
    """Return a table, see `run_table`."""
    start_time = time.perf_counter()
    log(f"{experiment.name}: {plan}")
    arrays, block_attributes = allocate_arrays(plan, request), []
    for block in _simulate_blocks(experiment, request, plan.path_groups, folder, log):
        insert_block(arrays, block)
        block_attributes.append(block.attrs)
    seconds = time.perf_counter() - start_time
    table = assemble_dataset(arrays, plan, request, block_attributes, seconds)
    return _complete_table(experiment, plan, request, folder, log, table)


def write_table(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    path: Path,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> None:
    """Write the result of `run_table` atomically, block by block if it exceeds the memory limit."""
    if experiment.has_packs:
        save(run_packs(experiment, accuracy, folder, threads, log), path)
        return
    plan, request = prepare_table(experiment, accuracy, seed, threads)
    if compute_table_bytes(plan, request) <= MAX_BYTES_IN_MEMORY:
        save(_make_table(experiment, plan, request, folder, log), path)
        return
    log(f"{experiment.name}: {plan}")
    simulate = partial(_simulate_blocks, experiment, request, plan.path_groups, folder, log)
    complete = partial(_complete_table, experiment, plan, request, folder, log)
    write_table_blockwise(path, plan, request, simulate, complete)


def _complete_table(
    experiment: SimulationConfig,
    plan: TablePlan,
    request: TableRequest,
    folder: Path | None,
    log: LogCallback,
    table: xr.Dataset,
) -> xr.Dataset:
    """Return a table with spectra between its nodes and the attributes of its experiment.

    A missed error is logged.
    """
    log_missed_error(log, experiment.name, table)
    compute, grid = partial(compute_table, folder=folder), experiment.make_axes()
    compared = add_comparisons(table, experiment.make_medium, grid, plan, request, compute)
    warn_of_wide_intervals(compared)
    return compared.assign_attrs(
        title=f"Experiment {experiment.name}",
        experiment=experiment.name,
        instrument="table",
        configuration=experiment.dump_configuration(),
    )


def _simulate_blocks(
    experiment: SimulationConfig,
    request: TableRequest,
    groups: Sequence[PathGroup],
    folder: Path | None,
    log: LogCallback,
) -> Iterator[xr.Dataset]:
    """Yield blocks and log the progress."""
    prefix = f"{experiment.name}: {len(groups)} path groups"

    def show(progress: Progress) -> None:
        log(f"{prefix}, {progress}")

    for number, block in enumerate(iterate_blocks(request, groups, folder, show), start=1):
        rays, error = block.attrs["rays"], float(block.attrs["max_stderr_reached"])
        log(f"{prefix}: {number} of {len(groups)} done, {rays} rays, error {error:.4f}")
        yield block


def write_part_manifest(files: Sequence[Path], path: Path) -> None:
    """Write the names and checksums of the blocks of a part."""
    checksums = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    with atomic_write(path) as temporary_path:
        temporary_path.write_text(json.dumps(checksums, indent=1) + "\n", encoding="utf-8")


def delete_unused_blocks(manifests: Sequence[Path]) -> None:
    """Delete the blocks that no manifest of a table's parts names."""
    texts = [manifest.read_text(encoding="utf-8") for manifest in manifests]
    names = {name for text in texts for name in json.loads(text)}
    for file in manifests[0].parent.glob(f"{BLOCK_PREFIX}_*.nc"):
        if file.name not in names:
            file.unlink(missing_ok=True)
