"""Retrievals as experiments: every sample of a measured table, read in the experiment's table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.checks import under
from splits.dataset import attributes, provenance
from splits.experiments.retrieve_section import RetrieveSection
from splits.lookup.reading import Table
from splits.names import parameter_about
from splits.retrieval.result import Retrieved
from splits.retrieval.retrieve import retrieve

Say = Callable[[str], None]


def run_retrieve(
    section: RetrieveSection,
    table: Table,
    measured: pd.DataFrame,
    seed: int = 1,
    say: Say = lambda line: None,
) -> dict[str, Retrieved]:
    """Return what every sample tells, by its name.

    Raises
    ------
    ValueError
        Names the section's key.
    """
    found = {}
    with under("retrieve"):
        spectra = section.spectra(measured, table.dataset.wavelength.values)
    prior, first = dict(section.prior), section.prior_from
    if first is not None:
        found[first.sample] = _one(section, table, spectra, first.sample, prior, seed, first.at)
        told = found[first.sample]
        prior |= {n: (value, told.stderr[n]) for n, value in told.values.items()}
    for name in spectra:
        if name not in found:
            found[name] = _one(section, table, spectra, name, prior, seed, {})
        for line in repr(found[name]).splitlines():
            say(f"{name}: {line}")
    return found


def _one(
    section: RetrieveSection,
    table: Table,
    spectra: Mapping[str, pd.Series],
    name: str,
    prior: Mapping[str, Any],
    seed: int,
    known: Mapping[str, Any],
) -> Retrieved:
    """Return what one sample tells, of which some of what is free elsewhere may be known."""
    free: Any = section.free
    if isinstance(free, Mapping):
        free = {n: pair for n, pair in free.items() if n not in known}
    else:
        free = [n for n in free if n not in known]
    spectrum = spectra[name]
    with under(f"retrieve ({name})"):
        return retrieve(
            spectrum, table, free, section.noise.of(spectrum.to_numpy()),
            at={**section.where(name, table.axes), **known},
            prior={n: pair for n, pair in prior.items() if n in free} or None, seed=seed,
        )  # fmt: skip


def retrieved_table(
    found: Mapping[str, Retrieved], known: Mapping[str, Mapping[str, float]]
) -> pd.DataFrame:
    """Return a line for every parameter of every sample; `known` has values found otherwise."""
    rows = []
    for sample, one in found.items():
        ds = one.dataset
        for name in map(str, ds.parameter.values):
            own = ds.sel(parameter=name)
            long_name, _ = parameter_about(name)
            low, below, middle, above, high = own.quantiles.values
            rows.append(
                {
                    "sample": sample,
                    "parameter": name,
                    "in words": long_name,
                    "unit": str(own.parameter_unit.item()),
                    "median": middle,
                    "standard deviation": float(own.value_stderr),
                    "known": known.get(name, {}).get(sample, np.nan),
                    "16 %": below,
                    "84 %": above,
                    "2.5 %": low,
                    "97.5 %": high,
                    "told by the spectrum": "yes" if own.determined else "no",
                    "averaging kernel": float(own.averaging_kernel.sel(other_parameter=name)),
                    "chi2": ds.attrs["chi2"],
                    "chi2 expected": ds.attrs["chi2_expected"],
                    "errors enlarged by": ds.attrs["errors_enlarged_by"],
                    "to be known": ds.attrs["warnings"],
                }
            )
    return pd.DataFrame(rows)


def together(found: Mapping[str, Retrieved], experiment: str) -> xr.Dataset:
    """Return all samples as one dataset, which `splits.figures.retrievals` draws.

    Of samples that were measured at other wavelengths, those that all have.
    """
    # Of one that came first, with some of the others' parameters known, fewer were free.
    most = max(one.dataset.sizes["parameter"] for one in found.values())
    full = {n: one for n, one in found.items() if one.dataset.sizes["parameter"] == most}
    sets, names = [one.dataset for one in full.values()], list(full)
    joined = xr.concat(sets, xr.IndexVariable("sample", names), join="inner", combine_attrs="drop")
    for key in ("chi2", "chi2_expected", "errors_enlarged_by", "degrees_of_freedom"):
        row = np.array([one.attrs[key] for one in sets])
        joined[key] = ("sample", row, {"long_name": key.replace("_", " "), "units": "1"})
    facts = {
        "title": f"Retrievals of {experiment}",
        "experiment": experiment,
        **provenance(f"retrievals of {experiment}"),
    }
    return joined.assign_attrs(attributes(facts))
