"""Execution of experiments on the snowpacks of a file: blocks of snowpacks, and all of them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

from splits.core.convergence import log_missed_error, nest_runs
from splits.core.progress import LogCallback
from splits.core.provenance import hash_physics_sources
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.config.albedo_instrument import Albedo
from splits.experiments.config.instrument_kinds import Spectrophotometer
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.config.snow_packs import PACKS_PER_BLOCK, count_pack_parts
from splits.instruments import albedo, spectrophotometer
from splits.io.cache import Cache, compute_digest
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.snow_pack_quality import count_missing_results
from splits.media.snow_packs import SnowPacks
from splits.simulation.stopping_rule import STOP_REASONS
from splits.tables.build import BLOCK_PREFIX

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
    for _ in _iterate_blocks(experiment, accuracy, blocks, folder, threads, log):
        pass
    cache = Cache(folder, BLOCK_PREFIX)
    return [
        cache.find_path(compute_digest(*_list_inputs(experiment, accuracy, block)))
        for block in blocks
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
    if missing := count_missing_results(dataset):
        log(f"{experiment.name}: of {len(packs)} snowpacks, some have no result: {missing}")
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
    cache = Cache(folder, BLOCK_PREFIX)
    for done, packs in enumerate(blocks, start=1):
        measure = partial(_measure, experiment, accuracy, packs, threads)
        result = cache.get(_list_inputs(experiment, accuracy, packs), measure)
        log(f"{experiment.name}: {done} of {len(blocks)} blocks done")
        yield result


def _measure(
    experiment: SimulationConfig, accuracy: Accuracy, packs: SnowPacks, threads: int | None
) -> xr.Dataset:
    """Return the spectra or albedos of snowpacks."""
    instrument = experiment.instrument
    error, wavelengths = instrument.scale_stderr(accuracy.max_stderr), instrument.get_wavelengths()
    with nest_runs():
        if isinstance(instrument, Albedo):
            return albedo(
                packs, instrument.sky, wavelengths, error, bands=instrument.bands, threads=threads
            )
        assert isinstance(instrument, Spectrophotometer)
        incidence = instrument.get_incidence()
        return spectrophotometer(packs, wavelengths, incidence, error, threads=threads)


def _list_inputs(experiment: SimulationConfig, accuracy: Accuracy, packs: SnowPacks) -> list[Any]:
    """Return all that determines the values of a block, as the key of a cache."""
    instrument = experiment.instrument
    error = instrument.scale_stderr(accuracy.max_stderr)
    table = packs.dataset.to_dict(data="array")
    return [hash_physics_sources(), instrument.model_dump(mode="json"), error, table]
