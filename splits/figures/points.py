"""Values at a few points of a grid, with error bars."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.escaping import escape_mathtext
from splits.figures.conditions import conditions
from splits.figures.lines import Lines, beside
from splits.figures.notes import finished
from splits.figures.shifts import INDEPENDENT, read_against, shift_of
from splits.figures.style import (
    BAND,
    ONE_COLUMN,
    SMALLEST,
    TWO_COLUMNS,
    colours,
    parameter_label,
    style,
    subplots,
    value_label,
)
from splits.panels import DEFAULT

_DODGE = 0.6
"""Part of a row over which the series are spread."""
_MOST_STATED = 4
"""Of more series than these, the default's values are stated as a range."""


def points(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("reflectance",),
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw quantities over the points of a grid, a panel each and one series per wavelength.

    Where one value of the grid's only parameter is labelled ``default``, the others are shown as
    shifts from it.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment.
    quantity : sequence of str
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        What the grid is over; its parameters by default.
    """
    dataset = at_points(dataset, at or {})
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    combinations = list(itertools.product(*(dataset[d].values for d in dims)))
    names = [
        " · ".join(value_label(v, d) for d, v in zip(dims, values, strict=True))
        for values in combinations
    ]
    dim = read_against(dataset, dims)
    series = Lines(dataset, ["wavelength"])
    with style():
        figure, panels = subplots(
            1, len(quantity), width=ONE_COLUMN if len(quantity) == 1 else TWO_COLUMNS,
            height=0.7 + 0.17 * max(len(names), 4), sharey=True, squeeze=False,
        )  # fmt: skip
        for axes, name in zip(panels[0], quantity, strict=True):
            long_name = escape_mathtext(str(dataset[name].attrs.get("long_name", name)))
            if "wavelength" in dataset[name].dims:
                _series(axes, dataset, name, series, dim)
                axes.set_xlabel(_stated(dataset, name, long_name, dim))
            else:
                _lengths(axes, 1e3 * dataset[name].values.ravel())
                axes.set_xlabel(f"{long_name} (mm)")
            axes.grid(axis="x", alpha=0.3)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.spines[["top", "right"]].set_visible(False)
        first = panels[0, 0]
        first.set_yticks(range(len(names)), names)
        first.set_ylabel(legend or "\n".join(map(parameter_label, dims)))
        handles: list[Artist] = []
        for axes in panels[0]:
            handles = handles or axes.get_legend_handles_labels()[0]
        if series.has_colour_bar and handles:
            series.add_legend(figure, list(panels[0]))
        elif len(handles) > 1:
            beside(figure, handles, series.make_title())
        timed = any("wavelength" in dataset[name].dims for name in quantity)
        told = f"Shifts: {INDEPENDENT}." if dim and timed else ""
        band = "bars" if timed else ""
        return finished(figure, panels[0], conditions(dataset, at, band), told)


def _stated(dataset: xr.Dataset, name: str, long_name: str, dim: str | None) -> str:
    """Return the label of an axis: of shifts it states what the default's values are."""
    if dim is None:
        return long_name
    values = dataset[name].sel({dim: DEFAULT}).values.ravel()
    x = dataset.wavelength.values
    if values.size > _MOST_STATED:
        stated = f"{values.min():.3f}–{values.max():.3f}"
    else:
        stated = ", ".join(f"{v:.3f} ({w:g} nm)" for v, w in zip(values, x, strict=True))
    return f"{long_name}, shift from the default\ndefault: {stated}"


def _series(axes: Axes, dataset: xr.Dataset, name: str, series: Lines, dim: str | None) -> None:
    """Draw the values of all points at every wavelength, or their shifts."""
    value, error = dataset[name], dataset[f"{name}_stderr"]
    if dim:
        value, error = shift_of(dataset, name, dim)
        others = value[dim] != DEFAULT
        value, error = value.where(others, 0.0), error.where(others, 0.0)
        axes.axvline(0.0, color="black", lw=0.6, zorder=1.0)
    count = len(series.lines)
    for number, one in enumerate(series.lines):
        x = value.sel(one.labels).values.ravel()
        y = np.arange(x.size) + (_DODGE * ((number + 0.5) / count - 0.5) if count > 1 else 0.0)
        axes.errorbar(
            x, y, xerr=BAND * error.sel(one.labels).values.ravel(),
            fmt="o", ms=2.5, color=one.colour, elinewidth=0.8, label=one.label,
        )  # fmt: skip


def _lengths(axes: Axes, value: np.ndarray) -> None:
    """Draw lengths, which have no error, with their numbers."""
    rows = range(value.size)
    axes.plot(value, rows, "o", color=colours(1)[0])
    for x, y in zip(value, rows, strict=True):
        axes.annotate(
            f"{x:.3f}", (x, y), xytext=(5, 0), textcoords="offset points", va="center",
            fontsize=SMALLEST,
        )  # fmt: skip
    axes.set_xlim(0, 1.2 * value.max())
