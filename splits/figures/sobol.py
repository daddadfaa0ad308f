"""Which wavelength tells what: Sobol indices along the spectrum."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.escaping import escape_mathtext
from splits.figures.notes import finished
from splits.figures.style import (
    BAND,
    ONE_COLUMN,
    SMALLEST,
    TWO_COLUMNS,
    colours,
    parameter_label,
    style,
    subplots,
)

_HEIGHT = 3.4


def sobol(indices: Mapping[str, xr.Dataset]) -> Figure:
    """Draw a panel for every table: first-order indices, total ones, and how much light varies.

    Parameters
    ----------
    found : mapping
        From what panels are called to what `splits.sobol_indices` returns.
    """
    with style():
        figure, panels = subplots(
            2, len(indices), width=TWO_COLUMNS if len(indices) > 1 else ONE_COLUMN, height=_HEIGHT,
            sharex="col", squeeze=False, gridspec_kw={"height_ratios": [2.4, 1.0]},
        )  # fmt: skip
        for column, (title, dataset) in enumerate(indices.items()):
            top, bottom = panels[:, column]
            x = dataset.wavelength.values
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, colours(len(names), "medium"), strict=True):
                own = dataset.sel(parameter=name)
                for key, dash in (("first_order", "-"), ("total", "--")):
                    value, error = own[key].values, BAND * own[f"{key}_stderr"].values
                    label = parameter_label(name) if dash == "-" else None
                    top.plot(x, value, color=colour, ls=dash, lw=1.1, label=label)
                    low, high = value - error, value + error
                    top.fill_between(x, low, high, color=colour, alpha=0.25, lw=0)
            bottom.plot(x, dataset.standard_deviation.values, color="black", lw=1.0)
            top.set_title(escape_mathtext(title))
            top.set_ylim(-0.03, 1.19)
            top.set_yticks(np.linspace(0.0, 1.0, 6))
            top.legend(frameon=False, fontsize=SMALLEST, ncols=2, loc="upper center")
            bottom.set_ylim(bottom=0.0)
            bottom.set_xlabel("wavelength (nm)")
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("share of the variance")
        panels[1, 0].set_ylabel("standard deviation\nof reflectance")
        note = (
            "Solid: what a parameter makes by itself (first-order Sobol index). Dashed: with all "
            "that it makes together with others (total). Bands: two standard errors of sampling."
        )
        return finished(figure, panels[0], note)
