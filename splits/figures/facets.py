"""Small multiples: spectra of a grid of several parameters, a panel for every value of some."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.figures.lines import FEW, Lines
from splits.figures.nodes import coarse_nodes, mark_nodes, nodes_note
from splits.figures.notes import finished
from splits.figures.style import (
    BAND,
    SMALLEST,
    TWO_COLUMNS,
    parameter_label,
    style,
    subplots,
    value_label,
)

COLUMNS = 4
"""Panels side by side, unless a parameter of up to `WIDEST` values has a row to itself."""
WIDEST = 6
_PANEL_INCHES = 1.35
_BELOW = -10.0
"""Lines and bands lie below all else, so that SVG files hold them as one image per panel."""


def faceted(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    panel_dims: Sequence[str],
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
    note: str = "",
) -> Figure:
    """Draw spectra with bands of two standard errors, a panel per value of some parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment, over wavelength, one parameter whose values are lines, and
        those of `apart`.
    quantity : sequence of str
        A block of panels each, one below the other.
    apart : sequence of str
        One or two parameters, see `splits.panels.facets`.
    legend : str, optional
        Title of the legend or the colour bar; the first parameter by default.
    ylim : (low, high), optional
    note : str
        For the foot.
    """
    dims = [str(d) for d in dataset[quantity[0]].dims if d not in ("wavelength", *panel_dims)]
    lines = Lines(dataset, dims)
    last = dataset.sizes[panel_dims[-1]]
    columns = last if len(panel_dims) == 2 and last <= WIDEST else COLUMNS
    places = list(itertools.product(*(dataset[d].values for d in panel_dims)))
    columns = min(columns, len(places))
    block = -(-len(places) // columns)
    rows = block * len(quantity)
    nodes = coarse_nodes(dataset)
    with style():
        figure, panels = subplots(
            rows, columns, width=TWO_COLUMNS, height=0.5 + _PANEL_INCHES * rows, sharex=True,
            squeeze=False,
        )  # fmt: skip
        for number, name in enumerate(quantity):
            part = panels[number * block : (number + 1) * block]
            top = ylim or (0.0, _highest(dataset, name))
            for axes, place in zip(part.flat, places, strict=False):
                at = dict(zip(panel_dims, place, strict=True))
                _panel(axes, dataset.sel(at), name, lines)
                mark_nodes(axes, nodes)
                axes.set_title(" · ".join(value_label(v, d) for d, v in at.items()))
                axes.set_ylim(top)
                axes.label_outer()
            for axes in part.flat[len(places) :]:
                axes.set_visible(False)
            for axes in part[:, 0]:
                axes.set_ylabel(name)
        # The lowest panel of a column may be a hidden one.
        for column in panels.T:
            shown = [axes for axes in column if axes.get_visible()]
            shown[-1].tick_params(labelbottom=True)
            shown[-1].set_xlabel("wavelength (nm)")
        panels_are = "panels: " + " · ".join(map(parameter_label, panel_dims))
        # A legend of few lines stands above the panels.
        above = not lines.has_colour_bar and len(lines.lines) <= FEW
        if not above:
            figure.suptitle(panels_are)
        lines.add_legend(figure, list(panels.flat), legend, max_inset_entries=0)
        return finished(figure, panels.flat, panels_are if above else "", note, nodes_note(nodes))


def _highest(dataset: xr.Dataset, name: str) -> float:
    """Return where the axis of all panels ends."""
    value = float((dataset[name] + BAND * dataset[f"{name}_stderr"]).max())
    return 1.05 * value if value > 0.0 else 1.0


def _panel(axes: Axes, part: xr.Dataset, name: str, lines: Lines) -> None:
    axes.set_rasterization_zorder(0.0)
    x = part.wavelength.values
    rows = part.transpose(*lines.dims, "wavelength")
    values = rows[name].values.reshape(-1, x.size)
    errors = BAND * rows[f"{name}_stderr"].values.reshape(-1, x.size)
    for one, y, error in zip(lines.lines, values, errors, strict=True):
        look = one.to_plot_style() | {"lw": 0.7, "zorder": _BELOW + one.zorder}
        axes.plot(x, y, **look)
        axes.fill_between(
            x, np.maximum(y - error, 0.0), y + error, color=one.colour, alpha=0.25, lw=0,
            zorder=_BELOW,
        )  # fmt: skip
    axes.margins(x=0.01)
    axes.tick_params(labelsize=SMALLEST)
    axes.spines[["top", "right"]].set_visible(False)
