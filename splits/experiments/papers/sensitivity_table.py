"""Mean sensitivity indices of snow spectra for the published parameter ranges and others."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.sensitivity import SensitivityIndex, compute_spectral_sensitivity
from splits.core.uncertainty import make_variable
from splits.experiments.config.media import make_label
from splits.io.netcdf import make_provenance, select_points, to_netcdf_attributes

QUANTITY_CONDITIONS: dict[str, dict[str, Any]] = {
    "reflectance": {"depth_m": 0.12, "wavelength_nm": (400.0, 2500.0)},
    "transmittance": {"depth_m": 0.02, "wavelength_nm": (400.0, 1420.0)},
}
"""Depth and wavelengths for each quantity in SPLITSnow sections 5.2.2 and 5.4."""
COLUMNS = [
    "parameter", "quantity", "interpretation", "low", "high", "chosen", "msi", "msi_stderr",
    "msi_resolved", "resolved_fraction",
]  # fmt: skip

RANGE_UNITS = {"grain_size": " µm", "density": " kg m⁻³"}
"""Units of parameters in the sentence on their ranges."""


def compute_pair_sensitivity(
    dataset: xr.Dataset, parameter: str, low: Any, high: Any, quantity: str
) -> SensitivityIndex:
    """Return the mean sensitivity index of a quantity between two values of a parameter.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over `parameter`, ``depth_m`` and ``wavelength``.
    parameter, low, high
        Name of the grid's dimension and two of its labels.
    quantity : {"reflectance", "transmittance"}
    """
    conditions = QUANTITY_CONDITIONS[quantity]
    part = select_points(dataset, {"depth_m": conditions["depth_m"]}).sel(
        wavelength=slice(*conditions["wavelength_nm"])
    )
    y, z = (select_points(part, {parameter: label}) for label in (low, high))
    return compute_spectral_sensitivity(y, z, quantity)


def make_sensitivity_table(
    datasets: Mapping[str, xr.Dataset], pairs: Mapping[str, Mapping[str, Any]]
) -> pd.DataFrame:
    """Return the index for every parameter, quantity, range and interpretation.

    Parameters
    ----------
    datasets : mapping
        Experiments by name.
    pairs : mapping
        For each parameter ``experiment``, ``interpretation_experiment`` (or None),
        ``parameter`` (grid dimension), ``low`` and ``high``.

    Returns
    -------
    pandas.DataFrame
        With `COLUMNS`.
    """
    rows = []
    for name, pair in pairs.items():
        dimension, ranges = pair["parameter"], datasets[pair["experiment"]]
        ends = [pair["low"], pair["high"]]
        for quantity in QUANTITY_CONDITIONS:
            for labels in itertools.combinations(ranges[dimension].values, 2):
                index = compute_pair_sensitivity(ranges, dimension, *labels, quantity)
                chosen = all(any(_is_same_label(label, end) for label in labels) for end in ends)
                rows.append((name, quantity, "default", *labels, chosen, *astuple(index)))
            if not pair["interpretation_experiment"]:
                continue
            interpretations = datasets[pair["interpretation_experiment"]]
            low, high = (
                next(x for x in interpretations[dimension].values if _is_same_label(x, end))
                for end in ends
            )
            # The experiment over ranges has the default interpretation.
            for label in map(str, interpretations.interpretation.values):
                if label != "default":
                    part = select_points(interpretations, {"interpretation": label})
                    index = compute_pair_sensitivity(part, dimension, low, high, quantity)
                    rows.append((name, quantity, label, low, high, False, *astuple(index)))
    return pd.DataFrame(rows, columns=COLUMNS)


def list_published_names(pair: str) -> list[str]:
    """Return the ids of the published indices of a pair, one for each quantity."""
    return [f"msi_{quantity[0]}_{pair}" for quantity in QUANTITY_CONDITIONS]


def select_chosen_sensitivities(
    table: pd.DataFrame, published: pd.DataFrame | None = None
) -> xr.Dataset:
    """Return the indices of the chosen pairs over quantity and parameter, and published ones.

    Parameters
    ----------
    table : pandas.DataFrame
        See `make_sensitivity_table`.
    published : pandas.DataFrame, optional
        See `splits.analysis.measured.read_published`, with a row for each index.
    """
    chosen = table[table.chosen].drop_duplicates(["quantity", "parameter"])
    parameters = list(chosen.parameter.unique())
    grid = chosen.set_index(["quantity", "parameter"])[["msi", "msi_stderr"]].unstack()
    index, error = (
        grid[name].loc[list(QUANTITY_CONDITIONS), parameters].to_numpy()
        for name in ("msi", "msi_stderr")
    )
    dims, label = ("quantity", "parameter"), "mean sensitivity index"
    variables = make_variable("msi", dims, index, error, label)
    if published is not None:
        values = [
            list(column)
            for column in zip(
                *(published.published[list_published_names(name)] for name in parameters),
                strict=True,
            )
        ]
        long_name = f"{label} published in SPLITSnow Table 2"
        variables |= make_variable("published", dims, np.array(values), None, long_name)
    return xr.Dataset(
        variables,
        {
            "quantity": ("quantity", list(QUANTITY_CONDITIONS), {"long_name": "quantity"}),
            "parameter": ("parameter", parameters, {"long_name": "parameter of the snow"}),
        },
        to_netcdf_attributes(
            {"title": "Mean sensitivity index of snow", **make_provenance("sensitivity")}
        ),
    )


def describe_ranges(pairs: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a sentence on the range of each parameter and its origin.

    Parameters
    ----------
    pairs : mapping
        For each parameter ``low``, ``high`` and ``source``, ``"paper"`` or ``"ours"``.
    """
    parts = []
    for origin, text in (("paper", "stated by the paper"), ("ours", "chosen here, not stated")):
        ranges = [
            f"{name.replace('_', ' ')} {_format_end(pair['low'])} to {_format_end(pair['high'])}"
            f"{RANGE_UNITS.get(name, '')}"
            for name, pair in pairs.items()
            if pair["source"] == origin
        ]
        parts += [f"{text}: {', '.join(ranges)}"] if ranges else []
    return f"Ranges {'; '.join(parts)}."


def _format_end(value: Any) -> str:
    """Return an end of a range, a number or a range of grain sizes, as text."""
    return f"{value:g}" if isinstance(value, int | float) else str(value).replace("-", "–")


def _is_same_label(value: Any, label: Any) -> bool:
    if isinstance(value, (int, float, np.number)):
        return bool(np.isclose(float(value), float(label)))
    return str(value) == make_label("", label)
