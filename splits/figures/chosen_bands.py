"""Which bands to measure: what each tells more, and what is left unknown."""

from __future__ import annotations

from collections.abc import Mapping

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

_HEIGHT = 4.2


def chosen_bands(selections: Mapping[str, xr.Dataset], conditions: str = "") -> Figure:
    """Draw a column for every table: information by the number of bands, and what is left.

    Parameters
    ----------
    found : mapping
        From what columns are called to what `splits.best_bands` returns.
    known : str
        Of noise, and of what is known, for the foot.
    """
    with style():
        figure, panels = subplots(
            2, len(selections), width=TWO_COLUMNS if len(selections) > 1 else ONE_COLUMN, height=_HEIGHT,
            sharex="col", squeeze=False,
        )  # fmt: skip
        for column, (title, dataset) in enumerate(selections.items()):
            top, bottom = panels[:, column]
            x, bits = dataset.step.values, dataset.information_bits.values
            (blue,) = colours(1)
            top.bar(x, bits, color=blue, alpha=0.5)
            top.errorbar(x, bits, BAND * dataset.information_bits_stderr.values, fmt="none",
                         color="black", lw=0.8)  # fmt: skip
            top.set_title(escape_mathtext(title))
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, colours(len(names), "medium"), strict=True):
                left = dataset.spread.sel(parameter=name).values
                bottom.plot(x, left, "o-", color=colour, ms=3, lw=1.0, label=parameter_label(name))
            bottom.set_ylim(0.0, 1.05)
            bands = [f"+ {escape_mathtext(str(band))}" for band in dataset.band.values]
            bottom.set_xticks(x, bands, rotation=45)
            for label in bottom.get_xticklabels():
                label.set_horizontalalignment("right")
            bottom.legend(frameon=False, fontsize=SMALLEST)
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("information (bits)")
        panels[1, 0].set_ylabel("spread left,\nas a part of that before")
        note = (
            "Bands from left to right, each the one that adds most to those before it, in the mean "
            "over the ranges of the table. Error bars: two standard errors of that mean."
        )
        note += f" {escape_mathtext(conditions.replace('_', ' '))}." if conditions else ""
        return finished(figure, panels[0], note)
