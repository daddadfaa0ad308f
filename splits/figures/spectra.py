"""Spectra: a quantity over wavelength, one line per point of the grid."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.figures.style import BAND, colours, parameter_label, style, value_label

STYLES = ("-", "--", ":", "-.")
MATERIAL_COLOURS = {
    "ice": "#1f6fb4",
    "water": "#c8553d",
    "quartz": "#666666",
    "hematite": "#7b3294",
    "goethite": "#c79100",
    "magnetite": "#111111",
    "kaolinite": "#7fb069",
}
"""Materials that figures of refractive indices show; mixtures follow from them."""


def spectra(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("reflectance",),
    wavelength_nm: tuple[float, float] | None = None,
    at: Mapping[str, float | str] | None = None,
    measured: pd.DataFrame | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw spectra with bands of two standard errors.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment.
    quantity : sequence of str
        One panel each.
    wavelength_nm : (low, high), optional
        Part of the spectrum to show.
    at : mapping, optional
        Grid labels to hold fixed.
    measured : pandas.DataFrame, optional
        Columns ``wavelength_nm``, ``reflectance`` and optionally its ``_min`` and ``_max``.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    dataset = at_points(dataset, at or {})
    if wavelength_nm:
        dataset = dataset.sel(wavelength=slice(*wavelength_nm))
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    with style():
        lines = math.prod(dataset.sizes[d] for d in dims)
        width = 6.4 if lines <= 6 else 8.8
        figure, panels = plt.subplots(
            len(quantity), 1, figsize=(width, 3.9 * len(quantity)), squeeze=False, sharex=True
        )
        for axes, name in zip(panels[:, 0], quantity, strict=True):
            _lines(axes, dataset, name, dims)
            if measured is not None and name in measured:
                _measured(axes, measured, name)
            axes.set_ylabel(_label(dataset[name]))
            axes.set_ylim(ylim or (0.0, None))
            axes.margins(x=0.01)
            axes.spines[["top", "right"]].set_visible(False)
            entries = len(axes.get_legend_handles_labels()[0])
            if entries and axes is panels[0, 0]:
                # A long legend stands beside the curves, not on them.
                place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if entries > 6 else {}
                axes.legend(
                    title=legend or " · ".join(map(parameter_label, dims)) or None,
                    frameon=False,
                    **place,
                )
        panels[-1, 0].set_xlabel("wavelength (nm)")
        figure.tight_layout()
    return figure


def _lines(axes: Axes, dataset: xr.Dataset, name: str, dims: list[str]) -> None:
    combinations = list(itertools.product(*(dataset[d].values for d in dims)))
    # Colour tells the first parameter, the line's style all others.
    shades = colours(dataset.sizes[dims[0]], dims[0]) if dims else colours(1)
    for number, labels in enumerate(combinations):
        row, other = divmod(number, len(combinations) // len(shades))
        colour = shades[row]
        part = dataset.sel(dict(zip(dims, labels, strict=True)))
        x, y = part.wavelength.values, part[name].values
        error = BAND * part[f"{name}_stderr"].values
        text = " · ".join(map(value_label, labels)) or ("model" if not dims else None)
        # The first is what the others are compared with: it lies on top of them.
        axes.plot(
            x, y, color=colour, ls=STYLES[other % len(STYLES)], lw=1.4, label=text,
            zorder=2.0 + 1.0 / (1 + number),
        )  # fmt: skip
        axes.fill_between(x, np.maximum(y - error, 0.0), y + error, color=colour, alpha=0.25, lw=0)


def _measured(axes: Axes, table: pd.DataFrame, name: str) -> None:
    y = table[name]
    span = None
    if f"{name}_min" in table:
        span = np.stack([y - table[f"{name}_min"], table[f"{name}_max"] - y])
    axes.errorbar(
        table["wavelength_nm"], y, span, fmt="s", color="black", ms=4, capsize=3, label="measured"
    )


def _label(variable: xr.DataArray) -> str:
    return str(variable.attrs.get("long_name", variable.name))


def refractive_indices(dataset: xr.Dataset) -> Figure:
    """Draw n (left axis) and k (right axis, logarithmic) of the materials of `MATERIAL_COLOURS`.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``n`` and ``k`` over wavelength and material.
    """
    with style():
        figure, left = plt.subplots(figsize=(6.4, 3.9))
        right = left.twinx()
        for material, colour in MATERIAL_COLOURS.items():
            if material not in dataset.material.values:
                continue
            part = dataset.sel(material=material)
            left.plot(part.wavelength, part.n, color=colour, label=f"n, {material}")
            if float(part.k.max()) > 0.0:
                right.plot(part.wavelength, part.k, color=colour, ls="--", label=f"k, {material}")
        right.set_yscale("log")
        left.set_xlabel("wavelength (nm)")
        left.set_ylabel("refractive index n (solid)")
        right.set_ylabel("extinction coefficient k (dashed)")
        left.margins(x=0.01)
        lines = [*left.get_lines(), *right.get_lines()]
        left.legend(
            handles=lines, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4
        )
        figure.tight_layout()
    return figure
