"""How the lines of a figure are told apart, and the legend that says so."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from splits.plotting.panels import DEFAULT_LABEL
from splits.plotting.style import (
    NOMINAL_PARAMETERS,
    TWO_COLUMNS_INCHES,
    Colour,
    Dash,
    format_parameter,
    format_value,
    pick_colours,
)

DASHES: tuple[Dash, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)))
MAX_INSET_ENTRIES = 6
"""Up to so many lines have an entry each and may have their legend on the axes."""
MAX_COLOUR_ENTRIES = 10
"""More values of an ordered parameter than these are told by a colour bar."""
_LEGEND_ENTRY_INCHES = 0.145
_MAX_LEGEND_FRACTION = 0.4
"""Part of the figure's width that a legend beside it may take, if more height can spare it that."""


class PlotLine(NamedTuple):
    """One line of a figure: its point of the grid and its look."""

    labels: dict[str, Any]
    label: str
    colour: Colour
    dash: Dash
    is_default: bool
    zorder: float

    def to_plot_style(self) -> dict[str, Any]:
        """Return the look as keywords of `matplotlib.axes.Axes.plot`."""
        return {
            "color": self.colour, "ls": self.dash, "lw": 1.4 if self.is_default else 1.0,
            "zorder": self.zorder,
        }  # fmt: skip


class PlotLines:
    """The lines of a figure over some dimensions of a dataset.

    Colour tells the first dimension that varies and the dash all others; with more others than
    dashes, colour tells the longest.

    Parameters
    ----------
    dataset : xarray.Dataset
    dims : sequence of str
    dashed : bool
        Whether dashes, too, tell few lines over one dimension, which may lie on each other.
    """

    def __init__(self, dataset: xr.Dataset, dims: Sequence[str], use_dashes: bool = False) -> None:
        self.dims = list(dims)
        self._values = {d: dataset[d].values for d in dims}
        sizes = {d: dataset.sizes[d] for d in dims}
        count = math.prod(sizes.values())
        several = [d for d in dims if sizes[d] > 1]
        # What the others are read against is told by colour.
        marked = [d for d in several if DEFAULT_LABEL in map(str, self._values[d])]
        self.colour_dim = next(iter([*marked, *several]), "")
        if self.colour_dim and count // sizes[self.colour_dim] > len(DASHES):
            self.colour_dim = max(sizes, key=lambda d: sizes[d])
        others = count // sizes.get(self.colour_dim, 1)
        named = self._is_nominal(self.colour_dim)
        # Colours of names repeat after a while, and dashes cannot tell both.
        repeats = named and others > 1 and sizes[self.colour_dim] > MAX_COLOUR_ENTRIES
        crowded = others > len(DASHES) or repeats
        if crowded:
            # Every line has a colour and an entry of its own.
            self.colour_dim, named = "", False
        self.dash_dims = [d for d in dims if d != self.colour_dim and sizes[d] > 1 and not crowded]
        values = self._values.get(self.colour_dim, np.zeros(count if crowded else 1))
        self.colours = _assign_colours(values, self.colour_dim if named else None)
        self.has_colour_bar = len(values) > MAX_COLOUR_ENTRIES and not named and not crowded
        looks = list(np.ndindex(*(sizes[d] for d in self.dash_dims)))
        self.lines: list[PlotLine] = []
        for place in np.ndindex(*sizes.values()):
            at = dict(zip(dims, place, strict=True))
            row = len(self.lines) if crowded else at.get(self.colour_dim, 0)
            turn = row if crowded else looks.index(tuple(at[d] for d in self.dash_dims))
            if use_dashes and not self.dash_dims and len(values) <= 4:
                turn = row
            elif named and not self.dash_dims:
                turn += row // MAX_COLOUR_ENTRIES
            labels = {d: self._values[d][i] for d, i in at.items()}
            default = str(labels.get(self.colour_dim)) == DEFAULT_LABEL
            # The first is what the others are compared with: it lies on top of them.
            zorder = 4.0 if default else 2.0 + 1.0 / (1 + len(self.lines))
            text = " · ".join(format_value(v, d) for d, v in labels.items())
            dash = DASHES[turn % len(DASHES)]
            self.lines.append(PlotLine(labels, text, self.colours[row], dash, default, zorder))

    def _is_nominal(self, dim: str) -> bool:
        return dim in NOMINAL_PARAMETERS and not np.issubdtype(self._values[dim].dtype, np.number)

    def make_title(self) -> str:
        """Return the names of the dimensions."""
        return " · ".join(map(format_parameter, self.dims))

    def add_legend(
        self,
        figure: Figure,
        axes: Sequence[Axes],
        title: str | None = None,
        max_inset_entries: int = MAX_INSET_ENTRIES,
        extra_handles: Sequence[Artist] = (),
    ) -> None:
        """Say which line is which: on the first axes where it covers nothing, above, or beside all.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            With constrained layout, to make room.
        axes : sequence of matplotlib.axes.ParameterGrid
            Those that show the lines.
        make_title : str, optional
            The dimensions' names by default.
        max_inset_entries : int
            Largest number of entries on the axes.
        extra_handles : sequence of artists
            With labels of their own, beside the lines'.
        """
        if not self.dims and not extra_handles:
            return
        if self.has_colour_bar:
            self._add_colour_bar(figure, axes, title)
        handles = [*self._make_handles(title), *extra_handles]
        split = len(self.lines) > MAX_INSET_ENTRIES and bool(self.dash_dims)
        head = None if split or self.has_colour_bar else title or self.make_title() or None
        if not handles:
            return
        if len(handles) <= max_inset_entries and not self.has_colour_bar:
            for panel in axes:
                legend = panel.legend(handles=handles, title=head, frameon=False)
                if not is_covering_line(legend, panel):
                    return
                legend.remove()
        if len(handles) <= MAX_INSET_ENTRIES and not self.has_colour_bar:
            place_legend_above(figure, handles, head)
        else:
            place_legend_beside(figure, handles, head)

    def _make_handles(self, title: str | None) -> list[Artist]:
        """Return an entry per line, or of many lines per value of each parameter."""
        if len(self.lines) <= MAX_INSET_ENTRIES or not self.dash_dims:
            if self.has_colour_bar:
                return []
            return [
                Line2D([], [], label=one.label or "model", **one.to_plot_style())
                for one in self.lines
            ]
        handles: list[Artist] = []
        if not self.has_colour_bar:
            handles.append(_make_heading(title or format_parameter(self.colour_dim)))
            for value, shade in zip(self._values[self.colour_dim], self.colours, strict=True):
                text = format_value(value, self.colour_dim)
                handles.append(Line2D([], [], color=shade, lw=1.4, label=text))
        handles.append(_make_heading(" · ".join(map(format_parameter, self.dash_dims))))
        for number, one in enumerate(
            itertools.product(*(self._values[d] for d in self.dash_dims))
        ):  # fmt: skip
            text = " · ".join(format_value(v, d) for d, v in zip(self.dash_dims, one, strict=True))
            dash = DASHES[number % len(DASHES)]
            handles.append(Line2D([], [], color="0.15", lw=1.0, ls=dash, label=text))
        return handles

    def _add_colour_bar(self, figure: Figure, axes: Sequence[Axes], title: str | None) -> None:
        count = len(self.colours)
        norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
        ticks = np.arange(0, count, -(-count // MAX_COLOUR_ENTRIES))
        places = [panel.get_subplotspec() for panel in axes]
        rows = len({place.rowspan.start for place in places if place is not None})
        bar = figure.colorbar(
            ScalarMappable(norm, ListedColormap(self.colours)), ax=list(axes), ticks=ticks,
            aspect=20 * rows, label=title or format_parameter(self.colour_dim), pad=0.02,
        )  # fmt: skip
        bar.ax.set_yticklabels(
            [format_value(self._values[self.colour_dim][i], self.colour_dim) for i in ticks]
        )
        bar.ax.minorticks_off()


def _assign_colours(values: np.ndarray, parameter: str | None) -> list[Colour]:
    """Return a colour per value: black for the default."""
    coloured = [v for v in values if str(v) != DEFAULT_LABEL]
    shades = iter(pick_colours(len(coloured), parameter))
    return ["black" if str(v) == DEFAULT_LABEL else next(shades) for v in values]


def _make_heading(text: str) -> Line2D:
    return Line2D([], [], ls="none", label=text)


def is_covering_line(legend: Legend, axes: Axes) -> bool:
    """Return whether a legend lies on a line of its axes."""
    figure = axes.get_figure()
    assert figure is not None
    figure.draw_without_rendering()  # type: ignore[union-attr]
    box = legend.get_window_extent()
    for line in axes.lines:
        path = line.get_transform().transform_path(line.get_path())
        if path.intersects_bbox(box, filled=False):
            return True
    return False


def place_legend_above(figure: Figure, handles: Sequence[Artist], title: str | None) -> None:
    """Put a legend of few entries above all axes; the figure grows by its height.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout.
    handles : sequence of artists
    title : str or None
    """
    if not handles:
        return
    for columns in range(len(handles), 0, -1):
        legend = figure.legend(
            handles=list(handles), title=title, frameon=False, loc="outside upper center",
            ncols=columns,
        )  # fmt: skip
        box = legend.get_window_extent()
        if columns == 1 or box.width < figure.bbox.width:
            break
        legend.remove()
    figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)


def place_legend_beside(figure: Figure, handles: Sequence[Artist], title: str | None) -> None:
    """Put a legend to the right of all axes; the figure is two columns wide from now on.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout; it grows in height for a legend that would take too much width.
    handles : sequence of artists
    title : str or None
    """
    figure.set_figwidth(TWO_COLUMNS_INCHES)
    if not handles:
        return
    rows = max(1, int(figure.get_figheight() / _LEGEND_ENTRY_INCHES) - 2)
    for columns in range(-(-len(handles) // rows), 0, -1):
        legend = figure.legend(
            handles=list(handles), title=title, frameon=False, loc="outside right upper",
            ncols=columns,
        )  # fmt: skip
        box = legend.get_window_extent()
        if columns == 1 or box.width < _MAX_LEGEND_FRACTION * figure.bbox.width:
            break
        legend.remove()
    figure.set_figheight(max(figure.get_figheight(), box.height / figure.dpi + 0.1))
