"""Small multiples: spectra of a grid, with one panel per value of some parameters."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.plotting.annotations import annotate_figure
from splits.plotting.lines import PlotLines
from splits.plotting.nodes import draw_node_ticks, find_coarse_nodes, make_nodes_note
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    compute_axis_top,
    make_panel_title,
    make_subplots,
    use_style,
)

DEFAULT_COLUMNS = 4
"""Default number of columns; a parameter of up to `MAX_ROW_VALUES` values fills a row."""
MAX_ROW_VALUES = 6
_PANEL_HEIGHT_INCHES, _TITLE_LINE_INCHES = 1.25, 0.11
_RASTERIZED_ZORDER = -10.0
"""Drawing order of lines and bands, which SVG files contain as one image per panel."""


def draw_small_multiples(
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
        Output of an experiment over wavelength, one parameter whose values are lines, and
        `panel_dims`.
    quantity : sequence of str
        Quantities, each with a block of panels.
    panel_dims : sequence of str
        One or two parameters, see `splits.plotting.panels.choose_panel_parameters`.
    legend : str, optional
        Title of the legend or the colour bar; by default the first parameter.
    ylim : (low, high), optional
    note : str
        Note for the foot of the figure.
    """
    dims = [str(d) for d in dataset[quantity[0]].dims if d not in ("wavelength", *panel_dims)]
    lines = PlotLines(dataset, dims)
    last = dataset.sizes[panel_dims[-1]]
    columns = last if len(panel_dims) == 2 and last <= MAX_ROW_VALUES else DEFAULT_COLUMNS
    panel_points = list(itertools.product(*(dataset[d].values for d in panel_dims)))
    columns = min(columns, len(panel_points))
    titles = [make_panel_title(dict(zip(panel_dims, p, strict=True))) for p in panel_points]
    n_title_lines = max(title.count("\n") for title in titles) + 1
    rows = -(-len(panel_points) // columns) * len(quantity)
    nodes = find_coarse_nodes(dataset)
    with use_style():
        figure, panels = make_subplots(
            rows,
            columns,
            width=TWO_COLUMNS_INCHES,
            height=0.5 + (_PANEL_HEIGHT_INCHES + _TITLE_LINE_INCHES * n_title_lines) * rows,
            sharex=True,
            squeeze=False,
        )
        blocks = np.split(panels, len(quantity))
        for panels_of_quantity, name in zip(blocks, quantity, strict=True):
            top = ylim or (0.0, _compute_axis_top(dataset, name))
            for axes, panel_point, title in zip(
                panels_of_quantity.flat, panel_points, titles, strict=False
            ):
                labels = dict(zip(panel_dims, panel_point, strict=True))
                _draw_panel(axes, dataset.sel(labels), name, lines)
                draw_node_ticks(axes, nodes)
                axes.set_title(title)
                axes.set_ylim(top)
                axes.label_outer()
            for axes in panels_of_quantity.flat[len(panel_points) :]:
                axes.set_visible(False)
            for axes in panels_of_quantity[:, 0]:
                axes.set_ylabel(name)
        # The lowest panel of a column may be hidden.
        for column in panels.T:
            shown = [axes for axes in column if axes.get_visible()]
            shown[-1].tick_params(labelbottom=True)
            shown[-1].set_xlabel("wavelength (nm)")
        lines.add_legend(figure, list(panels.flat), legend, max_inset_entries=0)
        return annotate_figure(figure, panels.flat, note, make_nodes_note(nodes))


def _compute_axis_top(dataset: xr.Dataset, name: str) -> float:
    """Return the upper limit of the axis of all panels."""
    highest = float((dataset[name] + BAND_SIGMA * dataset[f"{name}_stderr"]).max())
    return compute_axis_top(highest, name)


def _draw_panel(axes: Axes, part: xr.Dataset, name: str, lines: PlotLines) -> None:
    axes.set_rasterization_zorder(0.0)
    x = part.wavelength.values
    rows = part.transpose(*lines.dims, "wavelength")
    values = rows[name].values.reshape(-1, x.size)
    errors = BAND_SIGMA * rows[f"{name}_stderr"].values.reshape(-1, x.size)
    for line, y, error in zip(lines.lines, values, errors, strict=True):
        style = line.to_plot_style() | {"lw": 0.7, "zorder": _RASTERIZED_ZORDER + line.zorder}
        axes.plot(x, y, **style)
        axes.fill_between(
            x, np.maximum(y - error, 0.0), y + error, color=line.colour, alpha=0.25, lw=0,
            zorder=_RASTERIZED_ZORDER,
        )  # fmt: skip
    axes.margins(x=0.01)
    axes.tick_params(labelsize=SMALL_FONT_PT)
    axes.spines[["top", "right"]].set_visible(False)
