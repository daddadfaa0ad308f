"""Tables as experiments: a part of the ensembles of one, and all of them put together."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import xarray as xr

from splits.dataset import save
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation
from splits.files import whole
from splits.instruments import Progress
from splits.instruments.spectral_run import Run
from splits.lookup.assembly import blank, fill, finished
from splits.lookup.block import Order, block_file
from splits.lookup.large import IN_MEMORY, bytes_of, write_by_blocks
from splits.lookup.measuring import blocks, digest_of
from splits.lookup.plan import Ensemble, Plan

BLOCKS = 8
"""Parts of a table that are jobs of their own, unless the experiment says how many."""
MAX_RAYS = 20_000_000
Say = Callable[[str], None]


def parts_of(experiment: Simulation) -> int:
    """Return how many parts a table has."""
    return experiment.instrument.blocks or BLOCKS


def plan_of(experiment: Simulation) -> Plan:
    """Return what is to be traced for a table; refuses points of it that cannot be."""
    instrument = experiment.instrument
    axes, wavelengths = experiment.make_axes(), instrument.get_wavelengths()
    return Plan.from_grid(experiment.make_medium, axes, wavelengths, instrument.incidence_deg)


def order_of(
    experiment: Simulation, accuracy: Accuracy, seed: int, threads: int | None = None
) -> Order:
    """Return how a table is to be measured."""
    instrument = experiment.instrument
    own = seed if instrument.seed is None else instrument.seed
    error = min(instrument.error_factor * accuracy.max_stderr, 0.5)
    rays = accuracy.max_rays or MAX_RAYS
    run = Run.from_arguments(instrument.get_wavelengths(), 0.0, error, own, rays, threads, "auto")
    quantities = instrument.quantities or ("reflectance",)
    return Order(run, quantities, instrument.covariance == "keep")


def run_part(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    part: int,
    threads: int | None = None,
    log: Say = lambda line: None,
) -> list[Path]:
    """Measure every so many-th ensemble of a table, from that one on, and keep its block.

    What a folder has of them already is left as it is.

    Parameters
    ----------
    experiment : Simulation
        Of instrument "table".
    accuracy, seed, threads, say
        As for `splits.experiments.run.run`.
    folder : path
        Keeps the blocks.
    part : int
        From 0 to `parts_of` less 1.

    Returns
    -------
    list of Path
        Of the blocks.
    """
    plan, order = plan_of(experiment), order_of(experiment, accuracy, seed, threads)
    mine = plan.path_groups[part :: parts_of(experiment)]
    log(f"{experiment.name}: {plan}")
    for _ in _measured(experiment, order, mine, folder, log):
        pass
    return [block_file(folder, one.number, digest_of(one, order)) for one in mine]


def run_table(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int,
    folder: Path | None,
    threads: int | None = None,
    log: Say = lambda line: None,
) -> xr.Dataset:
    """Return a table: blocks that a folder keeps, and what is missing measured."""
    begun = time.perf_counter()
    plan, order = plan_of(experiment), order_of(experiment, accuracy, seed, threads)
    log(f"{experiment.name}: {plan}")
    found, facts = blank(plan, order), []
    for block in _measured(experiment, order, plan.path_groups, folder, log):
        fill(found, block)
        facts.append(block.attrs)
    return _named(experiment, finished(found, plan, order, facts, time.perf_counter() - begun))


def write_table(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    path: Path,
    threads: int | None = None,
    log: Say = lambda line: None,
) -> None:
    """Write the table that `run_table` returns, one that does not fit into memory block by block.

    Parameters
    ----------
    path : path
        The file appears whole or not at all.
    """
    plan, order = plan_of(experiment), order_of(experiment, accuracy, seed, threads)
    if bytes_of(plan, order) <= IN_MEMORY:
        save(run_table(experiment, accuracy, seed, folder, threads, log), path)
        return
    log(f"{experiment.name}: {plan}")
    write_by_blocks(
        path,
        plan,
        order,
        lambda: _measured(experiment, order, plan.path_groups, folder, log),
        lambda table: _named(experiment, table),
    )


def _named(experiment: Simulation, table: xr.Dataset) -> xr.Dataset:
    """Return a table that says of which experiment it is."""
    return table.assign_attrs(
        title=f"Experiment {experiment.name}",
        experiment=experiment.name,
        instrument="table",
        configuration=experiment.dump_configuration(),
    )


def _measured(
    experiment: Simulation,
    request: Order,
    groups: Sequence[Ensemble],
    folder: Path | None,
    log: Say,
) -> Iterator[xr.Dataset]:
    """Yield blocks, and say how far they are."""
    head, count = f"{experiment.name}: {len(groups)} ensembles", len(groups)

    def show(progress: Progress) -> None:
        log(f"{head}, {progress}")

    for number, block in enumerate(blocks(request, groups, folder, show), start=1):
        reached = float(block.attrs["max_stderr_reached"])
        log(f"{head}: {number} of {count} done, {block.attrs['rays']} rays, error {reached:.4f}")
        yield block


def note_part(files: Sequence[Path], path: Path) -> None:
    """Write down which blocks a part has made, with their checksums."""
    made = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    with whole(path) as aside:
        aside.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


def drop_unused(manifests: Sequence[Path]) -> None:
    """Delete the blocks beside the notes of a table's parts that none of these names."""
    made = {name for note in manifests for name in json.loads(note.read_text(encoding="utf-8"))}
    for file in manifests[0].parent.glob("block_*.nc"):
        if file.name not in made:
            file.unlink(missing_ok=True)
