"""Figures of spectra and albedos of snowpacks over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.style import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)

MAX_WAVELENGTHS = 4
"""Largest number of wavelengths, of which the first and the last are shown."""


def draw_season(dataset: xr.Dataset, quantity: Sequence[str] = ("reflectance",)) -> Figure:
    """Draw band albedos, or spectra at some wavelengths, over time or another label of snowpacks.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.albedo` or `splits.spectrophotometer` for `splits.SnowPacks`.
    quantity : sequence of str
        Quantities of spectra, a panel each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = ["band_albedo"] if "band_albedo" in dataset else list(quantity)
    (label,) = dataset.quality_flag.dims
    index = dataset.get_index(label)
    are_numbers = index.dtype.kind in "fiuM" and not isinstance(index, pd.MultiIndex)
    x = index.values if are_numbers else np.arange(index.size)
    with use_style():
        figure, panels = make_subplots(
            len(names), 1, width=TWO_COLUMNS_INCHES, height=2.4 * len(names), squeeze=False,
            sharex=True,
        )  # fmt: skip
        for axes, name in zip(panels[:, 0], names, strict=True):
            line_dim = str(dataset[name].dims[-1])
            n_lines = dataset.sizes[line_dim]
            rows = np.linspace(0, n_lines - 1, min(n_lines, MAX_WAVELENGTHS)).round().astype(int)
            rows = np.arange(n_lines) if line_dim == "band" else np.unique(rows)
            for row, colour in zip(rows, pick_colours(len(rows), line_dim), strict=True):
                part = dataset.isel({line_dim: row})
                y, error = part[name].values, BAND_SIGMA * part[f"{name}_stderr"].values
                axes.plot(x, y, color=colour, label=format_value(part[line_dim].values.item()))
                axes.fill_between(x, y - error, y + error, color=colour, alpha=0.25, lw=0)
            axes.set_ylabel("albedo" if name == "band_albedo" else name)
            axes.set_ylim(0.0, None)
            axes.legend(title="wavelength (nm)" if line_dim == "wavelength" else None)
        if index.dtype.kind == "M":
            locator = AutoDateLocator()
            panels[-1, 0].xaxis.set_major_locator(locator)
            panels[-1, 0].xaxis.set_major_formatter(ConciseDateFormatter(locator))
        panels[-1, 0].set_xlabel(str(label))
        return annotate_figure(figure, panels.flat, describe_conditions(dataset))
