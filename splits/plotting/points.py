"""Values at a few points of a grid, with error bars.

A table at a glance: spectra at a few nodes of each of its axes, never all of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.core.escaping import escape_mathtext
from splits.io.netcdf import select_points
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.facets import draw_facets
from splits.plotting.interpretation_shifts import (
    INDEPENDENCE_NOTE,
    compute_shift,
    find_default_dim,
)
from splits.plotting.lines import PlotLines, place_legend_beside
from splits.plotting.panels import DEFAULT_LABEL
from splits.plotting.spectra import draw_spectra
from splits.plotting.style import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    format_parameter,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)

_SERIES_SPREAD = 0.6
"""Part of a row over which the series are spread."""
_MAX_STATED_VALUES = 4
"""Of more series than these, the default's values are stated as a range."""


def draw_points(
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
    dataset = select_points(dataset, at or {})
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    combinations = list(itertools.product(*(dataset[d].values for d in dims)))
    names = [
        " · ".join(format_value(v, d) for d, v in zip(dims, values, strict=True))
        for values in combinations
    ]
    dim = find_default_dim(dataset, dims)
    series = PlotLines(dataset, ["wavelength"])
    with use_style():
        figure, panels = make_subplots(
            1, len(quantity), width=ONE_COLUMN_INCHES if len(quantity) == 1 else TWO_COLUMNS_INCHES,
            height=0.7 + 0.17 * max(len(names), 4), sharey=True, squeeze=False,
        )  # fmt: skip
        for axes, name in zip(panels[0], quantity, strict=True):
            long_name = escape_mathtext(str(dataset[name].attrs.get("long_name", name)))
            if "wavelength" in dataset[name].dims:
                _draw_series(axes, dataset, name, series, dim)
                axes.set_xlabel(_make_axis_label(dataset, name, long_name, dim))
            else:
                _draw_lengths(axes, 1e3 * dataset[name].values.ravel())
                axes.set_xlabel(f"{long_name} (mm)")
            axes.grid(axis="x", alpha=0.3)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.spines[["top", "right"]].set_visible(False)
        first = panels[0, 0]
        first.set_yticks(range(len(names)), names)
        first.set_ylabel(legend or "\n".join(map(format_parameter, dims)))
        handles: list[Artist] = []
        for axes in panels[0]:
            handles = handles or axes.get_legend_handles_labels()[0]
        if series.has_colour_bar and handles:
            series.add_legend(figure, list(panels[0]))
        elif len(handles) > 1:
            place_legend_beside(figure, handles, series.make_title())
        timed = any("wavelength" in dataset[name].dims for name in quantity)
        told = f"Shifts: {INDEPENDENCE_NOTE}." if dim and timed else ""
        band = "bars" if timed else ""
        return annotate_figure(figure, panels[0], describe_conditions(dataset, at, band), told)


def _make_axis_label(dataset: xr.Dataset, name: str, long_name: str, dim: str | None) -> str:
    """Return the label of an axis: of shifts it states what the default's values are."""
    if dim is None:
        return long_name
    values = dataset[name].sel({dim: DEFAULT_LABEL}).values.ravel()
    x = dataset.wavelength.values
    if values.size > _MAX_STATED_VALUES:
        stated = f"{values.min():.3f}–{values.max():.3f}"
    else:
        stated = ", ".join(f"{v:.3f} ({w:g} nm)" for v, w in zip(values, x, strict=True))
    return f"{long_name}, shift from the default\ndefault: {stated}"


def _draw_series(
    axes: Axes, dataset: xr.Dataset, name: str, series: PlotLines, dim: str | None
) -> None:
    """Draw the values of all points at every wavelength, or their shifts."""
    value, error = dataset[name], dataset[f"{name}_stderr"]
    if dim:
        value, error = compute_shift(dataset, name, dim)
        others = value[dim] != DEFAULT_LABEL
        value, error = value.where(others, 0.0), error.where(others, 0.0)
        axes.axvline(0.0, color="black", lw=0.6, zorder=1.0)
    count = len(series.lines)
    for number, one in enumerate(series.lines):
        x = value.sel(one.labels).values.ravel()
        y = np.arange(x.size) + (
            _SERIES_SPREAD * ((number + 0.5) / count - 0.5) if count > 1 else 0.0
        )
        axes.errorbar(
            x, y, xerr=BAND_SIGMA * error.sel(one.labels).values.ravel(),
            fmt="o", ms=2.5, color=one.colour, elinewidth=0.8, label=one.label,
        )  # fmt: skip


def _draw_lengths(axes: Axes, value: np.ndarray) -> None:
    """Draw lengths, which have no error, with their numbers."""
    rows = range(value.size)
    axes.plot(value, rows, "o", color=pick_colours(1)[0])
    for x, y in zip(value, rows, strict=True):
        axes.annotate(
            f"{x:.3f}", (x, y), xytext=(5, 0), textcoords="offset points", va="center",
            fontsize=SMALL_FONT_PT,
        )  # fmt: skip
    axes.set_xlim(0, 1.2 * value.max())


MAX_SUMMARY_LINES = 6
"""Values of the axis whose spectra are lines."""
MAX_SUMMARY_PANELS = (3, 4)
"""Values of the axes whose values have panels: below each other, and side by side."""


def draw_summary(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    at: Mapping[str, Any],
    legend: str | None = None,
) -> Figure:
    """Draw a table: lines along its longest axis, panels along the next two, the rest fixed.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.build_table` returns it.
    quantity : sequence of str
    at : mapping
        From axes to the node that they are shown at; of those that have neither lines nor panels
        nor a place here, the middle one.
    legend : str, optional
        Title of the legend.
    """
    axes = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    # Deviations by batch of rays are not shown.
    part = dataset.drop_dims("batch", errors="ignore").sel(dict(at))
    free = sorted((n for n in axes if n not in at), key=lambda n: -dataset.sizes[n])
    free = [name for name in free if dataset.sizes[name] > 1]
    lines, apart, rest = free[:1], free[1:3], free[3:]
    single = [n for n in axes if n not in at and dataset.sizes[n] == 1]
    part = part.isel({n: (dataset.sizes[n] - 1) // 2 for n in (*rest, *single)})
    part = part.isel({n: _select_evenly(dataset.sizes[n], MAX_SUMMARY_LINES) for n in lines})
    most = (
        MAX_SUMMARY_PANELS if len(apart) == 2 else (MAX_SUMMARY_PANELS[0] * MAX_SUMMARY_PANELS[1],)
    )
    # The shorter axis of the two is the one whose panels lie below each other.
    apart = apart[::-1]
    part = part.isel(
        {n: _select_evenly(dataset.sizes[n], m) for n, m in zip(apart, most, strict=False)}
    )
    fixed = {n: part[n].values.item() for n in (*at, *rest) if n in part.coords}
    note = "at " + " · ".join(
        f"{format_parameter(n)} {format_value(v, n)}" for n, v in fixed.items()
    )  # fmt: skip
    shown = part.drop_vars([n for n in (*at, *rest, *single) if n in part.coords])
    note = note if fixed else ""
    if apart:
        return draw_facets(shown, quantity, apart, legend, note=note)
    return draw_spectra(shown, quantity, None, {}, None, legend, None)


def _select_evenly(size: int, max_count: int) -> np.ndarray:
    """Return places evenly over an axis, both ends among them."""
    return np.unique(np.linspace(0, size - 1, min(size, max_count)).round().astype(int))
