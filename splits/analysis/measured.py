"""Agreement with measured spectra: root mean square error and error per band."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.uncertainty import compute_weighted_error
from splits.core.validation import key_prefix
from splits.materials.csv_table import read_numeric_csv
from splits.simulation.arguments import check_wavelengths

DIFFUSE_FRACTION = 0.85
"""Share of diffuse light under which Letcher et al. (2022) measured."""

LETCHER_COLUMNS = {0.34: "albedo_340mm", 0.045: "albedo_45mm_black"}
"""Measured column for each depth (m) of the experiment."""


WAVELENGTH_COLUMN = "wavelength_nm"


def read_measured(path: str | Path, key: str = "measured") -> pd.DataFrame:
    """Read a table of measured values, or refuse it under a key; comments hold its citation."""
    return read_numeric_csv(key, path)


def read_spectra(path: str | Path, key: str = "measured") -> pd.DataFrame:
    """Read a table of measured spectra: wavelengths, and a column for each spectrum.

    Parameters
    ----------
    path : path
        A CSV file with a column ``wavelength_nm``, strictly increasing.
    key : str
        What is refused.

    Returns
    -------
    pandas.DataFrame
        Numbers, or NaN where a cell is empty.

    Raises
    ------
    ValueError
        For a file that is no such table.
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
        And its standard errors.
    compute_stderr : callable
        From weights, shape (wavelengths,), to the standard error of a weighted sum of differences,
        which knows how errors go together along the spectrum.

    Notes
    -----
    δ rmse = Σ d δd / (n rmse).  Noise besides makes it larger by half its mean square over rmse.
    No error is larger than the root mean square of the errors, which bounds it however they go.
    """
    difference, stderr = (np.asarray(x, dtype=float) for x in (difference, stderr))
    value = float(np.sqrt(np.mean(difference**2)))
    bound = float(np.sqrt(np.mean(stderr**2)))
    if value == 0.0:
        return value, bound
    first = compute_stderr(difference / (difference.size * value))
    return value, float(min(np.hypot(first, 0.5 * bound**2 / value), bound))


def compute_measured_rmse(dataset: xr.Dataset, measured: pd.DataFrame) -> tuple[float, float]:
    """Return the root-mean-square difference of reflectance to a measured spectrum, and its error.

    Parameters
    ----------
    dataset, measured
        As for `compare_with_spectrum`.
    """
    table = compare_with_spectrum(dataset, measured)
    part = dataset.sel(wavelength=measured.wavelength_nm.values)

    def combined(weights: np.ndarray) -> float:
        return float(
            compute_weighted_error(part, "reflectance", xr.DataArray(weights, dims="wavelength"))
        )

    return compute_rmse(table.difference, table.stderr, combined)


def compare_with_spectrum(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return model and measurement at the measured wavelengths of a table.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over ``wavelength`` alone, holding every measured one.
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
    """Return the reflectance of a snow under the light of the measurement, with its errors.

    `DIFFUSE_FRACTION` of the light comes from the whole hemisphere and the rest in a beam.
    """
    part = dataset.sel(medium=snow).sel(depth_m=depth, method="nearest")
    ways = [(1.0 - DIFFUSE_FRACTION, "beam"), (DIFFUSE_FRACTION, "diffuse")]
    runs = [(share, part.sel(incidence_deg=incidence)) for share, incidence in ways]
    squares = [(share * run.reflectance_stderr) ** 2 for share, run in runs]
    groups = [share * run.reflectance_batches for share, run in runs]
    kept = ("medium", "incidence_deg", "depth_m")
    return xr.Dataset(
        {
            "reflectance": sum(share * run.reflectance.drop_vars(kept) for share, run in runs),
            "reflectance_stderr": sum(square.drop_vars(kept) for square in squares) ** 0.5,
            "reflectance_batches": xr.concat([g.drop_vars(kept) for g in groups], "batch"),
        }
    )


def compare_with_letcher(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return model and measured albedo for every snow and depth of the experiment."""
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
    """Return what was measured on snow of a depth (m), as `compare_with_spectrum` takes it."""
    return measured.rename(columns={LETCHER_COLUMNS[depth]: "reflectance"})
