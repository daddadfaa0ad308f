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
from splits.figures.lines import DEFAULT, Lines, beside
from splits.figures.style import BAND, colours, parameter_label, style, subplots, value_label


def points(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("reflectance",),
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw quantities over the points of a grid, a panel each and one series per wavelength.

    Dashed lines go through the point labelled ``default``, which the others are read against.

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
    alone = [map(str, v) for v in combinations if len(v) == 1]
    default = next((i for i, v in enumerate(alone) if DEFAULT in v), None)
    series = Lines(dataset, ["wavelength"])
    with style():
        figure, panels = subplots(
            1, len(quantity), figsize=(2.8 + 3.6 * len(quantity), 1.6 + 0.32 * len(names)),
            sharey=True, squeeze=False, layout="constrained",
        )  # fmt: skip
        for axes, name in zip(panels[0], quantity, strict=True):
            about = dataset[name].attrs
            if "wavelength" in dataset[name].dims:
                _series(axes, dataset, name, series, default)
                axes.set_xlabel(str(about.get("long_name", name)))
            else:
                _lengths(axes, 1e3 * dataset[name].values.ravel())
                axes.set_xlabel(f"{about.get('long_name', name)} (mm)")
            axes.grid(axis="x", alpha=0.3)
            axes.margins(y=0.08)
            axes.spines[["top", "right"]].set_visible(False)
        first = panels[0, 0]
        first.set_yticks(range(len(names)), names)
        first.set_ylabel(legend or " · ".join(map(parameter_label, dims)))
        first.invert_yaxis()
        handles: list[Artist] = []
        for axes in panels[0]:
            handles = handles or axes.get_legend_handles_labels()[0]
        if series.bar and handles:
            series.legend(figure, list(panels[0]))
        elif len(handles) > 1:
            beside(figure, handles, series.title())
    return figure


def _series(axes: Axes, dataset: xr.Dataset, name: str, series: Lines, default: int | None) -> None:
    """Draw the values of all points at every wavelength."""
    for one in series.all:
        part = dataset.sel(one.labels)
        value = part[name].values.ravel()
        axes.errorbar(
            value, range(value.size), xerr=BAND * part[f"{name}_stderr"].values.ravel(),
            fmt="o", color=one.colour, capsize=3, label=one.text,
        )  # fmt: skip
        if default is not None:
            # All others are read against it.
            axes.axvline(value[default], color="black", lw=0.8, ls="--", zorder=1.0)


def _lengths(axes: Axes, value: np.ndarray) -> None:
    """Draw lengths, which have no error, with their numbers."""
    rows = range(value.size)
    axes.plot(value, rows, "o", color=colours(1)[0])
    for x, y in zip(value, rows, strict=True):
        axes.annotate(f"{x:.3f}", (x, y), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set_xlim(0, 1.15 * value.max())
