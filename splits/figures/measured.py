"""Measured against modelled spectra."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from splits.figures.notes import finished
from splits.figures.style import BAND, TWO_COLUMNS, colours, style, subplots, value_label


def measured_albedo(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw measured and modelled albedo, one panel per depth, and their difference below.

    Parameters
    ----------
    table : pandas.DataFrame
        See `splits.analysis.measured.letcher_bands`.
    note : str
        For the foot, see `splits.figures.conditions.conditions`.
    """
    depths = sorted(table.depth_m.unique(), reverse=True)
    with style():
        figure, panels = subplots(
            2, len(depths), width=TWO_COLUMNS, height=3.9, sharex=True, sharey="row",
            gridspec_kw={"height_ratios": [2, 1]},
        )  # fmt: skip
        for column, depth in enumerate(depths):
            top, bottom = panels[:, column]
            part = table[table.depth_m == depth]
            groups = list(part.groupby("snow", sort=False))
            for (snow, rows), colour in zip(groups, colours(len(groups), "medium"), strict=True):
                x, error = rows.wavelength_nm, BAND * rows.stderr
                top.errorbar(x, rows.model, error, color=colour, label=value_label(snow))
                bottom.errorbar(x, rows.difference, error, color=colour)
            first = groups[0][1]
            top.plot(first.wavelength_nm, first.measured, "ks", ms=2.5, label="measured")
            bottom.axhline(0, color="black", lw=0.6)
            top.set_title(f"{1e3 * depth:g} mm" + (" over black" if depth < 0.1 else ""))
            top.set_ylim(0, 1.05)
            bottom.set_xlabel("wavelength (nm)")
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("albedo")
        panels[1, 0].set_ylabel("model − measured")
        panels[0, 1].legend(frameon=False)
        return finished(figure, panels.flat, note)
