"""How far combinations of readings lie from what a paper states: a map of differences in bars."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from splits.figures.style import style, subplots

LIMIT = 3.0
"""Differences (bars) at the ends of the colours."""


def readings_map(statements: pd.DataFrame) -> Figure:
    """Draw the differences of all statements, a column per combination.

    Parameters
    ----------
    statements : pandas.DataFrame
        See `splits.experiments.ranking_tables.statements`.
    """
    import seaborn

    statements = statements[statements.nearest_water]
    names = list(dict.fromkeys(statements.statement))
    table = statements.pivot(index="statement", columns="combination", values="distance").loc[names]
    places = statements.drop_duplicates("statement").set_index("statement").place
    heads = statements.drop_duplicates("combination").set_index("combination").readings
    with style():
        figure, panels = subplots(
            1, 1, figsize=(3.4 + 0.95 * table.shape[1], 1.9 + 0.27 * table.shape[0]),
            squeeze=False, layout="constrained",
        )  # fmt: skip
        axes = panels[0, 0]
        seaborn.heatmap(
            table, ax=axes, cmap="RdBu_r", vmin=-LIMIT, vmax=LIMIT, annot=True, fmt=".1f",
            linewidths=0.5, annot_kws={"size": 7},
            cbar_kws={"label": "ours − published (bars)", "shrink": 0.6},
        )  # fmt: skip
        rows = [f"{name.replace('_', ' ')} · {places[name]}" for name in names]
        axes.set_yticks(np.arange(len(names)) + 0.5, rows, rotation=0)
        said = [dict(part.split(": ") for part in heads[i].split(", ")) for i in table.columns]
        columns = [
            "\n".join([str(i), *one.values()]) for i, one in zip(table.columns, said, strict=True)
        ]
        axes.set_xticks(np.arange(len(columns)) + 0.5, columns, rotation=0, fontsize=7)
        order = ", ".join(name.replace("_", " ") for name in said[0])
        axes.set_xlabel(f"combination of readings, the nearest first\n({order})", fontsize=9)
        axes.set_ylabel("")
        axes.tick_params(length=0)
    return figure
