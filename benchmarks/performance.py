"""Computing time and error of methods: table, figure, and their scaling to other errors.

The error of a Monte Carlo method is proportional to the inverse square root of its time, so the
figure of merit is 1/(error² · time).  The ratio of two figures of merit is the ratio of the times
at equal error.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from splits.plotting.grammar import (
    TWO_COLUMNS_INCHES,
    Colour,
    annotate_figure,
    make_subplots,
    pick_colours,
    use_style,
)
from splits.plotting.lines import place_legend_above

QUANTITIES = ("reflectance", "transmittance", "absorptance")

PAPER_UNIFORM = "papers_uniform"
PAPER_ADAPTIVE = "papers_adaptive"
VECTORIZED = "vectorized"
METHODS = {
    PAPER_UNIFORM: "papers' algorithm, uniform",
    PAPER_ADAPTIVE: "papers' algorithm, adaptive",
    "one_by_one": "weights, single wavelengths",
    "scalar": "shared paths, scalar kernel",
    VECTORIZED: "shared paths, vectorized kernel",
    "discrete_ordinates": "discrete ordinates",
    "kz04": "Kokhanovsky & Zege",
}
"""Descriptions of the methods of `benchmarks/speed_against_error.py`."""
THEORIES = ("discrete_ordinates", "kz04")
"""Methods that are other models, and so differ from the reference."""

TIME_COLUMNS = [
    "medium", "target error", "this package (s)", "papers' algorithm, uniform (s)",
    "papers' algorithm, adaptive (s)", "time ratio, uniform", "time ratio, adaptive",
]  # fmt: skip

MEASURED = "measured"
MEASURED_PARTLY = "measured at every tenth wavelength"
SCALED = "scaled from another error"
"""Origins of a time: a full run; every tenth wavelength, traced to the same error; or a run with
another error."""


def scale_paper_times(
    seconds: np.ndarray, rays: np.ndarray, stderr: np.ndarray, error: float, min_rays: int
) -> tuple[float, float, float, float]:
    """Return the times and rays of single-wavelength runs, scaled to another error.

    The number of rays is proportional to 1/error² and the time to the number of rays.

    Parameters
    ----------
    seconds, rays, stderr : float, shape (wavelengths,)
        Time, number of rays and standard error of each wavelength.
    error : float
        Target standard error.
    min_rays : int
        Smallest number of rays per wavelength.

    Returns
    -------
    uniform_s, uniform_rays : float
        Total time and rays if every wavelength uses those of the noisiest one.
    adaptive_s, adaptive_rays : float
        Total time and rays if every wavelength uses as many as it needs.
    """
    rays_needed = np.maximum(rays * (stderr / error) ** 2, min_rays)
    per_ray = seconds / rays
    max_rays = rays_needed.max()
    return (
        float(max_rays * per_ray.sum()),
        float(max_rays * len(rays_needed)),
        float((per_ray * rays_needed).sum()),
        float(rays_needed.sum()),
    )


def summarize_stated_errors(dataset: xr.Dataset) -> dict[str, float]:
    """Return the largest and the root-mean-square standard error of a spectrum.

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
    """Return the deviations of a spectrum from a reference.

    Parameters
    ----------
    dataset, reference : xarray.Dataset
        With all `QUANTITIES`; the reference must contain the dataset's wavelengths.  Standard
        errors of the dataset may be missing.

    Returns
    -------
    dict
        ``deviation_rms``, over wavelengths, of the quantity for which it is largest;
        ``deviation_largest``, of all quantities and wavelengths; and ``deviation_z``, the root
        mean square deviation in stated standard errors of both, not a number for a dataset
        without any.
    """
    reference = reference.sel(wavelength=dataset.wavelength)
    deviation = np.stack([(dataset[name] - reference[name]).values for name in QUANTITIES])
    z = np.nan
    if f"{QUANTITIES[0]}_stderr" in dataset:
        variance = [
            dataset[f"{name}_stderr"].values ** 2 + reference[f"{name}_stderr"].values ** 2
            for name in QUANTITIES
        ]
        z = float(np.sqrt((deviation**2 / np.stack(variance)).mean()))
    return {
        "deviation_rms": float(np.sqrt((deviation**2).mean(axis=1)).max()),
        "deviation_largest": float(np.abs(deviation).max()),
        "deviation_z": z,
    }


def combine_runs(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the combined errors of repeated runs.

    Numbers with suffix ``_largest`` are combined by the maximum, others by the root mean square.
    """
    return {
        key: float(
            values.max() if key.endswith("_largest") else np.sqrt((values**2).mean(skipna=False))
        )
        for key, values in pd.DataFrame(runs).items()
    }


def format_row(row: Mapping[str, Any]) -> str:
    """Return a row of the table as one line of text."""
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
    """Return a table with figures of merit and their ratios to those of the papers' algorithm.

    Parameters
    ----------
    table : pandas.DataFrame
        With columns ``medium``, ``method``, ``error`` (target; NaN for theories), ``seconds``,
        ``stderr_largest`` and ``how`` (`MEASURED`, `MEASURED_PARTLY` or `SCALED`).

    Returns
    -------
    pandas.DataFrame
        With ``figure_of_merit`` (1/s) and, at the same target error, its ratios ``over_uniform``
        and ``over_adaptive`` to the papers' algorithm, scaled where it was not measured.  NaN for
        theories, whose deviation does not depend on time.
    """
    table = table.copy()
    table["figure_of_merit"] = 1.0 / (table.stderr_largest**2 * table.seconds)
    table.loc[table.method.isin(THEORIES), "figure_of_merit"] = np.nan
    for method, column in ((PAPER_UNIFORM, "over_uniform"), (PAPER_ADAPTIVE, "over_adaptive")):
        table[column] = [
            row.figure_of_merit / paper_row.figure_of_merit if paper_row is not None else np.nan
            for row in table.itertuples()
            for paper_row in [find_best_row(table, row.medium, method, row.error)]
        ]
    return table


def find_best_row(table: pd.DataFrame, medium: str, method: str, error: float) -> pd.Series | None:
    """Return the row of a method at a target error; a scaled one only if no other exists."""
    rows = table[(table.medium == medium) & (table.method == method) & (table.error == error)]
    if rows.empty:
        return None
    return rows.loc[(rows.how != SCALED).idxmax()]


def format_headline(table: pd.DataFrame, medium: str, error: float, wavelengths: int) -> str:
    """Return one line on the times of the vectorized kernel and the papers' algorithm."""
    rows = {
        name: find_best_row(table, medium, name, error)
        for name in (VECTORIZED, PAPER_UNIFORM, PAPER_ADAPTIVE)
    }
    missing = [name for name, row in rows.items() if row is None]
    if missing:
        raise ValueError(f"{medium}, error {error:g}: no row of {', '.join(missing)}")
    vectorized, uniform, adaptive = (row.seconds for row in rows.values() if row is not None)
    return (
        f"{medium}, {wavelengths} wavelengths, error {error:g}: vectorized kernel "
        f"{vectorized:.3g} s, papers' algorithm uniform {uniform:.4g} s "
        f"({uniform / vectorized:.0f}), adaptive {adaptive:.4g} s ({adaptive / vectorized:.0f})"
    )


def make_time_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the times of the vectorized kernel and of the papers' algorithm for each medium.

    The error is the smallest at which the benchmark has all three.  Numbers have three digits.
    """
    rows = []
    for medium in dict.fromkeys(table.medium):
        for error in sorted(table.error[table.medium == medium].dropna().unique()):
            found = [
                find_best_row(table, medium, method, error)
                for method in (VECTORIZED, PAPER_UNIFORM, PAPER_ADAPTIVE)
            ]
            seconds = [float(row.seconds) for row in found if row is not None]
            if len(seconds) == len(found):
                ratios = [time / seconds[0] for time in seconds[1:]]
                rows.append([medium, *(float(f"{x:.3g}") for x in (error, *seconds, *ratios))])
                break
    return pd.DataFrame(rows, columns=TIME_COLUMNS)


METHOD_MARKERS = ("s", "D", "v", "^", "o", "P", "X")
THEORY_GREYS = ("0.15", "0.5")
"""Greys of the theories, which are other models."""
MAX_COLUMNS = 2


def draw_speed_against_error(table: pd.DataFrame) -> Figure:
    """Draw the error of methods against their time, one panel per medium.

    Filled markers are measured, open ones scaled from another error.  The error is the largest
    stated standard error; for theories, the largest deviation from the reference.

    Parameters
    ----------
    table : pandas.DataFrame
        Output of `benchmarks/speed_against_error.py`.
    """
    media = list(dict.fromkeys(table.medium))
    columns = min(MAX_COLUMNS, len(media))
    rows = -(-len(media) // columns)
    colours: list[Colour] = [*pick_colours(len(METHODS) - len(THEORIES), "sample"), *THEORY_GREYS]
    styles = dict(zip(METHODS, zip(colours, METHOD_MARKERS, strict=True), strict=True))
    with use_style():
        figure, panels = make_subplots(
            rows, columns, width=TWO_COLUMNS_INCHES, height=2.6 * rows, sharex=True, sharey=True,
            squeeze=False,
        )  # fmt: skip
        for medium, axes in zip(media, panels.flat, strict=False):
            _draw_medium(axes, table[table.medium == medium], styles)
            axes.set_title(medium)
        for axes in panels.flat[len(media) :]:
            axes.set_visible(False)
        for axes in panels[-1]:
            axes.set_xlabel("time on one core (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("largest error")
        shown = [name for name in METHODS if (table.method == name).any()]
        handles = [
            Line2D(
                [], [], color=styles[name][0], marker=styles[name][1],
                ls="none" if name in THEORIES else "-", label=_format_method(name),
            )
            for name in shown
        ]  # fmt: skip
        scaled = Line2D([], [], color="0.3", marker="o", mfc="white", ls="none", label="scaled")
        place_legend_above(figure, [*handles, scaled], None)
        return annotate_figure(figure, panels.flat)


def _format_method(method: str) -> str:
    """Return the label of a method in the legend."""
    return METHODS[method] + (" (another model)" if method in THEORIES else "")


def _draw_medium(axes: Axes, table: pd.DataFrame, styles: dict[str, tuple[Colour, str]]) -> None:
    """Draw the methods of one medium."""
    for method, rows in table.groupby("method"):
        colour, marker = styles[str(method)]
        shown = "deviation_largest" if method in THEORIES else "stderr_largest"
        # Lines pass through the measured point where a scaled one exists as well.
        line = rows.sort_values("how", key=lambda how: how == SCALED).drop_duplicates("error")
        axes.plot("seconds", shown, data=line.sort_values("error"), color=colour, lw=1.0)
        for scaled, part in rows.groupby(rows.how == SCALED):
            axes.plot(
                part.seconds, part[shown], marker, color=colour, ls="none",
                mfc="white" if scaled else colour, ms=4,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(which="major", alpha=0.3)
