"""Bars of the mean sensitivity index."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.escaping import escape_mathtext
from splits.figures.notes import finished
from splits.figures.style import BAND, colours, style, subplots


def sensitivity_bars(dataset: xr.Dataset, note: str = "") -> Figure:
    """Draw the mean sensitivity index of each parameter, ours and, where there are, published ones.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``msi``, ``msi_stderr`` and optionally ``published`` over ``quantity`` and
        ``parameter``.
    note : str
        For the foot, such as `splits.analysis.sensitivity_tables.ranges_said`.
    """
    with style():
        figure, axes = subplots(height=2.5)
        x = np.arange(dataset.sizes["parameter"])
        width = 0.36
        for i, quantity in enumerate(dataset.quantity.values):
            part = dataset.sel(quantity=quantity)
            at = x + (i - 0.5) * width
            colour = colours(2, "sample")[i]
            axes.bar(at, part.msi, width, color=colour, alpha=0.85, label=str(quantity))
            axes.errorbar(
                at, part.msi, BAND * part.msi_stderr, fmt="none", ecolor="black", elinewidth=0.8
            )
            if "published" in part:
                axes.plot(
                    at, part.published, "D", color="white", mec="black", mew=0.7, ms=4, ls="none",
                    label="published" if i == 0 else None,
                )  # fmt: skip
        names = [str(p).replace("_", " ") for p in dataset.parameter.values]
        axes.set_xticks(x, list(map(escape_mathtext, names)))
        axes.set_ylabel("mean sensitivity index")
        axes.set_ylim(0, 1.05)
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(
            *axes.get_legend_handles_labels(), frameon=False, ncols=3, loc="outside upper center"
        )
        errors = f"Bars of errors: {BAND:g} standard errors."
        return finished(figure, [axes], " ".join([escape_mathtext(note), errors]).strip())
