"""Colour swatches: what a spectrum looks like under daylight."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.analysis.colour import colours
from splits.figures.style import parameter_label, style, subplots, value_label


def swatches(dataset: xr.Dataset) -> Figure:
    """Draw a patch of colour for every point of a grid of one or two parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over one grid parameter (columns), at most one more (rows), wavelength.

    Raises
    ------
    ValueError
        For a grid of more parameters.
    """
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
        figure, axes = subplots(figsize=(1.0 + 1.35 * columns, 0.9 + 0.75 * rows + 0.25))
        axes.imshow(np.swapaxes(patches, 0, 1), aspect="auto", interpolation="nearest")
        for i in range(columns):
            for j in range(rows):
                code = table["srgb"].iloc[i * rows + j]
                ink = "black" if light[i, j] > 50.0 else "white"
                axes.text(i, j, f"{code}\nL* {light[i, j]:.1f}", color=ink, fontsize=8,
                          ha="center", va="center")  # fmt: skip
        names = [value_label(v, dims[0]) for v in dataset[dims[0]].values]
        axes.set_xticks(range(columns), names, rotation=15 if columns > 3 else 0)
        if len(dims) == 2:
            axes.set_yticks(range(rows), [value_label(v, dims[1]) for v in dataset[dims[1]].values])
            axes.set_ylabel(parameter_label(dims[1]))
        else:
            axes.set_yticks([])
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        figure.tight_layout()
    return figure
