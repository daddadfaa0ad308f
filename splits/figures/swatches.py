"""Colour swatches: what a spectrum looks like under daylight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.analysis.colour import colours
from splits.dataset import at_points
from splits.figures.conditions import conditions
from splits.figures.notes import finished
from splits.figures.style import (
    ONE_COLUMN,
    SMALLEST,
    TWO_COLUMNS,
    parameter_label,
    style,
    subplots,
    value_label,
)

_WIDE = 4
"""More patches of colour than these side by side take the width of two columns."""
_MOST = 9
"""More than these side by side have no numbers on them."""


def swatches(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw a patch of colour for every point of a grid of one or two parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over one grid parameter (columns), at most one more (rows), wavelength.
    at : mapping, optional
        Grid labels to hold fixed.

    Raises
    ------
    ValueError
        For a grid of more parameters.
    """
    dataset = at_points(dataset, at or {})
    dims = [str(d) for d in dataset.reflectance.dims if d != "wavelength"]
    if not 1 <= len(dims) <= 2:
        raise ValueError(f"figure.kind = 'swatches': must have one or two parameters, not {dims}")
    table = colours(dataset)
    columns = dataset.sizes[dims[0]]
    rows = dataset.sizes[dims[1]] if len(dims) == 2 else 1
    # The grid's first parameter varies slowest in the table.
    patches = table[["red", "green", "blue"]].to_numpy().reshape(columns, rows, 3)
    light = table["L"].to_numpy().reshape(columns, rows)
    with style():
        figure, axes = subplots(
            width=ONE_COLUMN if columns <= _WIDE else TWO_COLUMNS, height=0.5 + 0.4 * rows
        )
        axes.imshow(np.swapaxes(patches, 0, 1), aspect="auto", interpolation="nearest")
        for i in range(columns):
            for j in range(rows if columns <= _MOST else 0):
                code = table["srgb"].iloc[i * rows + j]
                ink = "black" if light[i, j] > 50.0 else "white"
                axes.text(i, j, f"{code}\nL* {light[i, j]:.1f}", color=ink, fontsize=SMALLEST,
                          ha="center", va="center")  # fmt: skip
        names = [value_label(v, dims[0]) for v in dataset[dims[0]].values]
        axes.set_xticks(range(columns), names, rotation=90 if columns > _MOST else 0)
        if len(dims) == 2:
            axes.set_yticks(range(rows), [value_label(v, dims[1]) for v in dataset[dims[1]].values])
            axes.set_ylabel(parameter_label(dims[1]))
        else:
            axes.set_yticks([])
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        return finished(figure, [axes], conditions(dataset, at, ""))
