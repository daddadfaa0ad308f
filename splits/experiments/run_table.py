"""Execution in parts: tables from the blocks of their path groups, and the snowpacks of files."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.keywords import log_missed_error, nest_runs
from splits.core.progress import LogCallback, Progress
from splits.core.provenance import hash_physics_sources
from splits.experiments.config.instruments import FUNCTIONS
from splits.experiments.config.media import PACKS_PER_BLOCK, count_pack_parts
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.cache import Cache, compute_digest
from splits.io.netcdf import make_provenance, save, to_netcdf_attributes
from splits.media.snow_pack_input import FLAG_NAME
from splits.media.snow_packs import SnowPacks, count_missing_results
from splits.simulation.run_options import RunOptions
from splits.simulation.strata import STOP_REASONS
from splits.tables.blocks import (
    PathGroup,
    TablePlan,
    assemble_blocks,
    compute_table_bytes,
    write_table_blockwise,
)
from splits.tables.build import (
    BLOCK_PREFIX,
    add_comparisons,
    iterate_blocks,
    list_block_inputs,
)
from splits.tables.table import MAX_BYTES_IN_MEMORY

MAX_RAYS = 20_000_000
"""Largest number of rays of a spectrum, or of a set of spectra that share paths."""


def count_parts(experiment: SimulationConfig) -> int:
    """Return the number of parts of a table, or of the snowpacks of a file."""
    if experiment.has_packs:
        return count_pack_parts(experiment.load_packs())
    return int(experiment.instrument.get("parts"))


def prepare_table(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> TablePlan:
    """Return the plan of a table, which is logged.

    Raises
    ------
    ValueError
        For points that cannot be simulated, or to which a required solver does not apply.
    """
    instrument = experiment.instrument
    error, rays = instrument.scale_stderr(accuracy.max_stderr), accuracy.max_rays or MAX_RAYS
    run = RunOptions.start(instrument.get_seed(seed), threads)
    request = SpectralRequest(instrument.get_wavelengths(), 0.0, error, rays, run)
    with experiment.locate_errors({}):
        plan = TablePlan.from_grid(
            experiment.make_medium, experiment.make_axes(), request, instrument.get_incidence(),
            instrument.get("quantities"), covariance=instrument.get("covariance") == "keep",
        )  # fmt: skip
        plan = plan._replace(solver=instrument.choose_solver(plan.list_media(), error))
    log(f"{experiment.name}: {plan}")
    return plan


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
    blocks: Iterator[xr.Dataset]
    if experiment.has_packs:
        packs = experiment.load_packs()
        parts = _divide(packs)[part :: count_pack_parts(packs)]
        blocks = _iterate_blocks(experiment, accuracy, parts, folder, threads, log)
        keys = [_list_inputs(experiment, accuracy, one) for one in parts]
    else:
        plan = prepare_table(experiment, accuracy, seed, threads, log)
        groups = plan.select_part(part, count_parts(experiment))
        blocks = _simulate_blocks(experiment, plan, groups, folder, log)
        keys = [list_block_inputs(one, plan) for one in groups]
    for _ in blocks:
        pass
    cache = Cache(folder, BLOCK_PREFIX)
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
    plan = prepare_table(experiment, accuracy, seed, threads, log)
    blocks = _simulate_blocks(experiment, plan, plan.path_groups, folder, log)
    return _complete_table(experiment, plan, folder, log, assemble_blocks(plan, blocks))


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
    plan = prepare_table(experiment, accuracy, seed, threads, log)
    simulate = partial(_simulate_blocks, experiment, plan, plan.path_groups, folder, log)
    complete = partial(_complete_table, experiment, plan, folder, log)
    if compute_table_bytes(plan) <= MAX_BYTES_IN_MEMORY:
        save(complete(assemble_blocks(plan, simulate())), path)
    else:
        write_table_blockwise(path, plan, simulate, complete)


def _complete_table(
    experiment: SimulationConfig,
    plan: TablePlan,
    folder: Path | None,
    log: LogCallback,
    table: xr.Dataset,
) -> xr.Dataset:
    """Return a table with spectra between its nodes and the attributes of its experiment.

    A missed error is logged.
    """
    log_missed_error(log, experiment.name, table)
    grid = experiment.make_axes()
    table = add_comparisons(table, experiment.make_medium, grid, plan, folder)
    return table.assign_attrs(
        title=f"Experiment {experiment.name}",
        experiment=experiment.name,
        instrument="table",
        configuration=experiment.dump_configuration(),
    )


def _simulate_blocks(
    experiment: SimulationConfig,
    plan: TablePlan,
    groups: Sequence[PathGroup],
    folder: Path | None,
    log: LogCallback,
) -> Iterator[xr.Dataset]:
    """Yield blocks and log the progress."""
    prefix = f"{experiment.name}: {len(groups)} path groups"

    def show(progress: Progress) -> None:
        log(f"{prefix}, {progress}")

    for number, block in enumerate(iterate_blocks(plan, groups, folder, show), start=1):
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


LARGEST_ATTRIBUTES = ("max_stderr_reached", "streams", "truncation_error", "optics_error")
"""Attributes that are the largest of all blocks."""


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
    blocks = list(_iterate_blocks(experiment, accuracy, _divide(packs), folder, threads, log))
    dataset = xr.concat(
        blocks, packs.label, data_vars="minimal", coords="minimal", compat="override",
        combine_attrs="override",
    )  # fmt: skip
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


def _divide(packs: SnowPacks) -> list[SnowPacks]:
    """Return the blocks of snowpacks."""
    starts = range(0, len(packs), PACKS_PER_BLOCK)
    slices = [{packs.label: slice(start, start + PACKS_PER_BLOCK)} for start in starts]
    return [SnowPacks(packs.dataset.isel(rows), packs.label) for rows in slices]


def _iterate_blocks(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    blocks: Sequence[SnowPacks],
    folder: Path | None,
    threads: int | None,
    log: LogCallback,
) -> Iterator[xr.Dataset]:
    """Yield the results of blocks, loaded from a folder or stored there."""
    cache, instrument = Cache(folder, BLOCK_PREFIX), experiment.instrument
    measure = partial(
        FUNCTIONS[instrument.kind], **instrument.list_arguments(), threads=threads,
        max_stderr=instrument.scale_stderr(accuracy.max_stderr),
    )  # fmt: skip
    for done, packs in enumerate(blocks, start=1):
        with nest_runs(), experiment.locate_errors({}):
            key = _list_inputs(experiment, accuracy, packs)
            result = cache.get(key, partial(measure, packs))
        log(f"{experiment.name}: {done} of {len(blocks)} blocks done")
        yield result


def _list_inputs(experiment: SimulationConfig, accuracy: Accuracy, packs: SnowPacks) -> list[Any]:
    """Return all that determines the values of a block, as the key of a cache."""
    instrument = experiment.instrument
    error = instrument.scale_stderr(accuracy.max_stderr)
    table = packs.dataset.to_dict(data="array")
    return [hash_physics_sources(), instrument.to_content(), error, table]
