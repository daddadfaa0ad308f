"""Values at a few points of a grid, with error bars."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.figures.style import BAND, colours, parameter_label, style, value_label


def points(
    dataset: xr.Dataset,
    quantity: str = "reflectance",
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw a quantity over the points of a grid, one series per wavelength.

    Of grains at a single wavelength the mean distance is shown instead: it has no spectrum to speak
    of.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment.
    quantity : str
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        What the grid is over; its parameters by default.
    """
    dataset = at_points(dataset, at or {})
    dims = [str(d) for d in dataset[quantity].dims if d != "wavelength"]
    combinations = list(itertools.product(*(dataset[d].values for d in dims)))
    names = [" · ".join(value_label(value) for value in values) for values in combinations]
    with style():
        figure, axes = plt.subplots(figsize=(6.4, 1.6 + 0.32 * len(names)))
        rows = np.arange(len(names))
        if dataset.sizes["wavelength"] == 1 and "mean_grain_distance" in dataset:
            value = 1e3 * dataset.mean_grain_distance.values.ravel()
            axes.plot(value, rows, "o", color=colours(1)[0])
            for x, y in zip(value, rows, strict=True):
                axes.annotate(
                    f"{x:.3f}", (x, y), xytext=(8, 0), textcoords="offset points", va="center"
                )
            axes.set_xlabel("mean distance between grains (mm)")
            axes.set_xlim(0, 1.15 * value.max())
        else:
            shades = colours(dataset.sizes["wavelength"])
            for wavelength, colour in zip(dataset.wavelength.values, shades, strict=True):
                part = dataset.sel(wavelength=wavelength)
                axes.errorbar(
                    part[quantity].values.ravel(),
                    rows,
                    xerr=BAND * part[f"{quantity}_stderr"].values.ravel(),
                    fmt="o",
                    color=colour,
                    capsize=3,
                    label=f"{wavelength:g} nm",
                )
            axes.set_xlabel(str(dataset[quantity].attrs.get("long_name", quantity)))
            if len(shades) > 1:
                axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.4, 1.12), ncols=3)
        axes.set_yticks(rows, names)
        axes.set_ylabel(legend or " · ".join(map(parameter_label, dims)))
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3)
        axes.margins(y=0.08)
        axes.spines[["top", "right"]].set_visible(False)
        figure.tight_layout()
    return figure
