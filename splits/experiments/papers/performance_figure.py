"""Figure of error against computing time for several methods and media."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from splits.experiments.papers.performance import METHODS, SCALED, THEORIES
from splits.plotting.annotations import annotate_figure
from splits.plotting.lines import place_legend_above
from splits.plotting.style import TWO_COLUMNS_INCHES, Colour, make_subplots, pick_colours, use_style

METHOD_MARKERS = ("s", "D", "v", "^", "o", "P", "X")
THEORY_GREYS = ("0.15", "0.5")
"""Greys of the theories, which are other models."""
MAX_COLUMNS = 2


def draw_speed_against_error(table: pd.DataFrame) -> Figure:
    """Draw the error of methods against their time, one panel per medium.

    Filled markers are measured, open ones scaled from another error.  The error is the largest
    stated standard error; for theories, the largest deviation from the reference.

    Parameters
    ----------
    table : pandas.DataFrame
        Output of `benchmarks/speed_against_error.py`.
    """
    media = list(dict.fromkeys(table.medium))
    columns = min(MAX_COLUMNS, len(media))
    rows = -(-len(media) // columns)
    colours: list[Colour] = [*pick_colours(len(METHODS) - len(THEORIES), "sample"), *THEORY_GREYS]
    styles = dict(zip(METHODS, zip(colours, METHOD_MARKERS, strict=True), strict=True))
    with use_style():
        figure, panels = make_subplots(
            rows, columns, width=TWO_COLUMNS_INCHES, height=2.6 * rows, sharex=True, sharey=True,
            squeeze=False,
        )  # fmt: skip
        for medium, axes in zip(media, panels.flat, strict=False):
            _draw_medium(axes, table[table.medium == medium], styles)
            axes.set_title(medium)
        for axes in panels.flat[len(media) :]:
            axes.set_visible(False)
        for axes in panels[-1]:
            axes.set_xlabel("time on one core (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("largest error")
        shown = [name for name in METHODS if (table.method == name).any()]
        handles = [
            Line2D(
                [], [], color=styles[name][0], marker=styles[name][1],
                ls="none" if name in THEORIES else "-", label=_format_method(name),
            )
            for name in shown
        ]  # fmt: skip
        scaled = Line2D([], [], color="0.3", marker="o", mfc="white", ls="none", label="scaled")
        place_legend_above(figure, [*handles, scaled], None)
        return annotate_figure(figure, panels.flat)


def _format_method(method: str) -> str:
    """Return the label of a method in the legend."""
    return METHODS[method] + (" (another model)" if method in THEORIES else "")


def _draw_medium(axes: Axes, table: pd.DataFrame, styles: dict[str, tuple[Colour, str]]) -> None:
    """Draw the methods of one medium."""
    for method, rows in table.groupby("method"):
        colour, marker = styles[str(method)]
        shown = "deviation_largest" if method in THEORIES else "stderr_largest"
        # Lines pass through the measured point where a scaled one exists as well.
        line = rows.sort_values("how", key=lambda how: how == SCALED).drop_duplicates("error")
        axes.plot("seconds", shown, data=line.sort_values("error"), color=colour, lw=1.0)
        for scaled, part in rows.groupby(rows.how == SCALED):
            axes.plot(
                part.seconds, part[shown], marker, color=colour, ls="none",
                mfc="white" if scaled else colour, ms=4,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(which="major", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
