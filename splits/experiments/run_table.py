"""Tables as experiments: a part of the ensembles of one, and all of them put together."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.progress import Progress
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments.spectral_run import SpectralRequest
from splits.io.netcdf import save
from splits.tables.assembly import allocate_arrays, assemble_dataset, insert_block
from splits.tables.block import TableRequest, make_block_path
from splits.tables.build import compute_block_digest, iterate_blocks
from splits.tables.plan import PathGroup, TablePlan
from splits.tables.storage import MAX_BYTES_IN_MEMORY, compute_table_bytes, write_table_blockwise

DEFAULT_N_BLOCKS = 8
"""Parts of a table that are jobs of their own, unless the experiment says how many."""
MAX_RAYS = 20_000_000
LogCallback = Callable[[str], None]


def count_parts(experiment: SimulationConfig) -> int:
    """Return how many parts a table has."""
    return experiment.instrument.blocks or DEFAULT_N_BLOCKS


def make_plan(experiment: SimulationConfig) -> TablePlan:
    """Return what is to be traced for a table; refuses points of it that cannot be."""
    instrument = experiment.instrument
    axes, wavelengths = experiment.make_axes(), instrument.get_wavelengths()
    return TablePlan.from_grid(experiment.make_medium, axes, wavelengths, instrument.incidence_deg)


def make_request(
    experiment: SimulationConfig, accuracy: Accuracy, seed: int, threads: int | None = None
) -> TableRequest:
    """Return how a table is to be measured."""
    instrument = experiment.instrument
    own = seed if instrument.seed is None else instrument.seed
    error = min(instrument.stderr_scale * accuracy.max_stderr, 0.5)
    rays = accuracy.max_rays or MAX_RAYS
    run = SpectralRequest.from_arguments(
        instrument.get_wavelengths(), 0.0, error, own, rays, threads, "auto"
    )
    quantities = instrument.quantities or ("reflectance",)
    return TableRequest(run, quantities, instrument.covariance == "keep")


def run_part(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    part: int,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> list[Path]:
    """Measure every so many-th ensemble of a table, from that one on, and keep its block.

    What a folder has of them already is left as it is.

    Parameters
    ----------
    experiment : SimulationConfig
        Of instrument "table".
    accuracy, seed, threads, say
        As for `splits.experiments.run.run`.
    folder : path
        Keeps the blocks.
    part : int
        From 0 to `count_parts` less 1.

    Returns
    -------
    list of Path
        Of the blocks.
    """
    plan, order = make_plan(experiment), make_request(experiment, accuracy, seed, threads)
    mine = plan.path_groups[part :: count_parts(experiment)]
    log(f"{experiment.name}: {plan}")
    for _ in _simulate_blocks(experiment, order, mine, folder, log):
        pass
    return [make_block_path(folder, one.number, compute_block_digest(one, order)) for one in mine]


def run_table(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path | None,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> xr.Dataset:
    """Return a table: blocks that a folder keeps, and what is missing measured."""
    begun = time.perf_counter()
    plan, order = make_plan(experiment), make_request(experiment, accuracy, seed, threads)
    log(f"{experiment.name}: {plan}")
    found, facts = allocate_arrays(plan, order), []
    for block in _simulate_blocks(experiment, order, plan.path_groups, folder, log):
        insert_block(found, block)
        facts.append(block.attrs)
    return _add_experiment_attributes(
        experiment, assemble_dataset(found, plan, order, facts, time.perf_counter() - begun)
    )


def write_table(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    path: Path,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> None:
    """Write the table that `run_table` returns, one that does not fit into memory block by block.

    Parameters
    ----------
    path : path
        The file appears whole or not at all.
    """
    plan, order = make_plan(experiment), make_request(experiment, accuracy, seed, threads)
    if compute_table_bytes(plan, order) <= MAX_BYTES_IN_MEMORY:
        save(run_table(experiment, accuracy, seed, folder, threads, log), path)
        return
    log(f"{experiment.name}: {plan}")
    write_table_blockwise(
        path,
        plan,
        order,
        lambda: _simulate_blocks(experiment, order, plan.path_groups, folder, log),
        lambda table: _add_experiment_attributes(experiment, table),
    )


def _add_experiment_attributes(experiment: SimulationConfig, table: xr.Dataset) -> xr.Dataset:
    """Return a table that says of which experiment it is."""
    return table.assign_attrs(
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
    """Yield blocks, and say how far they are."""
    head, count = f"{experiment.name}: {len(groups)} ensembles", len(groups)

    def show(progress: Progress) -> None:
        log(f"{head}, {progress}")

    for number, block in enumerate(iterate_blocks(request, groups, folder, show), start=1):
        reached = float(block.attrs["max_stderr_reached"])
        log(f"{head}: {number} of {count} done, {block.attrs['rays']} rays, error {reached:.4f}")
        yield block


def write_part_manifest(files: Sequence[Path], path: Path) -> None:
    """Write down which blocks a part has made, with their checksums."""
    made = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


def delete_unused_blocks(manifests: Sequence[Path]) -> None:
    """Delete the blocks beside the notes of a table's parts that none of these names."""
    made = {name for note in manifests for name in json.loads(note.read_text(encoding="utf-8"))}
    for file in manifests[0].parent.glob("block_*.nc"):
        if file.name not in made:
            file.unlink(missing_ok=True)
