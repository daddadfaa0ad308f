"""Time against error: what a measured speed is worth, and what holds for other errors by scaling.

The errors of all Monte Carlo methods fall with the square root of the time, so a method's figure of
merit is 1/(error² · time), and the ratio of two is the ratio of their times at equal error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

QUANTITIES = ("reflectance", "transmittance", "absorptance")

PAPER_UNIFORM = "papers_uniform"
PAPER_ADAPTIVE = "papers_adaptive"
VECTORIZED = "vectorized"
METHODS = {
    PAPER_UNIFORM: "papers' algorithm, uniform",
    PAPER_ADAPTIVE: "papers' algorithm, adaptive",
    "one_by_one": "weights, one wavelength at a time",
    "scalar": "shared paths, scalar kernel",
    VECTORIZED: "shared paths, lanes",
    "discrete_ordinates": "discrete ordinates",
    "kz04": "Kokhanovsky & Zege",
}
"""Methods as `benchmarks/speed_against_error.py` names them, and in words."""
THEORIES = ("discrete_ordinates", "kz04")
"""Methods that differ from the reference because they are other models."""

MEASURED = "measured"
MEASURED_PARTLY = "measured at every tenth wavelength"
SCALED = "scaled from another error"
"""How a time was found: by a whole run; from every tenth wavelength, traced to that very error; or
from those traced to another error."""


def scale_paper_times(
    seconds: np.ndarray, rays: np.ndarray, stderr: np.ndarray, error: float, min_rays: int
) -> tuple[float, float, float, float]:
    """Return what wavelengths traced one by one take to reach another error, by scaling.

    Rays go with 1/error² and time with rays.

    Parameters
    ----------
    seconds, rays, stderr : float, shape (wavelengths,)
        Time spent, rays traced and standard error so reached.
    error : float
        Standard error to scale to.
    min_rays : int
        Rays that every wavelength takes in any case.

    Returns
    -------
    uniform_s, uniform_rays : float
        If every wavelength takes the rays that the noisiest one needs: total time and rays.
    adaptive_s, adaptive_rays : float
        If every wavelength takes the rays that it needs by itself.
    """
    needed = np.maximum(rays * (stderr / error) ** 2, min_rays)
    per_ray = seconds / rays
    most = needed.max()
    return (
        float(most * per_ray.sum()),
        float(most * len(needed)),
        float((per_ray * needed).sum()),
        float(needed.sum()),
    )


def summarize_stated_errors(dataset: xr.Dataset) -> dict[str, float]:
    """Return the largest stated standard error of a spectrum, and its root mean square.

    Parameters
    ----------
    dataset : xarray.Dataset
        With ``…_stderr`` of all `QUANTITIES`; the root mean square over wavelengths is that of the
        quantity for which it is largest.
    """
    stderr = np.stack([dataset[f"{name}_stderr"].values for name in QUANTITIES])
    return {
        "stderr_largest": float(stderr.max()),
        "stderr_rms": float(np.sqrt((stderr**2).mean(axis=1)).max()),
    }


def compute_deviations(dataset: xr.Dataset, reference: xr.Dataset) -> dict[str, float]:
    """Return how far a spectrum lies from a reference.

    Parameters
    ----------
    dataset, reference : xarray.Dataset
        Of `QUANTITIES`, the reference at least at the dataset's wavelengths; standard errors of
        the dataset may be missing.

    Returns
    -------
    dict
        ``deviation_rms``, over wavelengths, of the quantity for which it is largest;
        ``deviation_largest``, of all quantities and wavelengths; and ``deviation_z``, the root
        mean square deviation in stated standard errors of both, not a number for a dataset
        without any.
    """
    reference = reference.sel(wavelength=dataset.wavelength)
    off = np.stack([(dataset[name] - reference[name]).values for name in QUANTITIES])
    z = np.nan
    if f"{QUANTITIES[0]}_stderr" in dataset:
        variance = [
            dataset[f"{name}_stderr"].values ** 2 + reference[f"{name}_stderr"].values ** 2
            for name in QUANTITIES
        ]
        z = float(np.sqrt((off**2 / np.stack(variance)).mean()))
    return {
        "deviation_rms": float(np.sqrt((off**2).mean(axis=1)).max()),
        "deviation_largest": float(np.abs(off).max()),
        "deviation_z": z,
    }


def combine_runs(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return what repeated runs say together of `summarize_stated_errors` and `compute_deviations`.

    Of numbers called largest it is the largest, of all others the root mean square.
    """
    found: dict[str, float] = {}
    for run in runs:
        for key, value in run.items():
            before = found.get(key, 0.0)
            if key.endswith("_largest"):
                found[key] = max(before, value)
            else:
                found[key] = float(np.sqrt(before**2 + value**2 / len(runs)))
    return found


def format_row(row: Mapping[str, Any]) -> str:
    """Return one line that says what a row of the table holds."""
    parts = [f"{row['medium']}, {METHODS[row['method']]}"]
    if not np.isnan(row["error"]):
        parts.append(f"error {row['error']:g}")
    line = f"{', '.join(parts)}: {row['seconds']:.4g} s ({row['how']})"
    if not np.isnan(row["stderr_largest"]):
        line += f", stated {row['stderr_largest']:.2g} (rms {row['stderr_rms']:.2g})"
    if not np.isnan(row["deviation_rms"]):
        line += f", off by rms {row['deviation_rms']:.2g}, at most {row['deviation_largest']:.2g}"
    if not np.isnan(row["deviation_z"]):
        line += f", rms z {row['deviation_z']:.2f}"
    return line


def add_figures_of_merit(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of times and errors with figures of merit and their ratios to the papers'.

    Parameters
    ----------
    table : pandas.DataFrame
        With columns ``medium``, ``method``, ``error`` (asked for; none for theories), ``seconds``,
        ``stderr_largest`` and ``how`` (`MEASURED`, `MEASURED_PARTLY` or `SCALED`).

    Returns
    -------
    pandas.DataFrame
        With ``figure_of_merit`` (1/s) and, at the same error asked for, its ratios
        ``over_uniform`` and ``over_adaptive`` to the papers' algorithm, scaled where it was not
        measured.  None for theories: their difference does not fall with time.
    """
    table = table.copy()
    table["figure_of_merit"] = 1.0 / (table.stderr_largest**2 * table.seconds)
    table.loc[table.method.isin(THEORIES), "figure_of_merit"] = np.nan
    for method, column in ((PAPER_UNIFORM, "over_uniform"), (PAPER_ADAPTIVE, "over_adaptive")):
        table[column] = [
            row.figure_of_merit / papers.figure_of_merit if papers is not None else np.nan
            for row in table.itertuples()
            for papers in [find_best_row(table, row.medium, method, row.error)]
        ]
    return table


def find_best_row(table: pd.DataFrame, medium: str, method: str, error: float) -> pd.Series | None:
    """Return the row of a method at an error asked for, scaled only if no other is there."""
    rows = table[(table.medium == medium) & (table.method == method) & (table.error == error)]
    if rows.empty:
        return None
    return rows.loc[(rows.how != SCALED).idxmax()]


def format_headline(table: pd.DataFrame, medium: str, error: float, wavelengths: int) -> str:
    """Return one line that says how much sooner lanes reach an error than the papers' algorithm."""
    rows = {
        name: find_best_row(table, medium, name, error)
        for name in (VECTORIZED, PAPER_UNIFORM, PAPER_ADAPTIVE)
    }
    missing = [name for name, row in rows.items() if row is None]
    if missing:
        raise ValueError(f"{medium}, error {error:g}: no row of {', '.join(missing)}")
    lanes, uniform, adaptive = (row.seconds for row in rows.values() if row is not None)
    return (
        f"{medium}, {wavelengths} wavelengths, error {error:g}: lanes {lanes:.3g} s, papers' "
        f"algorithm uniform {uniform:.4g} s ({uniform / lanes:.0f}), adaptive {adaptive:.4g} s "
        f"({adaptive / lanes:.0f})"
    )
