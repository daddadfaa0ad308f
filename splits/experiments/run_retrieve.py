"""Retrievals as experiments: every sample of a measured table, read in the experiment's table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.parameter_names import describe_parameter
from splits.core.validation import key_prefix
from splits.experiments.config.retrieve import RetrieveSection
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.result import RetrievalResult
from splits.retrieval.retrieve import retrieve
from splits.retrieval.state_vector import SCALE
from splits.tables.table import Table

LogCallback = Callable[[str], None]
SINGLE_MODEL, OWN_MODEL = "", "splits"
"""Names of the model where there is but one, and beside a law."""


class SampleRetrieval(NamedTuple):
    """What a sample tells, read with one model.

    Attributes
    ----------
    model, sample : str
    result : RetrievalResult
    reference_chi2 : float
        χ² that is left where what is known of the sample otherwise is so, NaN where nothing is.
        Compared between models it says which knows better how light changes with that.
    is_prior_sample : bool
        It was retrieved first, with some of the others' parameters known.
    """

    model: str
    sample: str
    result: RetrievalResult
    reference_chi2: float
    is_prior_sample: bool


def run_retrieve(
    section: RetrieveSection,
    table: Table,
    measured: pd.DataFrame,
    seed: int = 1,
    log: LogCallback = lambda line: None,
) -> list[SampleRetrieval]:
    """Return what every sample tells, with every model.

    Raises
    ------
    ValueError
        Names the section's key.
    """
    with key_prefix("retrieve"):
        spectra = section.select_spectra(measured, table.dataset.wavelength.values)
    used, every = len(next(iter(spectra.values()))), len(measured)
    if used < every:
        log(f"{every - used} of {every} wavelengths are left out, or lie outside of the table")
    axis, law = section.model_axis, section.compare_with
    alone = OWN_MODEL if law else SINGLE_MODEL
    names = [str(v) for v in table.dataset[axis].values] if axis else [alone]
    found = []
    for model in names:
        at = {axis: model} if axis else {}
        found += _RetrievalTask(section, table, spectra, model, at, seed).retrieve_all(log)
    if law:
        # A package that nothing else of retrievals needs.
        from splits.analysis.theory.kokhanovsky_zege import make_law_table

        theirs = make_law_table(table, law, axis)
        found += _RetrievalTask(section, theirs, spectra, law, {}, seed).retrieve_all(log)
    return found


class _RetrievalTask(NamedTuple):
    """Spectra to be read in a table with one model, at the nodes that say so."""

    section: RetrieveSection
    table: Table
    spectra: Mapping[str, pd.Series]
    model: str
    fixed: Mapping[str, Any]
    seed: int

    def retrieve_all(self, log: LogCallback) -> list[SampleRetrieval]:
        """Return what all samples tell, and say it."""
        firsts = {one.sample: one for one in self.section.prior_from}
        early = {n: self._retrieve(n, self.section.prior, one.fixed) for n, one in firsts.items()}
        found = []
        for name in self.spectra:
            prior = self._make_prior(early, name)
            told = early[name] if name in early else self._retrieve(name, prior, {})
            misfit = np.nan if name in early else self._compute_reference_chi2(name, prior)
            found.append(SampleRetrieval(self.model, name, told, misfit, name in early))
            mark = f"{name} ({self.model})" if self.model else name
            for line in repr(told).splitlines():
                log(f"{mark}: {line}")
        return found

    def _retrieve(
        self, name: str, prior: Mapping[str, Any], fixed: Mapping[str, Any]
    ) -> RetrievalResult:
        """Return what one sample tells, of which some of what is free elsewhere may be known."""
        axes = self.table.axes
        names = [n for n in self.section.free if n not in fixed and n in (*axes, SCALE)]
        given: Any = self.section.free
        free = {n: given[n] for n in names} if isinstance(given, Mapping) else names
        spectrum = self.spectra[name]
        at = {**self.section.get_fixed_values(name, axes), **self.fixed, **fixed}
        with key_prefix(f"retrieve ({name})"):
            return retrieve(
                spectrum, self.table, free, self.section.compute_noise(spectrum.to_numpy()),
                fixed={n: value for n, value in at.items() if n in (*axes, SCALE)},
                prior={n: pair for n, pair in prior.items() if n in free} or None, seed=self.seed,
            )  # fmt: skip

    def _compute_reference_chi2(self, name: str, prior: Mapping[str, Any]) -> float:
        """Return the misfit left where what is known of a sample is so."""
        known = {
            n: values[name] for n, values in self.section.reference_values.items() if name in values
        }
        others = [n for n in self.section.free if n not in known and n != SCALE]
        if not known or not others or SCALE in known or self.section.noise is None:
            return np.nan
        return float(self._retrieve(name, prior, known).dataset.attrs["chi2"])

    def _make_prior(
        self, prior_results: Mapping[str, RetrievalResult], name: str
    ) -> dict[str, Any]:
        """Return what is known of a sample before, from those retrieved first, too."""
        prior: dict[str, Any] = dict(self.section.prior)
        for first in self.section.prior_from:
            if name.startswith(first.applies_to):
                told = prior_results[first.sample]
                prior |= {n: (value, told.stderr[n]) for n, value in told.values.items()}
        return prior


def make_retrieval_table(
    retrievals: list[SampleRetrieval], reference: Mapping[str, Mapping[str, float]]
) -> pd.DataFrame:
    """Return a line for every parameter of every sample; `reference` has values found otherwise."""
    rows = []
    for one in retrievals:
        ds = one.result.dataset
        for name in map(str, ds.parameter.values):
            own = ds.sel(parameter=name)
            long_name, _ = describe_parameter(name)
            low, below, middle, above, high = own.quantiles.values
            rows.append(
                ({"model": one.model} if one.model else {})
                | {
                    "sample": one.sample,
                    "parameter": name,
                    "description": long_name,
                    "unit": str(own.parameter_unit.item()),
                    "median": middle,
                    "standard deviation": float(own.value_stderr),
                    "reference value": reference.get(name, {}).get(one.sample, np.nan),
                    "16 %": below,
                    "84 %": above,
                    "2.5 %": low,
                    "97.5 %": high,
                    "constrained": "yes" if own.constrained else "no",
                    "averaging kernel": float(own.averaging_kernel.sel(other_parameter=name)),
                    "chi2": ds.attrs["chi2"],
                    "chi2 at reference": one.reference_chi2,
                    "chi2 expected": ds.attrs["chi2_expected"],
                    "error inflation": ds.attrs["error_inflation"],
                    "warnings": ds.attrs["warnings"],
                }
            )
    return pd.DataFrame(rows)


def combine_samples(retrievals: list[SampleRetrieval], experiment: str) -> xr.Dataset:
    """Return all samples as one dataset, which `splits.plotting.retrieval` draws.

    Over models and samples.  Of samples that were measured at other wavelengths, those that all
    have; without those that were retrieved first.
    """
    full = [one for one in retrievals if not one.is_prior_sample]
    models = list(dict.fromkeys(one.model for one in full))
    joined = xr.concat(
        [_combine_model([one for one in full if one.model == model]) for model in models],
        xr.IndexVariable("model", models), join="outer", combine_attrs="drop",
    )  # fmt: skip
    # In the order of the first model, which knows of all parameters.
    order = full[0].result.dataset.parameter.values
    joined = joined.sel(parameter=order, other_parameter=order)
    facts = {
        "title": f"Retrievals of {experiment}",
        "experiment": experiment,
        **make_provenance(f"retrievals of {experiment}"),
    }
    return joined.assign_attrs(to_netcdf_attributes(facts))


def _combine_model(retrievals: list[SampleRetrieval]) -> xr.Dataset:
    """Return the samples of one model as one dataset."""
    sets, names = [one.result.dataset for one in retrievals], [one.sample for one in retrievals]
    joined = xr.concat(sets, xr.IndexVariable("sample", names), join="inner", combine_attrs="drop")
    for key in ("chi2", "chi2_expected", "error_inflation", "degrees_of_freedom"):
        row = np.array([one.attrs[key] for one in sets])
        joined[key] = ("sample", row, {"long_name": key.replace("_", " "), "units": "1"})
    misfits = np.array([one.reference_chi2 for one in retrievals])
    about = {"long_name": "chi2 where what is known is so", "units": "1"}
    return joined.assign(chi2_at_reference=("sample", misfits, about))
