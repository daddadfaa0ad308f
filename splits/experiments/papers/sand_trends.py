"""Trends of sand in the SPLITS paper, and the sensitivity of results to data and interpretation."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.uncertainty import compute_band_error, compute_weighted_error, make_band_weights
from splits.experiments.papers.snow_trends import (
    compute_band_mean,
    compute_differences,
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
    rows = []
    for sample in samples.medium.values:
        part = samples.sel(medium=sample)
        means = np.array(
            [float(compute_band_mean(part, "reflectance", *b)) for b in RISING_BANDS_NM]
        )
        weights = [make_band_weights(part, *b) for b in RISING_BANDS_NM]
        errors = [
            float(compute_weighted_error(part, "reflectance", after - before))
            for before, after in itertools.pairwise(weights)
        ]
        bands = ", ".join(f"{low}-{high}" for low, high in RISING_BANDS_NM)
        statement = f"reflectance of {sample} rises over bands {bands} nm: smallest step"
        place = "section 2.1, Fig 6"
        rows.append(make_significance_row(statement, place, np.diff(means), errors))
    return rows


def _make_reddening_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the row on the increase of the ratio of red to green reflectance with hematite."""
    red, green = (
        compute_band_mean(dataset, "reflectance", *b) for b in (RED_BAND_NM, GREEN_BAND_NM)
    )
    slope = (
        make_band_weights(dataset, *RED_BAND_NM) / red
        - make_band_weights(dataset, *GREEN_BAND_NM) / green
    )
    ratio = (red / green).values
    error = ratio * compute_weighted_error(dataset, "reflectance", slope).values
    statement = "hematite for goethite shifts to the red: ratio of 620-700 to 480-560 nm"
    steps = compute_differences(ratio, error)
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
            low, high = part.wavelength.values[[0, -1]]
            means = [float(compute_band_error(p, "reflectance", low, high)) for p in (other, base)]
            rows.append(
                {
                    "medium": sample,
                    "varied": dimension,
                    "value": value,
                    "mean_shift": shift.mean(),
                    "mean_shift_stderr": np.hypot(means[0], means[1]),
                    "largest_shift": shift[worst],
                    "largest_shift_stderr": error[worst],
                    "at_wavelength_nm": float(part.wavelength[worst]),
                }
            )
    return pd.DataFrame(rows)


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
