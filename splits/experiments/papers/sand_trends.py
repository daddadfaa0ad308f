"""Trends of sand in the SPLITS paper, and the sensitivity of results to data and interpretation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.uncertainty import compute_weighted_error, make_band_weights
from splits.experiments.papers.estimate import Estimate
from splits.experiments.papers.snow_trends import (
    compute_band_mean,
    estimate_band,
    make_monotone_row,
    make_significance_row,
)

RISING_BANDS_NM = ((400, 500), (500, 600), (600, 700), (700, 1000))
MAX_GOOD_RMSE = 0.03
"""Root-mean-square error below which SPLITS section 5.1.1 calls a reconstruction good."""
UNDETERMINED_VERDICT = "undetermined: the error exceeds half of the error from the range alone"
RED_BAND_NM, GREEN_BAND_NM = (620, 700), (480, 560)


def make_sand_trend_table(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Parameters
    ----------
    datasets : mapping
        By name, see `splits.experiments.studies.sand_tables.SandTablesStudy`.

    Returns
    -------
    pandas.DataFrame
        Columns id, quantity, place, ours, stderr, bar, verdict.
    """
    rows = [
        *_make_rise_rows(datasets["samples"]),
        make_monotone_row(datasets["iron_oxide"], "reflectance", "iron_oxide", -1, (400, 1000),
                 "reflectance falls with hematite and goethite, 400-1000 nm", "Fig 8"),
        _make_reddening_row(datasets["hematite_ratio"]),
        make_monotone_row(datasets["magnetite"], "reflectance", "magnetite", -1, (400, 1000),
                 "reflectance falls with magnetite, 400-1000 nm", "Fig 8"),
        make_monotone_row(datasets["texture"], "reflectance", "texture", +1, (400, 1000),
                 "reflectance rises with silt for sand: smaller particles are brighter", "Fig 8"),
        make_monotone_row(datasets["wet_colours"], "reflectance", "saturation", -1, (400, 780),
                 "all four samples darken with saturation, 400-780 nm", "Figs 7, 10"),
        make_monotone_row(datasets["fine_fraction"], "reflectance", "texture", +1, (400, 500),
                 "reflectance rises with clay for silt, 400-500 nm", "section 5.2"),
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _make_rise_rows(samples: xr.Dataset) -> list[dict[str, object]]:
    means = [compute_band_mean(samples, "reflectance", *band) for band in RISING_BANDS_NM]
    weights = [make_band_weights(samples, *band) for band in RISING_BANDS_NM]
    step, weight = (xr.concat(parts, "band").diff("band") for parts in (means, weights))
    steps = Estimate(step, compute_weighted_error(samples, "reflectance", weight))
    bands = ", ".join(f"{low}-{high}" for low, high in RISING_BANDS_NM)
    return [
        make_significance_row(
            f"reflectance of {sample} rises over bands {bands} nm: smallest step",
            "section 2.1, Fig 6", *steps.sel(medium=sample),
        )
        for sample in samples.medium.values
    ]  # fmt: skip


def _make_reddening_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the row on the increase of the ratio of red to green reflectance with hematite."""
    red, green = (
        compute_band_mean(dataset, "reflectance", *b) for b in (RED_BAND_NM, GREEN_BAND_NM)
    )
    slope = (
        make_band_weights(dataset, *RED_BAND_NM) / red
        - make_band_weights(dataset, *GREEN_BAND_NM) / green
    )
    ratio = red / green
    error = ratio * compute_weighted_error(dataset, "reflectance", slope)
    statement = "hematite for goethite shifts to the red: ratio of 620-700 to 480-560 nm"
    steps = Estimate(ratio, error).diff("hematite_ratio")
    return make_significance_row(f"{statement}, smallest step", "Fig 8", *steps)


def make_shift_table(dataset: xr.Dataset, dimension: str, reference: str | float) -> pd.DataFrame:
    """Return the shifts of reflectance from a reference along one dimension of a grid.

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
        Per medium and value the mean shift and the largest absolute shift with their errors, and
        the wavelength of the latter.
    """
    low, high = dataset.wavelength.values[[0, -1]]
    spectrum, mean = (
        estimate - estimate.sel(**{dimension: reference})
        for estimate in (
            Estimate.from_dataset(dataset, "reflectance"),
            estimate_band(dataset, "reflectance", low, high),
        )
    )
    worst = spectrum.isel(wavelength=abs(spectrum.value).argmax("wavelength"))
    columns = {
        "varied": dimension, "value": worst.value[dimension], "mean_shift": mean.value,
        "mean_shift_stderr": mean.stderr, "largest_shift": worst.value,
        "largest_shift_stderr": worst.stderr, "at_wavelength_nm": worst.value.wavelength,
    }  # fmt: skip
    grid = xr.Dataset(columns).reset_coords(drop=True)
    table = grid.to_dataframe(["medium", dimension])[list(columns)].reset_index("medium")
    return table[table.value != reference].reset_index(drop=True)


def make_fit_table(dataset: xr.Dataset) -> pd.DataFrame:
    """Return a row per sample, point of the grid and parameter, with two verdicts.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.experiments.run_fit.run_fit`.

    Returns
    -------
    pandas.DataFrame
        The labels, value, value_stderr; ``verdict``, whether the parameter is constrained;
        ``spectrum``, whether the fit reproduces it; rmse, rmse_stderr.
    """
    names = ["value", "value_stderr", "constrained", "rmse", "rmse_stderr"]
    table = dataset[names].to_dataframe().reset_index()
    verdict = np.where(table.pop("constrained") > 0.5, "constrained", UNDETERMINED_VERDICT)
    table.insert(table.columns.get_loc("rmse"), "verdict", verdict)
    spectrum = np.where(table.rmse < MAX_GOOD_RMSE, "reproduced", "not reproduced")
    table.insert(table.columns.get_loc("rmse"), "spectrum", spectrum)
    return table
