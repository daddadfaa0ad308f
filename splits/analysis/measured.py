"""Comparison with measured spectra: readers of tables, root-mean-square error, error per band."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.uncertainty import compute_weighted_error
from splits.core.validation import key_prefix
from splits.materials.csv_table import read_csv, read_numeric_csv
from splits.simulation.run_options import check_wavelengths

DIFFUSE_FRACTION = 0.85
"""Fraction of diffuse light in the measurements of Letcher et al. (2022)."""

LETCHER_COLUMNS = {0.34: "albedo_340mm", 0.045: "albedo_45mm_black"}
"""Measured column for each depth (m) of the experiment."""


WAVELENGTH_COLUMN = "wavelength_nm"


def read_measured(path: str | Path, key: str = "measured") -> pd.DataFrame:
    """Read a table of measured values; errors name the key."""
    return read_numeric_csv(key, path)


def read_published(path: str | Path, key: str = "published") -> pd.DataFrame:
    """Read the table of published numbers, indexed by id; errors name the key.

    The column ``resolution`` is one unit of the last printed digit.
    """
    table = read_csv(key, path, ["published", "low", "high"])
    columns: dict[str, Any] = {name: table.get_texts(name) for name in ("quantity", "place", "bar")}
    columns["bar"] = [bar or None for bar in columns["bar"]]
    columns |= {
        name: table.get_numbers(name, allow_gaps=True) for name in ("published", "low", "high")
    }
    columns["resolution"] = [
        10.0 ** int(Decimal(text).as_tuple().exponent) if np.isfinite(number) else np.nan
        for text, number in zip(table.get_texts("published"), columns["published"], strict=True)
    ]
    return pd.DataFrame(columns, index=pd.Index(table.get_texts("id"), name="id"))


def read_spectra(path: str | Path, key: str = "measured") -> pd.DataFrame:
    """Read a table of measured spectra: wavelengths, and a column for each spectrum.

    Parameters
    ----------
    path : path
        A CSV file with a column ``wavelength_nm``, strictly increasing.
    key : str
        Name of the setting, for messages.

    Returns
    -------
    pandas.DataFrame
        Numbers, NaN for empty cells.

    Raises
    ------
    ValueError
        For a file that is no table of spectra.
    """
    table = read_numeric_csv(key, path, [WAVELENGTH_COLUMN])
    with key_prefix(key):
        check_wavelengths(table[WAVELENGTH_COLUMN])
    return table


def compute_rmse(
    difference: np.ndarray, stderr: np.ndarray, compute_stderr: Callable[[np.ndarray], float]
) -> tuple[float, float]:
    """Return the root mean square of differences and its standard error.

    Parameters
    ----------
    difference, stderr : float, shape (wavelengths,)
        Differences and their standard errors.
    compute_stderr : callable
        From weights, shape (wavelengths,), to the standard error of the weighted sum of
        differences, with the correlation of errors along the spectrum.

    Notes
    -----
    δ rmse = Σ d δd / (n rmse).  Noise additionally increases rmse by half its mean square
    over rmse. The root mean square of the errors is an upper bound for any correlation.
    """
    difference, stderr = (np.asarray(x, dtype=float) for x in (difference, stderr))
    value = float(np.sqrt(np.mean(difference**2)))
    bound = float(np.sqrt(np.mean(stderr**2)))
    if value == 0.0:
        return value, bound
    linear = compute_stderr(difference / (difference.size * value))
    return value, float(min(np.hypot(linear, 0.5 * bound**2 / value), bound))


def compute_measured_rmse(dataset: xr.Dataset, measured: pd.DataFrame) -> tuple[float, float]:
    """Return the root-mean-square difference from a measured reflectance, and its error.

    Parameters
    ----------
    dataset, measured
        As for `compare_with_spectrum`.
    """
    table = compare_with_spectrum(dataset, measured)
    part = dataset.sel(wavelength=measured.wavelength_nm.values)

    def compute_stderr(weights: np.ndarray) -> float:
        return float(
            compute_weighted_error(part, "reflectance", xr.DataArray(weights, dims="wavelength"))
        )

    return compute_rmse(table.difference, table.stderr, compute_stderr)


def compare_with_spectrum(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return modelled and measured reflectance at the measured wavelengths.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over ``wavelength`` only, including every measured one.
    measured : pandas.DataFrame
        Columns ``wavelength_nm`` and ``reflectance``.
    """
    part = dataset.sel(wavelength=measured.wavelength_nm.values)
    return pd.DataFrame(
        {
            "wavelength_nm": measured.wavelength_nm,
            "measured": measured.reflectance,
            "model": part.reflectance.values,
            "stderr": part.reflectance_stderr.values,
            "difference": part.reflectance.values - measured.reflectance,
        }
    )


def mix_letcher_illumination(dataset: xr.Dataset, snow: str, depth: float) -> xr.Dataset:
    """Return the reflectance of snow under the illumination of the measurement, with its errors.

    `DIFFUSE_FRACTION` of the light is diffuse and the rest a beam.
    """
    part = dataset.sel(medium=snow).sel(depth_m=depth, method="nearest")
    illuminations = [(1.0 - DIFFUSE_FRACTION, "beam"), (DIFFUSE_FRACTION, "diffuse")]
    runs = [(fraction, part.sel(incidence_deg=incidence)) for fraction, incidence in illuminations]
    squares = [(fraction * run.reflectance_stderr) ** 2 for fraction, run in runs]
    batches = [fraction * run.reflectance_batches for fraction, run in runs]
    scalar_names = ("medium", "incidence_deg", "depth_m")
    return xr.Dataset(
        {
            "reflectance": sum(
                fraction * run.reflectance.drop_vars(scalar_names) for fraction, run in runs
            ),
            "reflectance_stderr": sum(square.drop_vars(scalar_names) for square in squares) ** 0.5,
            "reflectance_batches": xr.concat([g.drop_vars(scalar_names) for g in batches], "batch"),
        }
    )


def compare_with_letcher(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return modelled and measured albedo for every snow and depth of the experiment."""
    tables = []
    for snow, depth in itertools.product(dataset.medium.values, LETCHER_COLUMNS):
        table = compare_with_spectrum(
            mix_letcher_illumination(dataset, snow, depth), select_letcher_column(measured, depth)
        )
        table.insert(0, "snow", str(snow))
        table.insert(1, "depth_m", depth)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def select_letcher_column(measured: pd.DataFrame, depth: float) -> pd.DataFrame:
    """Return the spectrum measured on snow of a depth (m), for `compare_with_spectrum`."""
    return measured.rename(columns={LETCHER_COLUMNS[depth]: "reflectance"})
