"""Retrievals as experiments: every sample of a measured table, read in the experiment's table."""

from __future__ import annotations

from collections.abc import Callable

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
    for name, spectrum in spectra.items():
        with under(f"retrieve ({name})"):
            found[name] = retrieve(
                spectrum, table, section.free, section.noise.of(spectrum.to_numpy()),
                at=section.where(name, table.axes), prior=section.prior or None, seed=seed,
            )  # fmt: skip
        for line in repr(found[name]).splitlines():
            say(f"{name}: {line}")
    return found


def retrieved_table(found: dict[str, Retrieved]) -> pd.DataFrame:
    """Return a line for every parameter of every sample."""
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


def together(found: dict[str, Retrieved], experiment: str) -> xr.Dataset:
    """Return all samples as one dataset, which `splits.figures.retrievals` draws.

    Of samples that were measured at other wavelengths, those that all have.
    """
    sets = [one.dataset for one in found.values()]
    names = list(found)
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
