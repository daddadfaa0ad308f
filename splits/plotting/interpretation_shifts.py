"""Panels of the shifts of curves from the one labelled ``default``."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.plotting.lines import draw_node_ticks, find_coarse_nodes, make_nodes_note
from splits.plotting.panels import DEFAULT_LABEL, MAX_PANELS
from splits.plotting.style import (
    BAND_SIGMA,
    NOMINAL_PARAMETERS,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    draw_curve,
    format_parameter,
    format_value,
    make_subplots,
    start_at_zero,
    use_style,
)

MAX_SHIFT_COLUMNS = 4
SHIFT_COLOUR = "#1f6fb4"
INDEPENDENCE_NOTE = (
    "errors of shifts assume independent runs, though they share some random numbers"
)
"""Note on errors of shifts: points of a grid have the same seed, but not the same rays."""
_PANEL_HEIGHT_INCHES = 1.2
_MAX_TITLE_CHARS = 22
"""Number of characters that fit above a panel."""


def find_default_dim(dataset: xr.Dataset, dims: Sequence[str]) -> str | None:
    """Return the only varying dimension if it has a value labelled ``default``, else None."""
    varying = [d for d in dims if dataset.sizes[d] > 1]
    if len(varying) != 1 or dataset.sizes[varying[0]] > MAX_PANELS:
        return None
    return varying[0] if DEFAULT_LABEL in map(str, dataset[varying[0]].values) else None


def compute_shift(dataset: xr.Dataset, name: str, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the shift of a quantity from its default along a dimension, and its standard error.

    The runs are assumed independent, see `INDEPENDENCE_NOTE`.
    """
    default = dataset.sel({dim: DEFAULT_LABEL})
    error = f"{name}_stderr"
    variance = dataset[error] ** 2 + default[error] ** 2
    return dataset[name] - default[name], variance**0.5


@use_style()
def draw_shifts(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    dim: str,
    axis_dim: str,
    labels: tuple[str, Sequence[str]],
    note: str = "",
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the curve of the default, and the shift of every other one from it, a panel each.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over `dim` and `axis_dim`; other dimensions have one value.
    quantity : sequence of str
        Quantities, each with a block of panels.
    dim : str
        See `find_default_dim`.
    axis_dim : str
        Dimension of the horizontal axis.
    labels : (str, sequence of str)
        Labels of the horizontal axis and of the quantities.
    note : str
        Note for the foot of the figure.
    ylim : (low, high), optional
        Limits of the panels of defaults; from 0 by default.
    """
    dataset = dataset.squeeze([d for d, n in dataset.sizes.items() if n == 1 and d in
                               dataset[quantity[0]].dims and d not in (dim, axis_dim)])  # fmt: skip
    others = [str(v) for v in dataset[dim].values if str(v) != DEFAULT_LABEL]
    columns = min(MAX_SHIFT_COLUMNS, 1 + len(others))
    rows_per_quantity = -(-(1 + len(others)) // columns)
    nodes = find_coarse_nodes(dataset) if axis_dim == "wavelength" else {}
    figure, panels = make_subplots(
        rows_per_quantity * len(quantity),
        columns,
        width=TWO_COLUMNS_INCHES,
        sharex=True,
        squeeze=False,
        height=0.4 + _PANEL_HEIGHT_INCHES * rows_per_quantity * len(quantity),
    )
    for number, (name, label) in enumerate(zip(quantity, labels[1], strict=True)):
        part = panels[number * rows_per_quantity : (number + 1) * rows_per_quantity].ravel()
        _draw_block(part, dataset, name, dim, axis_dim)
        part[0].set_ylabel(label)
        start_at_zero(part[0], name, ylim)
        for axes in part:
            draw_node_ticks(axes, nodes)
        for row in (
            part.reshape(rows_per_quantity, columns)[:, 0] if rows_per_quantity > 1 else part[1:2]
        ):
            if row is not part[0]:
                row.set_ylabel("shift")
    for column in panels.T:
        shown = [axes for axes in column if axes.get_visible()]
        shown[-1].tick_params(labelbottom=True)
        shown[-1].set_xlabel(labels[0])
    shift_note = f"Shifts: value minus that of the default in panel (a); {INDEPENDENCE_NOTE}."
    return annotate_figure(figure, panels.flat, note, shift_note, make_nodes_note(nodes))


def _draw_block(
    panels: np.ndarray, dataset: xr.Dataset, name: str, dim: str, axis_dim: str
) -> None:
    """Draw the default in the first panel, and the shifts of the others in the following ones."""
    x = dataset[axis_dim].values
    default = dataset.sel({dim: DEFAULT_LABEL})
    errors = default[f"{name}_stderr"].values
    draw_curve(panels[0], x, default[name].values, errors, color="black")
    panels[0].set_title("default")
    shift, error = compute_shift(dataset, name, dim)
    others = [v for v in dataset[dim].values if str(v) != DEFAULT_LABEL]
    limit = 1.05 * float((np.abs(shift) + BAND_SIGMA * error).max()) or 1.0
    for axes, other in zip(panels[1:], others, strict=False):
        selection = {dim: other}
        values, errors = shift.sel(selection).values, error.sel(selection).values
        draw_curve(axes, x, values, errors, color=SHIFT_COLOUR)
        axes.axhline(0.0, color="black", lw=0.6, zorder=1.5)
        axes.set_ylim(-limit, limit)
        # A line break may separate a dollar sign from its escape.
        value = format_value(other, dim)
        text = value if dim in NOMINAL_PARAMETERS else f"{format_parameter(dim)}: {value}"
        title = fill(text, _MAX_TITLE_CHARS).replace("\\\n$", "\n\\$")
        axes.set_title(title)
    for axes in panels[: 1 + len(others)]:
        axes.margins(x=0.01)
    for axes in panels[1 + len(others) :]:
        axes.set_visible(False)
