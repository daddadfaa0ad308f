"""Figure of the differences of interpretations from published statements and from the default."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.plotting.annotations import annotate_figure
from splits.plotting.interpretation_shifts import INDEPENDENCE_NOTE, SHIFT_COLOUR
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    make_subplots,
    use_style,
)

MAX_DISTANCE_BARS = 6.0
"""Largest difference drawn, in tolerances; larger ones are triangles at the end."""
MAX_COMPARED = 12
"""Largest number of combinations compared with the default."""


def draw_interpretation_shifts(statements: pd.DataFrame, default: str = "splitsnow_2021") -> Figure:
    """Draw the differences of the default from all statements, and the shifts of others from it.

    Parameters
    ----------
    statements : pandas.DataFrame
        See `splits.experiments.papers.interpretation_tables.make_statement_table`.
    default : str
        Name of the reference set; if it is not among the combinations, the nearest one is used.
    """
    table = statements[statements.nearest_water]
    parts = dict(iter(table.groupby("combination", sort=False)))
    named = table.combination[table.set == default]
    first = named.iloc[0] if len(named) else table.combination.iloc[0]
    base = parts.pop(first).set_index("statement")
    shown = dict(list(parts.items())[:MAX_COMPARED])
    rows = np.arange(len(base))
    with use_style():
        figure, panels = make_subplots(
            1, 1 + len(shown), width=TWO_COLUMNS_INCHES, height=0.6 + 0.15 * rows.size, sharey=True,
            squeeze=False, width_ratios=[2.2, *[1.0] * len(shown)],
        )  # fmt: skip
        _draw_strip(panels[0, 0], base.distance.to_numpy(), base.stderr / base.bar, "black")
        panels[0, 0].set_title("default" if len(named) else "nearest")
        panels[0, 0].set_xlabel("ours − stated (tolerances)")
        for axes, (number, part) in zip(panels[0, 1:], shown.items(), strict=True):
            part = part.set_index("statement").loc[base.index]
            shift = (part.ours - base.ours) / base.bar
            _draw_strip(
                axes, shift.to_numpy(), np.hypot(part.stderr, base.stderr) / base.bar, SHIFT_COLOUR
            )
            axes.set_title(str(number))
        if shown:
            panels[0, (1 + len(shown)) // 2].set_xlabel("shift from the default (tolerances)")
        labels = [f"{name.replace('_', ' ')} · {row.place}: {row.ours:.3g}"
                  for name, row in base.iterrows()]  # fmt: skip
        panels[0, 0].set_yticks(rows, labels, fontsize=SMALL_FONT_PT)
        panels[0, 0].set_ylim(rows.size - 0.5, -0.5)
        notes = _make_notes(base, shown, default if len(named) else "nearest")
        n_omitted = len(parts) - len(shown)
        omitted_note = f"{n_omitted} more are in the table of statements." if n_omitted else ""
        return annotate_figure(figure, panels[0], *notes, omitted_note)


def _draw_strip(axes: Axes, value: np.ndarray, error: pd.Series | np.ndarray, colour: str) -> None:
    """Draw the differences of one combination."""
    rows = np.arange(value.size)
    axes.axvline(0.0, color="black", lw=0.6, zorder=1.0)
    inside = np.abs(value) <= MAX_DISTANCE_BARS
    errors = BAND_SIGMA * np.asarray(error)
    axes.errorbar(
        value[inside], rows[inside], xerr=errors[inside], fmt="o", ms=2, color=colour,
        elinewidth=0.7, capsize=0,
    )  # fmt: skip
    for side, marker in ((-1.0, "<"), (1.0, ">")):
        outside = rows[side * value > MAX_DISTANCE_BARS]
        axes.plot(
            np.full(outside.size, side * MAX_DISTANCE_BARS), outside, marker, ms=3, color=colour
        )
    axes.set_xlim(-1.15 * MAX_DISTANCE_BARS, 1.15 * MAX_DISTANCE_BARS)
    axes.set_xticks(
        [-0.5 * MAX_DISTANCE_BARS, 0.0, 0.5 * MAX_DISTANCE_BARS],
        [f"−{0.5 * MAX_DISTANCE_BARS:g}", "", f"{0.5 * MAX_DISTANCE_BARS:g}"],
    )
    axes.tick_params(axis="x", labelsize=SMALL_FONT_PT)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", alpha=0.25)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _make_notes(base: pd.DataFrame, compared: dict[int, pd.DataFrame], set_name: str) -> list[str]:
    """Return the notes on the columns and their errors."""
    reference = dict(part.split(": ") for part in base.interpretation.iloc[0].split(", "))
    lines = []
    for number, part in compared.items():
        other = dict(item.split(": ") for item in part.interpretation.iloc[0].split(", "))
        changed = [f"{key} {value}".replace("_", " ") for key, value in other.items()
                   if value != reference[key]]  # fmt: skip
        lines.append(f"{number}: {', '.join(changed) or 'the same'}")
    bars = f"error bars: {BAND_SIGMA:g} standard errors; {INDEPENDENCE_NOTE}"
    description = "; ".join(f"{key} {value}".replace("_", " ") for key, value in reference.items())
    return [
        f"Numbers after the statements: values of the default ({set_name}: {description}); {bars}.",
        "Others, nearest first, with their changes. " + "; ".join(lines) + ".",
    ]
