"""Figure of the ratio of the scatter between seeds to stated errors."""

import pandas as pd
from matplotlib.figure import Figure

from splits.plotting.grammar import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    make_subplots,
    pick_colours,
    use_style,
)

SHADED_RATIOS = (0.85, 1.15)
"""Ratios of scatter to stated error that are shaded."""
ALL_LABEL = "all"


def draw_calibration(table: pd.DataFrame) -> Figure:
    """Draw the ratio of each instrument with its error bar, and faintly its single ratios.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``instrument``, ``medium``, ``quantity``, ``ratio`` and ``ratio_stderr``.  Rows with
        medium "all" are means over all media and quantities of an instrument; of the others, rows
        with quantity "all" are not shown.
    """
    means = table[table.medium == ALL_LABEL]
    names = list(means.instrument)
    single_rows = table[(table.medium != ALL_LABEL) & (table.quantity != ALL_LABEL)]
    marker_colour, faint_colour = pick_colours(2, "sample")
    with use_style():
        figure, axes = make_subplots(height=1.3 + 0.3 * len(names), width=TWO_COLUMNS_INCHES)
        axes.axvspan(*SHADED_RATIOS, color="0.92", zorder=0)
        axes.axvline(1.0, color="0.5", lw=0.8, zorder=1)
        axes.plot(
            single_rows.ratio, single_rows.instrument.map(names.index), "|", color=faint_colour,
            ms=8, ls="none", label="one group of quantities",
        )  # fmt: skip
        axes.errorbar(
            means.ratio, range(len(names)), xerr=BAND_SIGMA * means.ratio_stderr, fmt="o",
            color=marker_colour, capsize=3, label="all of an instrument",
        )  # fmt: skip
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set_xlabel("scatter between seeds over stated error")
        figure.legend(frameon=False, ncols=2, loc="outside lower center")
    return figure
