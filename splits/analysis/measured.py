"""Agreement with measured spectra: root mean square error and error per band."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

DIFFUSE_SHARE = 0.85
"""Share of diffuse light under which Letcher et al. (2022) measured."""

LETCHER_COLUMNS = {0.34: "albedo_340mm", 0.045: "albedo_45mm_black"}
"""Measured column for each depth (m) of the experiment."""


def read_measured(path: str | Path) -> pd.DataFrame:
    """Read a table of measured values; lines that begin with # hold its citation."""
    return pd.read_csv(path, comment="#")


def rmse(difference: np.ndarray, stderr: np.ndarray) -> tuple[float, float]:
    """Return the root mean square of differences and an upper bound of its standard error.

    It holds however errors go together along the spectrum, and is reached where they all do:
    δ rmse ≤ Σ |d| δd / (n rmse) ≤ the root mean square of the errors.
    """
    difference = np.asarray(difference, dtype=float)
    value = float(np.sqrt(np.mean(difference**2)))
    return value, float(np.sqrt(np.mean(np.square(stderr))))


def bands(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
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


def letcher_bands(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return model and measured albedo for every snow and depth of the experiment.

    The model's light is `DIFFUSE_SHARE` from the whole hemisphere and the rest a beam.
    """
    tables = []
    for snow, depth in itertools.product(dataset.medium.values, LETCHER_COLUMNS):
        part = dataset.sel(medium=snow).sel(depth_m=depth, method="nearest")
        beam, diffuse = (part.sel(incidence_deg=i) for i in ("beam", "diffuse"))
        share = DIFFUSE_SHARE
        mixed = xr.Dataset(
            {
                "reflectance": (1 - share) * beam.reflectance + share * diffuse.reflectance,
                "reflectance_stderr": (
                    ((1 - share) * beam.reflectance_stderr) ** 2
                    + (share * diffuse.reflectance_stderr) ** 2
                )
                ** 0.5,
            }
        )
        column = measured.rename(columns={LETCHER_COLUMNS[depth]: "reflectance"})
        table = bands(mixed, column)
        table.insert(0, "snow", str(snow))
        table.insert(1, "depth_m", depth)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)
