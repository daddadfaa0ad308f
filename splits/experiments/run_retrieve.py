"""Execution of retrievals: every sample of a measured table, with the experiment's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.measured import read_spectra
from splits.core.parameter_names import describe_parameter
from splits.core.progress import LogCallback
from splits.core.validation import key_prefix
from splits.experiments.config.retrieve import RetrieveSection
from splits.io.data_frame import write_data_frame
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.result import RetrievalResult
from splits.retrieval.retrieve import retrieve
from splits.retrieval.state_vector import SCALE
from splits.tables.table import Table, open_table

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
    with key_prefix("retrieve"):
        spectra = section.select_spectra(measured, table.dataset.wavelength.values)
    n_used, n_all = len(next(iter(spectra.values()))), len(measured)
    if n_used < n_all:
        log(f"{n_all - n_used} of {n_all} wavelengths are excluded or outside the table")
    axis, law = section.model_axis, section.compare_with
    single_model = OWN_MODEL if law else SINGLE_MODEL
    names = [str(v) for v in table.dataset[axis].values] if axis else [single_model]
    retrievals = []
    for model in names:
        fixed = {axis: model} if axis else {}
        retrievals += _RetrievalTask(section, table, spectra, model, fixed, seed).retrieve_all(log)
    if law:
        # Imports snowoptics, which no other part of a retrieval needs.
        from splits.analysis.theory.kokhanovsky_zege import make_law_table

        law_table = make_law_table(table, law, axis)
        retrievals += _RetrievalTask(section, law_table, spectra, law, {}, seed).retrieve_all(log)
    return retrievals


class _RetrievalTask(NamedTuple):
    """Retrieval of spectra with one model: a table at fixed nodes."""

    section: RetrieveSection
    table: Table
    spectra: Mapping[str, pd.Series]
    model: str
    fixed: Mapping[str, Any]
    seed: int

    def retrieve_all(self, log: LogCallback) -> list[SampleRetrieval]:
        """Return and log the retrievals of all samples."""
        sources = {source.sample: source for source in self.section.prior_from}
        prior_results = {
            sample: self._retrieve(sample, self.section.prior, source.fixed)
            for sample, source in sources.items()
        }
        retrievals = []
        for name in self.spectra:
            is_first = name in sources
            prior = self._make_prior(prior_results, name)
            result = prior_results[name] if is_first else self._retrieve(name, prior, {})
            chi2 = np.nan if is_first else self._compute_reference_chi2(name, prior)
            retrievals.append(SampleRetrieval(self.model, name, result, chi2, is_first))
            label = f"{name} ({self.model})" if self.model else name
            for line in repr(result).splitlines():
                log(f"{label}: {line}")
        return retrievals

    def _retrieve(
        self, name: str, prior: Mapping[str, Any], fixed: Mapping[str, Any]
    ) -> RetrievalResult:
        """Return the retrieval of one sample with some parameters fixed."""
        axes = self.table.axes
        names = [n for n in self.section.free if n not in fixed and n in (*axes, SCALE)]
        free_section: Any = self.section.free
        free = {n: free_section[n] for n in names} if isinstance(free_section, Mapping) else names
        spectrum = self.spectra[name]
        fixed_values = {**self.section.get_fixed_values(name, axes), **self.fixed, **fixed}
        with key_prefix(f"retrieve ({name})"):
            return retrieve(
                spectrum, self.table, free, self.section.compute_noise(spectrum.to_numpy()),
                fixed={n: value for n, value in fixed_values.items() if n in (*axes, SCALE)},
                prior={n: pair for n, pair in prior.items() if n in free} or None, seed=self.seed,
                quantity=self.section.quantity,
            )  # fmt: skip

    def _compute_reference_chi2(self, name: str, prior: Mapping[str, Any]) -> float:
        """Return χ² with the known parameters fixed at their reference values."""
        by_parameter = self.section.reference_values.items()
        references = {key: values[name] for key, values in by_parameter if name in values}
        others = {*self.section.free} - {*references, SCALE}
        if not references or not others or SCALE in references or self.section.noise is None:
            return np.nan
        return float(self._retrieve(name, prior, references).dataset.attrs["chi2"])

    def _make_prior(self, first: Mapping[str, RetrievalResult], name: str) -> dict[str, Any]:
        """Return the prior of a sample, including posteriors of samples retrieved first."""
        prior: dict[str, Any] = dict(self.section.prior)
        for source in self.section.prior_from:
            if name.startswith(source.applies_to):
                result = first[source.sample]
                prior |= {key: (value, result.stderr[key]) for key, value in result.values.items()}
        return prior


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
            row = {
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
                "averaging kernel": float(part.averaging_kernel.sel(other_parameter=name)),
                "chi2": ds.attrs["chi2"],
                "chi2 at reference": retrieval.reference_chi2,
                "chi2 expected": ds.attrs["chi2_expected"],
                "error inflation": ds.attrs["error_inflation"],
                "warnings": ds.attrs["warnings"],
            }
            rows.append(row)
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
    results = run_retrieve(section, open_table(table), spectra, seed, log)
    name, prefixes = Path(table).stem, section.list_sample_prefixes()
    write_samples(results, name, section.reference_values, prefixes, outputs)


def write_samples(
    results: list[SampleRetrieval],
    experiment: str,
    references: Mapping[str, Mapping[str, float]],
    prefixes: Sequence[str],
    outputs: tuple[str | Path, str | Path],
) -> None:
    """Write the retrievals of all samples as a table and as a figure; see `write_retrieval`."""
    from splits.plotting.retrieval import draw_retrievals
    from splits.plotting.style import save_figure

    write_data_frame(make_retrieval_table(results, references), outputs[0])
    figure = draw_retrievals(combine_samples(results, experiment), references, prefixes)
    save_figure(figure, Path(outputs[1]).with_suffix(""))
