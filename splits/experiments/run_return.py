"""Execution of retrievals from returns of a pulse, measured or synthetic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from splits.core.progress import LogCallback
from splits.core.validation import key_prefix
from splits.experiments.config.beam_instruments import ReturnTable, dump_pulse
from splits.experiments.config.measured_return import (
    BIN_COLUMNS,
    MeasuredReturn,
    RetrieveReturnSection,
)
from splits.experiments.config.return_checks import make_true_medium
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_retrieve import SINGLE_MODEL, SampleRetrieval, write_samples
from splits.instruments.time_of_flight import time_of_flight
from splits.io.netcdf import load
from splits.materials.csv_table import read_numeric_csv
from splits.retrieval.retrieve_return import retrieve_return
from splits.retrieval.state_vector import SCALE


def simulate_returns(
    experiment: SimulationConfig,
    section: RetrieveReturnSection,
    seed: int,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> dict[str, MeasuredReturn]:
    """Return synthetic returns of known media, from other paths than those of the table.

    Parameters
    ----------
    experiment : SimulationConfig
        With an instrument `return_table`.
    section : RetrieveReturnSection
        With `synthetic`.
    seed : int
        Default seed of the experiment.
    threads : int, optional
    log : callable
        Receives lines of progress.
    """
    synthetic, instrument = section.synthetic, experiment.instrument
    assert synthetic is not None and isinstance(instrument, ReturnTable)
    seed = instrument.get_seed(seed) + synthetic.seed_offset
    edges = np.array(synthetic.delay_s)
    returns = {}
    for number, (sample, truth) in enumerate(synthetic.truth.items()):
        log(f"{sample}: simulating a return")
        medium, incidence = make_true_medium(experiment, section, sample)
        light = time_of_flight(
            medium, instrument.get_wavelengths(), incidence, synthetic.rays, seed, delay_s=edges,
            pulse=dump_pulse(section.pulse), acceptance_deg=instrument.acceptance_deg,
            footprint_radius_m=instrument.footprint_radius_m, threads=threads,
        )  # fmt: skip
        one_photon = section.scale_counts(np.ones(edges.size - 1), edges).rates
        rates = light.return_rate.sel(side="reflected").transpose("wavelength", "delay").values
        expected = truth.get(SCALE, 1.0) * rates / one_photon
        counts = np.random.default_rng([seed, number]).poisson(expected)
        returns[sample] = section.scale_counts(counts, edges)
    return returns


def retrieve_samples(
    section: RetrieveReturnSection,
    table: xr.Dataset,
    returns: dict[str, MeasuredReturn],
    seed: int = 1,
    log: LogCallback = lambda line: None,
) -> list[SampleRetrieval]:
    """Return the retrievals of all samples, and log them beside known values."""
    references, retrievals = section.list_references(), []
    for sample, (edges, rates, noise) in returns.items():
        with key_prefix(f"retrieve_return ({sample})"):
            result = retrieve_return(
                (edges, rates), table, section.free, noise, pulse=dump_pulse(section.pulse),
                fixed=section.fixed or None, prior=section.prior or None, seed=seed,
            )  # fmt: skip
        retrievals.append(SampleRetrieval(SINGLE_MODEL, sample, result, np.nan, False))
        for line in repr(result).splitlines():
            log(f"{sample}: {line}")
        for name, values in references.items():
            if sample in values:
                found = f"{result.values[name]:.4g} ± {result.stderr[name]:.2g}"
                log(f"{sample}: {name} {found}, reference {values[sample]:g}")
    return retrievals


def write_return_retrieval(
    experiment: SimulationConfig,
    section: RetrieveReturnSection,
    files: tuple[str | Path, str | Path | None],
    seed: int,
    outputs: tuple[str | Path, str | Path],
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> None:
    """Retrieve parameters from returns of a pulse, and write them as a table and as a figure.

    `files` are the dataset of the table and the CSV file of measured returns, None for synthetic
    ones; for `outputs` and `log`, see `splits.experiments.run_retrieve.write_retrieval`.
    """
    table_path, measured_path = files
    table = load(table_path)
    if measured_path is None:
        returns = simulate_returns(experiment, section, seed, threads, log)
    else:
        measured = read_numeric_csv("retrieve_return.measured", measured_path, BIN_COLUMNS)
        returns = section.select_returns(measured, table.wavelength.values)
    retrievals = retrieve_samples(section, table, returns, seed, log)
    write_samples(retrievals, experiment.name, section.list_references(), [""], outputs)
