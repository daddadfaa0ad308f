"""How far curves lie from one that is labelled ``default``: a panel for each."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.plotting.annotations import annotate_figure
from splits.plotting.nodes import draw_node_ticks, find_coarse_nodes, make_nodes_note
from splits.plotting.panels import DEFAULT_LABEL, MAX_PANELS
from splits.plotting.style import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    format_value,
    make_subplots,
    use_style,
)

MAX_SHIFT_COLUMNS = 4
SHIFT_COLOUR = "#1f6fb4"
INDEPENDENCE_NOTE = (
    "errors of shifts take both runs as independent, though they share some random numbers"
)
"""What errors of shifts are: points of a grid have the same seed, but not the same rays."""
_PANEL_HEIGHT_INCHES = 1.2
_MAX_TITLE_CHARS = 22
"""Letters that fit above a panel."""


def find_default_dim(dataset: xr.Dataset, dims: Sequence[str]) -> str | None:
    """Return the dimension that alone varies and has a value labelled ``default``, if any."""
    several = [d for d in dims if dataset.sizes[d] > 1]
    if len(several) != 1 or dataset.sizes[several[0]] > MAX_PANELS:
        return None
    return several[0] if DEFAULT_LABEL in map(str, dataset[several[0]].values) else None


def compute_shift(dataset: xr.Dataset, name: str, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return how far a quantity lies from its default along a dimension, and the standard error.

    The runs are taken as independent, see `INDEPENDENCE_NOTE`.
    """
    default = dataset.sel({dim: DEFAULT_LABEL})
    error = f"{name}_stderr"
    square = dataset[error] ** 2 + default[error] ** 2
    return dataset[name] - default[name], square**0.5


def draw_shifts(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    dim: str,
    axis_dim: str,
    labels: tuple[str, Sequence[str]],
    note: str = "",
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the default's curve, and how far each other one lies from it, a panel each.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over `dim` and `axis_dim`, other dimensions have one value.
    quantity : sequence of str
        A block of panels each, one below the other.
    dim : str
        See `find_default_dim`.
    axis_dim : str
        Dimension of the horizontal axis.
    labels : (str, sequence of str)
        Of the horizontal axis, and of the quantities.
    note : str
        For the foot.
    ylim : (low, high), optional
        Of the panels of defaults; from zero if there is none.
    """
    dataset = dataset.squeeze([d for d, n in dataset.sizes.items() if n == 1 and d in
                               dataset[quantity[0]].dims and d not in (dim, axis_dim)])  # fmt: skip
    others = [str(v) for v in dataset[dim].values if str(v) != DEFAULT_LABEL]
    columns = min(MAX_SHIFT_COLUMNS, 1 + len(others))
    block = -(-(1 + len(others)) // columns)
    nodes = find_coarse_nodes(dataset) if axis_dim == "wavelength" else {}
    with use_style():
        figure, panels = make_subplots(
            block * len(quantity), columns, width=TWO_COLUMNS_INCHES, sharex=True, squeeze=False,
            height=0.4 + _PANEL_HEIGHT_INCHES * block * len(quantity),
        )  # fmt: skip
        for number, (name, words) in enumerate(zip(quantity, labels[1], strict=True)):
            part = panels[number * block : (number + 1) * block].ravel()
            _draw_block(part, dataset, name, dim, axis_dim)
            part[0].set_ylabel(words)
            part[0].set_ylim(ylim or (0.0, None))
            for axes in part:
                draw_node_ticks(axes, nodes)
                axes.spines[["top", "right"]].set_visible(False)
            for row in part.reshape(block, columns)[:, 0] if block > 1 else part[1:2]:
                if row is not part[0]:
                    row.set_ylabel("shift")
        for column in panels.T:
            shown = [axes for axes in column if axes.get_visible()]
            shown[-1].tick_params(labelbottom=True)
            shown[-1].set_xlabel(labels[0])
        told = f"Shifts: value minus the default's, which panel (a) shows; {INDEPENDENCE_NOTE}."
        return annotate_figure(figure, panels.flat, note, told, make_nodes_note(nodes))


def _draw_block(
    panels: np.ndarray, dataset: xr.Dataset, name: str, dim: str, axis_dim: str
) -> None:
    """Draw a quantity's default in the first panel and the shifts of the others in the rest."""
    x = dataset[axis_dim].values
    default = dataset.sel({dim: DEFAULT_LABEL})
    _draw_curve(panels[0], x, default[name].values, default[f"{name}_stderr"].values, "black")
    panels[0].set_title("default")
    shift, error = compute_shift(dataset, name, dim)
    others = [v for v in dataset[dim].values if str(v) != DEFAULT_LABEL]
    reach = 1.05 * float((np.abs(shift) + BAND_SIGMA * error).max()) or 1.0
    for axes, other in zip(panels[1:], others, strict=False):
        at = {dim: other}
        _draw_curve(axes, x, shift.sel(at).values, error.sel(at).values, SHIFT_COLOUR)
        axes.axhline(0.0, color="black", lw=0.6, zorder=1.5)
        axes.set_ylim(-reach, reach)
        # A line may end between a dollar sign and what escapes it.
        title = fill(format_value(other, dim), _MAX_TITLE_CHARS).replace("\\\n$", "\n\\$")
        axes.set_title(title)
    for axes in panels[1 + len(others) :]:
        axes.set_visible(False)


def _draw_curve(axes: Axes, x: np.ndarray, y: np.ndarray, error: np.ndarray, colour: str) -> None:
    axes.plot(x, y, color=colour)
    axes.fill_between(
        x, y - BAND_SIGMA * error, y + BAND_SIGMA * error, color=colour, alpha=0.3, lw=0
    )
    axes.margins(x=0.01)
