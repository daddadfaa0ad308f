"""Figure of colour swatches of spectra under daylight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.analysis.colour import make_colour_table
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.panels import MAX_COLUMNS, MAX_ROWS, check_count
from splits.plotting.style import (
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    format_parameter,
    format_value,
    make_subplots,
    use_style,
)

_MAX_NARROW_COLUMNS = 3
"""Largest number of columns of patches in a figure of one page column."""
_MAX_LABELLED_COLUMNS = 9
"""Largest number of columns of patches with numbers."""


def draw_swatches(dataset: xr.Dataset, select: Mapping[str, float | str] | None = None) -> Figure:
    """Draw a patch of colour for every point of a grid of one or two parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over one grid parameter (columns), at most one more (rows), wavelength.
    select : mapping, optional
        Grid labels to select.

    Raises
    ------
    ValueError
        For a grid with more parameters.
    """
    dataset = select_points(dataset, select or {})
    dims = [str(d) for d in dataset.reflectance.dims if d != "wavelength"]
    if not 1 <= len(dims) <= 2:
        raise invalid("grid", dims, "one or two parameters for figure.kind = 'swatches'")
    columns = dataset.sizes[dims[0]]
    rows = dataset.sizes[dims[1]] if len(dims) == 2 else 1
    check_count("columns of colours", columns, MAX_COLUMNS, select)
    check_count("rows of colours", rows, MAX_ROWS, select)
    table = make_colour_table(dataset)
    # The grid's first parameter varies slowest in the table.
    patches = table[["red", "green", "blue"]].to_numpy().reshape(columns, rows, 3)
    light = table["L"].to_numpy().reshape(columns, rows)
    with use_style():
        figure, axes = make_subplots(
            width=ONE_COLUMN_INCHES if columns <= _MAX_NARROW_COLUMNS else TWO_COLUMNS_INCHES,
            height=0.5 + 0.4 * rows,
        )
        axes.imshow(np.swapaxes(patches, 0, 1), aspect="auto", interpolation="nearest")
        for i in range(columns):
            for j in range(rows if columns <= _MAX_LABELLED_COLUMNS else 0):
                code = table["srgb"].iloc[i * rows + j]
                text_colour = "black" if light[i, j] > 50.0 else "white"
                axes.text(
                    i,
                    j,
                    f"{code}\nL* {light[i, j]:.1f}",
                    color=text_colour,
                    fontsize=SMALL_FONT_PT,
                    ha="center",
                    va="center",
                )
        names = [format_value(v, dims[0]) for v in dataset[dims[0]].values]
        axes.set_xticks(
            range(columns), names, rotation=90 if columns > _MAX_LABELLED_COLUMNS else 0
        )
        if len(dims) == 2:
            axes.set_yticks(
                range(rows), [format_value(v, dims[1]) for v in dataset[dims[1]].values]
            )
            axes.set_ylabel(format_parameter(dims[1]))
        else:
            axes.set_yticks([])
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        return annotate_figure(figure, [axes], describe_conditions(dataset, select, ""))
