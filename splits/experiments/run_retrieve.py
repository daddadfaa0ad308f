"""Execution of retrievals: every sample of a measured table, with the experiment's table."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.measured import WAVELENGTH_COLUMN, read_spectra
from splits.core.escaping import write_data_frame
from splits.core.progress import LogCallback
from splits.core.validation import (
    check_choice,
    check_range,
    check_relations,
    format_key,
    key_prefix,
    snap_to_limits,
    unknown_key,
)
from splits.experiments.config.retrieval import (
    RetrieveReturnSection,
    RetrieveSection,
    check_on_grid,
)
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments.time_of_flight import time_of_flight
from splits.io.netcdf import load, make_provenance, to_netcdf_attributes
from splits.materials.csv_table import read_numeric_csv
from splits.media.kinds import MEDIUM_CLASSES, get_kind
from splits.media.medium import Medium
from splits.media.parameters import describe_parameter
from splits.retrieval.retrieve import RetrievalResult, retrieve
from splits.retrieval.retrieve_return import retrieve_return
from splits.retrieval.state_vector import SCALE
from splits.tables.axes import INCIDENCE
from splits.tables.table import Table

BIN_COLUMNS = (WAVELENGTH_COLUMN, "delay_start_s", "delay_end_s")
"""Columns of a measured return that describe its bins."""
STDERR_SUFFIX = "_stderr"
DELAY_TOLERANCE = 1e-6
"""Largest difference between delays that are equal, relative to the width of a bin."""
ANGLE_SEPARATOR = "@"
"""Separator between the name of a sample and its angle of incidence."""
SINGLE_MODEL, OWN_MODEL = "", "splits"
"""Names of our model: where it is the only one, and in a comparison with a law."""


class SampleRetrieval(NamedTuple):
    """Retrieval of one sample with one model."""

    model: str
    sample: str
    result: RetrievalResult
    reference_chi2: float
    """χ² with the known parameters fixed at their reference values, NaN without any.  Its
    difference between models shows which describes their effect better."""
    is_prior_sample: bool
    """Whether the sample was retrieved first, with some parameters fixed."""


def run_retrieve(
    section: RetrieveSection,
    table: Table,
    measured: pd.DataFrame,
    seed: int = 1,
    log: LogCallback = lambda line: None,
) -> list[SampleRetrieval]:
    """Return the retrievals of all samples with all models; errors name the key of the section."""
    spectra = select_spectra(section, measured, table.dataset.wavelength.values)
    n_used, n_all = len(next(iter(spectra.values()))), len(measured)
    if n_used < n_all:
        log(f"{n_all - n_used} of {n_all} wavelengths are excluded or outside the table")
    axis, law = section.model_axis, section.compare_with
    models: dict[str, tuple[Table, dict[str, Any]]] = {
        OWN_MODEL if law else SINGLE_MODEL: (table, {})
    }
    if axis:
        models = {str(model): (table, {axis: model}) for model in table.dataset[axis].values}
    if law:
        # Imports snowoptics, which no other part of a retrieval needs.
        from splits.analysis.theory.kokhanovsky_zege import make_law_table

        models[law] = make_law_table(table, law, axis), {}
    return [
        retrieval
        for model, (own_table, fixed) in models.items()
        for retrieval in _retrieve_with_model(section, own_table, spectra, model, fixed, seed, log)
    ]


def _retrieve_with_model(
    section: RetrieveSection,
    table: Table,
    spectra: Mapping[str, pd.Series],
    model: str,
    fixed_nodes: Mapping[str, Any],
    seed: int,
    log: LogCallback,
) -> list[SampleRetrieval]:
    """Return and log the retrievals of all samples with a table at fixed nodes."""
    known = (*table.axes, SCALE)

    def retrieve_sample(
        name: str, prior: Mapping[str, Any], known_values: Mapping[str, Any]
    ) -> RetrievalResult:
        names = [n for n in section.free if n not in known_values and n in known]
        ranges: Any = section.free
        free = {n: ranges[n] for n in names} if isinstance(ranges, Mapping) else names
        spectrum = spectra[name]
        noise = section.noise.evaluate(spectrum.to_numpy()) if section.noise else None
        fixed = {**get_fixed_values(section, name, table), **fixed_nodes, **known_values}
        with key_prefix(f"retrieve ({name})"):
            return retrieve(
                spectrum, table, free, noise, seed=seed, quantity=section.quantity,
                fixed={n: value for n, value in fixed.items() if n in known},
                prior={n: pair for n, pair in prior.items() if n in free} or None,
            )  # fmt: skip

    first_results = {
        source.sample: retrieve_sample(source.sample, section.prior, source.fixed)
        for source in section.prior_from
    }
    retrievals = []
    for name in spectra:
        is_first, chi2 = name in first_results, np.nan
        prior: dict[str, Any] = dict(section.prior)
        for source in section.prior_from:
            if name.startswith(source.applies_to):
                first = first_results[source.sample]
                prior |= {key: (value, first.stderr[key]) for key, value in first.values.items()}
        result = first_results[name] if is_first else retrieve_sample(name, prior, {})
        # The known parameters, fixed at their reference values.
        by_parameter = section.reference_values.items()
        references = {key: values[name] for key, values in by_parameter if name in values}
        others = {*section.free} - {*references, SCALE}
        is_compared = references and others and SCALE not in references and section.noise
        if is_compared and not is_first:
            chi2 = float(retrieve_sample(name, prior, references).dataset.attrs["chi2"])
        retrievals.append(SampleRetrieval(model, name, result, chi2, is_first))
        label = f"{name} ({model})" if model else name
        for line in repr(result).splitlines():
            log(f"{label}: {line}")
    return retrievals


def make_retrieval_table(
    retrievals: list[SampleRetrieval], reference: Mapping[str, Mapping[str, float]]
) -> pd.DataFrame:
    """Return a row for every parameter of every sample; `reference` has independent values."""
    rows = []
    for retrieval in retrievals:
        ds = retrieval.result.dataset
        for name in map(str, ds.parameter.values):
            part = ds.sel(parameter=name)
            low, below, middle, above, high = part.quantiles.values
            rows.append({
                "model": retrieval.model,
                "sample": retrieval.sample,
                "parameter": name,
                "description": describe_parameter(name)[0],
                "unit": str(part.parameter_unit.item()),
                "median": middle,
                "standard deviation": float(part.value_stderr),
                "reference value": reference.get(name, {}).get(retrieval.sample, np.nan),
                "16 %": below,
                "84 %": above,
                "2.5 %": low,
                "97.5 %": high,
                "constrained": "yes" if part.constrained else "no",
                "rmse": ds.attrs["rmse"],
                "averaging kernel": float(part.averaging_kernel.sel(other_parameter=name)),
                "chi2": ds.attrs["chi2"],
                "chi2 at reference": retrieval.reference_chi2,
                "chi2 expected": ds.attrs["chi2_expected"],
                "error inflation": ds.attrs["error_inflation"],
                "warnings": ds.attrs["warnings"],
            })  # fmt: skip
    table = pd.DataFrame(rows)
    return table if table.model.any() else table.drop(columns="model")


def combine_samples(retrievals: list[SampleRetrieval], experiment: str) -> xr.Dataset:
    """Return the dataset of all samples, for `splits.plotting.retrieval`.

    It is over models and samples, at the wavelengths common to all samples, without the samples
    that were retrieved first.
    """
    final = [retrieval for retrieval in retrievals if not retrieval.is_prior_sample]
    models = list(dict.fromkeys(retrieval.model for retrieval in final))
    datasets = [_combine_model([one for one in final if one.model == model]) for model in models]
    axis = xr.IndexVariable("model", models)
    joined = xr.concat(datasets, axis, join="outer", combine_attrs="drop")
    # Use the order of the first model, which has all parameters.
    order = final[0].result.dataset.parameter.values
    joined = joined.sel(parameter=order, other_parameter=order)
    attributes = {
        "title": f"Retrievals of {experiment}",
        "experiment": experiment,
        "quantity": final[0].result.dataset.attrs.get("quantity", "reflectance"),
        **make_provenance(f"retrievals of {experiment}"),
    }
    return joined.assign_attrs(to_netcdf_attributes(attributes))


def _combine_model(retrievals: list[SampleRetrieval]) -> xr.Dataset:
    """Return the dataset of all samples of one model."""
    datasets = [retrieval.result.dataset for retrieval in retrievals]
    axis = xr.IndexVariable("sample", [retrieval.sample for retrieval in retrievals])
    joined = xr.concat(datasets, axis, join="inner", combine_attrs="drop")
    for key in ("chi2", "chi2_expected", "error_inflation", "degrees_of_freedom"):
        row = np.array([dataset.attrs[key] for dataset in datasets])
        joined[key] = ("sample", row, {"long_name": key.replace("_", " "), "units": "1"})
    misfits = np.array([retrieval.reference_chi2 for retrieval in retrievals])
    attributes = {"long_name": "chi2 at reference values", "units": "1"}
    return joined.assign(chi2_at_reference=("sample", misfits, attributes))


def write_retrieval(
    section: RetrieveSection,
    table: str | Path,
    measured: str | Path,
    seed: int,
    outputs: tuple[str | Path, str | Path],
    log: LogCallback,
) -> None:
    """Retrieve parameters from measured spectra, and write them as a table and as a figure.

    `table` is the dataset of the table, with the name of the experiment.  `outputs` are the CSV
    table and the figure, which is written in all formats.  `log` receives lines for each sample.
    """
    spectra = read_spectra(Path(measured), "retrieve.measured")
    results = run_retrieve(section, Table(table), spectra, seed, log)
    # Figures show together the samples of a prefix.
    prefixes = [first.applies_to for first in section.prior_from] or [""]
    write_samples(results, Path(table).stem, section.reference_values, prefixes, outputs)


def write_samples(
    results: list[SampleRetrieval],
    experiment: str,
    references: Mapping[str, Mapping[str, float]],
    prefixes: Sequence[str],
    outputs: tuple[str | Path, str | Path],
) -> None:
    """Write the retrievals of all samples as a table and as a figure; see `write_retrieval`."""
    from splits.plotting.grammar import save_figure
    from splits.plotting.retrieval import draw_retrievals

    write_data_frame(make_retrieval_table(results, references), outputs[0])
    figure = draw_retrievals(combine_samples(results, experiment), references, prefixes)
    save_figure(figure, Path(outputs[1]).with_suffix(""))


def select_spectra(
    section: RetrieveSection, measured: pd.DataFrame, wavelengths: np.ndarray
) -> dict[str, pd.Series]:
    """Return the spectra by sample, at the measured wavelengths that are used.

    Unknown samples, and tables that do not match the section, are rejected.
    """
    key, columns = "retrieve.measured", list(measured.columns)
    available = [str(name) for name in columns if name != WAVELENGTH_COLUMN]
    check_relations(
        (WAVELENGTH_COLUMN in columns, key, columns, f"a table with column {WAVELENGTH_COLUMN}"),
        (
            not any(name.startswith("Unnamed") for name in available), key,
            "a column without a name", "names for all",
            "a column of row numbers? write the table with index=False",
        ),
    )  # fmt: skip
    names = [check_choice("retrieve.samples", one, available) for one in section.samples]
    names = names or available
    wavelength = measured[WAVELENGTH_COLUMN].to_numpy(dtype=float)
    snapped = snap_to_limits(wavelength, wavelengths[0], wavelengths[-1])
    inside = (snapped >= wavelengths[0]) & (snapped <= wavelengths[-1])
    for low, high in section.exclude_nm:
        inside &= (wavelength < low) | (wavelength > high)
    given = f"{wavelength.min():g} to {wavelength.max():g} nm"
    allowed = f"{wavelengths[0]:g} to {wavelengths[-1]:g} nm, the range of the table"
    check_relations((inside.any(), key, given, allowed))
    key = "retrieve.prior_from"
    first_samples = [check_choice(f"{key}.sample", one.sample, names) for one in section.prior_from]
    others = [name for name in names if name not in first_samples]
    allowed = f"the beginning of the name of another sample: {', '.join(others)}"
    check_relations(
        (
            len(set(first_samples)) == len(first_samples), f"{key}.sample", first_samples,
            "different samples",
        ),
        (
            others, "retrieve.samples", names, "others than those of prior_from",
            "all samples are retrieved first",
        ),
        *(
            (any(name.startswith(start) for name in others), f"{key}.applies_to", start, allowed)
            for start in (one.applies_to for one in section.prior_from)
        ),
    )  # fmt: skip
    for parameter, values in section.reference_values.items():
        for sample in values:
            check_choice(f"retrieve.reference_values.{parameter}", sample, names)
    used = measured[inside]
    return {n: pd.Series(used[n].to_numpy(dtype=float), wavelength[inside]) for n in names}


def get_fixed_values(section: RetrieveSection, sample: str, table: Table) -> dict[str, float | str]:
    """Return the fixed values of a sample: `fixed`, and the angle in its name."""
    fixed = dict(section.fixed)
    if ANGLE_SEPARATOR not in sample:
        return fixed
    match = re.search(rf"{ANGLE_SEPARATOR}([0-9]+(\.[0-9]+)?)\Z", sample)
    angle = float(match[1]) if match else None
    if INCIDENCE not in table.axes:
        own = table.dataset.attrs.get(INCIDENCE, angle)
        allowed, hint = (
            f"of incidence {own}, the only one of the table",
            f"or give grid.{INCIDENCE}",
        )
        check_relations((angle in (None, own), "retrieve.samples", sample, allowed, hint))
        return fixed
    is_free, is_fixed = INCIDENCE in section.free, INCIDENCE in fixed
    check_relations(
        (
            angle is not None or is_fixed or is_free, "retrieve.samples", sample,
            f"an angle after {ANGLE_SEPARATOR}",
        ),
        (
            angle is None or not (is_free or fixed.get(INCIDENCE, angle) != angle),
            f"retrieve.fixed.{INCIDENCE}" if is_fixed else "retrieve.free",
            fixed.get(INCIDENCE, INCIDENCE), "left out",
            f"the name {format_key(sample)} contains the angle",
        ),
    )  # fmt: skip
    return fixed if angle is None else {**fixed, INCIDENCE: angle}


MeasuredReturn = tuple[tuple[np.ndarray, np.ndarray], Any]
"""Arguments `measured` and `noise` of `splits.retrieve_return` for a sample."""


def select_returns(
    section: RetrieveReturnSection, measured: pd.DataFrame, wavelengths: np.ndarray
) -> dict[str, MeasuredReturn]:
    """Return the samples of a file; reject other wavelengths than those of the table."""
    key = "retrieve_return.measured"
    edges = _read_bins(key, measured, wavelengths)
    errors = {name for name in measured if str(name).endswith(STDERR_SUFFIX)}
    available = [str(name) for name in measured if name not in {*BIN_COLUMNS, *errors}]
    allowed = f"a table with a column per sample besides {', '.join(BIN_COLUMNS)}"
    check_relations((available, key, list(measured), allowed))
    names = [check_choice("retrieve_return.samples", name, available) for name in section.samples]
    names = names or available
    check_relations(
        *(
            (
                section.photons is not None or name + STDERR_SUFFIX in measured, key,
                section.measured, f"with a column {name}{STDERR_SUFFIX}",
                "or give photons for counted photons",
            )
            for name in names
        )
    )  # fmt: skip
    for parameter, references in section.reference_values.items():
        for sample in references:
            check_choice(f"retrieve_return.reference_values.{parameter}", sample, names)
    shape = wavelengths.size, edges.size - 1
    values = {name: measured[name].to_numpy(dtype=float).reshape(shape) for name in names}
    if section.photons is not None:
        return {name: scale_counts(values[name], edges, section.photons) for name in names}
    stderr = {name: measured[name + STDERR_SUFFIX].to_numpy(dtype=float) for name in names}
    return {name: ((edges, values[name]), stderr[name].reshape(shape)) for name in names}


def scale_counts(counts: np.ndarray, edges: np.ndarray, photons: float) -> MeasuredReturn:
    """Return counted photons of a pulse as light per time."""
    return (edges, counts / (photons * np.diff(edges))), {"photons": photons}


def _read_bins(key: str, measured: Mapping[str, Any], wavelengths: np.ndarray) -> np.ndarray:
    """Return the delays between the bins of a file, which are the same at all wavelengths."""
    columns = list(measured)
    check_relations(
        *((name in columns, key, columns, f"a table with column {name}") for name in BIN_COLUMNS)
    )
    given, start, end = (np.asarray(measured[name], dtype=float) for name in BIN_COLUMNS)
    n_bins = given.size // wavelengths.size
    is_complete = given.size == n_bins * wavelengths.size
    check_relations(
        (
            is_complete and np.allclose(given, np.repeat(wavelengths, n_bins)),
            f"{key} ({WAVELENGTH_COLUMN})", np.unique(given).tolist(),
            f"as many bins at each wavelength of the table, {wavelengths.tolist()} nm",
            "all delays of the first wavelength, then those of the next",
        )
    )  # fmt: skip
    start, end = start.reshape(-1, n_bins), end.reshape(-1, n_bins)
    is_wide = end > start
    tolerance = DELAY_TOLERANCE * (end - start).min()
    edges = np.append(start[0], end[0, -1])
    distance = np.maximum(np.abs(start - edges[:-1]), np.abs(end - edges[1:])).max()
    check_relations(
        (
            is_wide.all(), f"{key} (delay_end_s)", next(iter(end[~is_wide].tolist()), None),
            "above its start", "delays are in seconds",
        ),
        (
            not distance > tolerance, f"{key} (delay_start_s)", "with gaps or overlaps",
            "bins that follow each other, the same at all wavelengths",
        ),
    )  # fmt: skip
    return edges


def make_true_medium(
    experiment: SimulationConfig, section: RetrieveReturnSection, sample: str
) -> tuple[Medium, float | str]:
    """Return a known medium and the incidence angle of its light, within the table."""
    assert section.synthetic is not None
    truth, key = dict(section.synthetic.truth[sample]), f"retrieve_return.synthetic.truth.{sample}"
    rows = experiment.make_axes()
    keywords = list(signature(MEDIUM_CLASSES[get_kind(experiment.medium)]).parameters)
    known = (*truth, SCALE)
    check_relations(
        *((one in known, f"{key}.{one}", None, "given", "it is free") for one in section.free)
    )
    for name, value in truth.items():
        if name not in rows and name.partition(".")[0] not in (*keywords, SCALE):
            raise unknown_key(f"{key}.{name}", dict.fromkeys([*rows, *keywords, SCALE]))
        check_on_grid(f"{key}.{name}", value, rows.get(name))
    check_range(f"{key}.{SCALE}", truth.pop(SCALE, 1.0), 0.0, math.inf, open_low=True)
    single = {name: row[0] for name, row in rows.items() if len(row) == 1}
    values = {**single, **section.fixed, **truth}
    incidence = values.pop(INCIDENCE, experiment.instrument.get_incidence())
    with key_prefix(key):
        return experiment.make_medium(**values), incidence


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
    synthetic, instrument, photons = section.synthetic, experiment.instrument, section.photons
    assert synthetic is not None and photons is not None
    seed = instrument.get_seed(seed) + synthetic.seed_offset
    edges = np.array(synthetic.delay_s)
    returns = {}
    for number, (sample, truth) in enumerate(synthetic.truth.items()):
        log(f"{sample}: simulating a return")
        medium, incidence = make_true_medium(experiment, section, sample)
        light = time_of_flight(
            medium, instrument.get_wavelengths(), incidence, rays=synthetic.rays, seed=seed,
            delay_s=edges, pulse=section.pulse, acceptance_deg=instrument.get("acceptance_deg"),
            footprint_radius_m=instrument.get("footprint_radius_m"), threads=threads,
        )  # fmt: skip
        (_, one_photon), _ = scale_counts(np.ones(edges.size - 1), edges, photons)
        rates = light.return_rate.sel(side="reflected").transpose("wavelength", "delay_s").values
        expected = truth.get(SCALE, 1.0) * rates / one_photon
        counts = np.random.default_rng([seed, number]).poisson(expected)
        returns[sample] = scale_counts(counts, edges, photons)
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
    for sample, (measured, noise) in returns.items():
        with key_prefix(f"retrieve_return ({sample})"):
            result = retrieve_return(
                measured, table, section.free, noise, pulse=section.pulse,
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
        returns = select_returns(section, measured, table.wavelength.values)
    retrievals = retrieve_samples(section, table, returns, seed, log)
    write_samples(retrievals, experiment.name, section.list_references(), [""], outputs)
