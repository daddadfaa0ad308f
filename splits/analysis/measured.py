"""Measured and published numbers: readers of their tables, and proportional fits."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from splits.core.inputs import check_wavelengths
from splits.core.validation import key_prefix
from splits.materials.csv_table import read_csv, read_numeric_csv

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
        check_wavelengths("wavelength_nm", table[WAVELENGTH_COLUMN])
    return table


class ProportionalFit(NamedTuple):
    """Unweighted fit of a line y = a x.

    Attributes
    ----------
    slope, stderr : float
        a, and its standard error from the scatter.
    scatter : float
        Standard deviation of y about the line.
    """

    slope: float
    stderr: float
    scatter: float


def fit_proportional(x: np.ndarray, y: np.ndarray) -> ProportionalFit:
    """Return the least-squares line through the origin.

    Parameters
    ----------
    x, y : float, shape (points,)
        At least two points.
    """
    square = float((x * x).sum())
    slope = float((x * y).sum() / square)
    scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
    return ProportionalFit(slope, scatter / float(np.sqrt(square)), scatter)
