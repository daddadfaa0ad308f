"""Trends that SPLITS states for sand, and how far its results hang on data and readings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.trends import band_mean, beyond, monotone

RISING_NM = ((400, 500), (500, 600), (600, 700), (700, 1000))
GOOD_RMSE = 0.03
"""SPLITS section 5.1.1 calls a reconstruction good below this root mean square error."""
RED_NM, GREEN_NM = (620, 700), (480, 560)


def sand_trends(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Parameters
    ----------
    datasets : mapping
        By role, see `splits.analysis.roles.SAND`.

    Returns
    -------
    pandas.DataFrame
        Columns id, quantity, place, ours, stderr, bar, verdict.
    """
    rows = [
        *_rises(datasets["samples"]),
        monotone(datasets, "iron_oxide", "reflectance", "iron_oxide", -1, 400, 1000,
                 "reflectance falls with hematite and goethite, 400-1000 nm", "Fig 8"),
        _redder(datasets["hematite_ratio"]),
        monotone(datasets, "magnetite", "reflectance", "magnetite", -1, 400, 1000,
                 "reflectance falls with magnetite, 400-1000 nm", "Fig 8"),
        monotone(datasets, "texture", "reflectance", "texture", +1, 400, 1000,
                 "reflectance rises with silt for sand: smaller particles are brighter", "Fig 8"),
        monotone(datasets, "wet_colours", "reflectance", "saturation", -1, 400, 780,
                 "all four samples darken with saturation, 400-780 nm", "Figs 7, 10"),
        monotone(datasets, "fine_fraction", "reflectance", "texture", +1, 400, 500,
                 "reflectance rises with clay for silt, 400-500 nm", "section 5.2"),
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _rises(samples: xr.Dataset) -> list[dict[str, object]]:
    rows = []
    for sample in samples.medium.values:
        part = samples.sel(medium=sample)
        means = np.array([float(band_mean(part, "reflectance", *b)) for b in RISING_NM])
        errors = np.array([float(band_mean(part, "reflectance_stderr", *b)) for b in RISING_NM])
        rows.append(
            beyond(
                f"reflectance of {sample} rises over bands "
                + ", ".join(f"{low}-{high}" for low, high in RISING_NM)
                + " nm: smallest step",
                "section 2.1, Fig 6",
                np.diff(means),
                np.hypot(errors[1:], errors[:-1]),
            )
        )
    return rows


def _redder(dataset: xr.Dataset) -> dict[str, object]:
    """Return how the ratio of red to green reflectance grows with hematite."""
    red, green = (band_mean(dataset, "reflectance", *b).values for b in (RED_NM, GREEN_NM))
    errors = [band_mean(dataset, "reflectance_stderr", *b).values for b in (RED_NM, GREEN_NM)]
    ratio = red / green
    error = ratio * np.hypot(errors[0] / red, errors[1] / green)
    return beyond(
        "hematite for goethite shifts to the red: ratio of 620-700 to 480-560 nm, smallest step",
        "Fig 8",
        np.diff(ratio),
        np.hypot(error[1:], error[:-1]),
    )


def shifts(dataset: xr.Dataset, dimension: str, reference: str | float) -> pd.DataFrame:
    """Return how far reflectance moves from a reference along one dimension of a grid.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over ``medium``, `dimension` and wavelength.
    dimension : str
    reference : str or float
        Value of `dimension` to compare with.

    Returns
    -------
    pandas.DataFrame
        Per medium and value the mean shift with its error, and the largest shift either way with
        its wavelength and error.
    """
    rows: list[dict[str, object]] = []
    for sample in dataset.medium.values:
        part = dataset.sel(medium=sample)
        base = part.sel({dimension: reference})
        for value in part[dimension].values:
            if value == reference:
                continue
            other = part.sel({dimension: value})
            shift = (other.reflectance - base.reflectance).values
            error = np.hypot(other.reflectance_stderr, base.reflectance_stderr).values
            worst = int(np.abs(shift).argmax())
            rows.append(
                {
                    "medium": sample,
                    "varied": dimension,
                    "value": value,
                    "mean_shift": shift.mean(),
                    "mean_shift_stderr": error.mean(),
                    "largest_shift": shift[worst],
                    "largest_shift_stderr": error[worst],
                    "at_wavelength_nm": float(part.wavelength[worst]),
                }
            )
    return pd.DataFrame(rows)


def fitted_parameters(dataset: xr.Dataset) -> pd.DataFrame:
    """Return a row per sample, point of the grid and parameter: value, error, determined or not.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.experiments.run_fit.run_fit` returns it.
    """
    names = ["value", "value_stderr", "determined", "rmse", "rmse_stderr"]
    table = dataset[names].to_dataframe().reset_index()
    table["determined"] = np.where(table.determined > 0.5, "yes", "no")
    table["verdict"] = np.where(table.rmse < GOOD_RMSE, "good", "not good")
    return table
