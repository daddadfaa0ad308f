"""Execution in parts: tables from the blocks of their path groups, and the snowpacks of files."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.convergence import log_missed_error, nest_runs
from splits.core.progress import LogCallback, Progress
from splits.core.provenance import hash_physics_sources
from splits.experiments.config.instruments import Albedo, TableInstrument
from splits.experiments.config.media import PACKS_PER_BLOCK, count_pack_parts
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments import albedo, spectrophotometer
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.netcdf import make_provenance, save, to_netcdf_attributes
from splits.media.snow_pack_input import FLAG_NAME
from splits.media.snow_packs import SnowPacks, count_missing_results
from splits.simulation.run_options import RunOptions
from splits.simulation.strata import STOP_REASONS
from splits.tables.assembly import allocate_arrays, assemble_dataset, insert_block
from splits.tables.block import DIGEST_ATTRIBUTE, TableRequest, load_block, make_block_path
from splits.tables.build import (
    compute_block_digest,
    compute_table,
    iterate_blocks,
    warn_of_wide_intervals,
)
from splits.tables.comparison import add_comparisons
from splits.tables.plan import PathGroup, TablePlan
from splits.tables.storage import MAX_BYTES_IN_MEMORY, compute_table_bytes, write_table_blockwise
from splits.tables.views import ViewGrid, check_quantities, drop_view_axes, has_diffuse

MAX_RAYS = 20_000_000
"""Largest number of rays of a spectrum, or of a set of spectra that share paths."""


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
    with experiment.locate_errors({}):
        plan = TablePlan.from_grid(
            experiment.make_medium, drop_view_axes(axes), wavelengths, incidence,
            has_views=views is not None, with_diffuse=has_diffuse(quantities),
        )  # fmt: skip
    error, rays = instrument.scale_stderr(accuracy.max_stderr), accuracy.max_rays or MAX_RAYS
    run = RunOptions.from_arguments(instrument.get_seed(seed), threads)
    request = SpectralRequest.from_arguments(wavelengths, 0.0, error, rays, run)
    with experiment.locate_errors({}):
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
    digests = [compute_block_digest(group, request) for group in groups]
    return [make_block_path(folder, g.number, d) for g, d in zip(groups, digests, strict=True)]


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
    for file in manifests[0].parent.glob("block_*.nc"):
        if file.name not in names:
            file.unlink(missing_ok=True)


LARGEST_ATTRIBUTES = ("max_stderr_reached", "streams", "truncation_error", "optics_error")
"""Attributes that are the largest of all blocks."""


def run_pack_part(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    folder: Path,
    part: int,
    threads: int | None,
    log: LogCallback,
) -> list[Path]:
    """Simulate the blocks of one part that the folder lacks, and return the files of all of them.

    For the arguments, see `splits.experiments.run_table.run_part`.
    """
    packs = experiment.load_packs()
    blocks = _divide(packs)[part :: count_pack_parts(packs)]
    return [
        make_block_path(folder, number, str(block.attrs[DIGEST_ATTRIBUTE]))
        for number, block in _iterate_blocks(experiment, accuracy, blocks, folder, threads, log)
    ]


def run_packs(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    folder: Path | None,
    threads: int | None,
    log: LogCallback,
) -> xr.Dataset:
    """Return the spectra or albedos of all snowpacks, as `splits.spectrophotometer` does.

    Blocks in the folder are kept; missing ones are simulated.
    """
    start_time = time.perf_counter()
    packs = experiment.load_packs()
    found = _iterate_blocks(experiment, accuracy, _divide(packs), folder, threads, log)
    blocks = [block for _, block in found]
    dataset = xr.concat(
        blocks, packs.label, data_vars="minimal", coords="minimal", compat="override",
        combine_attrs="override",
    )  # fmt: skip
    del dataset.attrs[DIGEST_ATTRIBUTE]
    attributes = {
        **{key: max(block.attrs[key] for block in blocks) for key in LARGEST_ATTRIBUTES},
        "stop_reason": max(
            (block.attrs["stop_reason"] for block in blocks), key=STOP_REASONS.index
        ),
        **{f"{packs.kind}_{key}": value for key, value in packs.describe().items()},
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        **make_provenance(f"experiment {experiment.name}"),
    }
    dataset = dataset.assign_attrs(to_netcdf_attributes(attributes))
    log_missed_error(log, experiment.name, dataset)
    flag = packs.dataset[FLAG_NAME]
    # Blocks state their own first values.
    dataset[FLAG_NAME].attrs = {**flag.attrs, **dataset[FLAG_NAME].attrs}
    if missing := count_missing_results(dataset):
        first = f"; {flag.attrs['comment']}" if "comment" in flag.attrs else ""
        log(f"{experiment.name}: of {len(packs)} snowpacks, some have no result: {missing}{first}")
    return dataset


def _divide(packs: SnowPacks) -> list[tuple[int, SnowPacks]]:
    """Return the blocks of snowpacks with their numbers."""
    starts = range(0, len(packs), PACKS_PER_BLOCK)
    slices = [{packs.label: slice(start, start + PACKS_PER_BLOCK)} for start in starts]
    return [
        (number, SnowPacks(packs.dataset.isel(rows), packs.label))
        for number, rows in enumerate(slices)
    ]


def _iterate_blocks(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    blocks: Sequence[tuple[int, SnowPacks]],
    folder: Path | None,
    threads: int | None,
    log: LogCallback,
) -> Iterator[tuple[int, xr.Dataset]]:
    """Yield the results of blocks with their numbers, loaded from a folder or stored there."""
    for done, (number, packs) in enumerate(blocks, start=1):
        digest = _compute_digest(experiment, accuracy, packs)
        result = None if folder is None else load_block(folder, number, digest)
        if result is None:
            with nest_runs(), experiment.locate_errors({}):
                result = _measure(experiment, accuracy, packs, threads)
            result = result.assign_attrs({DIGEST_ATTRIBUTE: digest})
            if folder is not None:
                save(result, make_block_path(folder, number, digest))
        log(f"{experiment.name}: {done} of {len(blocks)} blocks done, from {number}")
        yield number, result


def _measure(
    experiment: SimulationConfig, accuracy: Accuracy, packs: SnowPacks, threads: int | None
) -> xr.Dataset:
    """Return the spectra or albedos of snowpacks."""
    instrument = experiment.instrument
    error, wavelengths = instrument.scale_stderr(accuracy.max_stderr), instrument.get_wavelengths()
    if isinstance(instrument, Albedo):
        return albedo(
            packs, instrument.sky, wavelengths, error, bands=instrument.bands, threads=threads
        )
    settings = {key: getattr(instrument, key) for key in ("solver", "estimator", "stokes")}
    return spectrophotometer(
        packs, wavelengths, instrument.get_incidence(), error, threads=threads, **settings
    )


def _compute_digest(experiment: SimulationConfig, accuracy: Accuracy, packs: SnowPacks) -> str:
    """Return the SHA-256 of all inputs that determine the values of a block."""
    instrument = experiment.instrument
    error = instrument.scale_stderr(accuracy.max_stderr)
    inputs = [hash_physics_sources(), instrument.model_dump(mode="json"), error]
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode())
    table = packs.dataset.to_dict()
    digest.update(json.dumps(table, sort_keys=True, default=str).encode())
    return digest.hexdigest()
