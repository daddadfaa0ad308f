"""Benchmark of time against error in the report: a figure and a short table."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from splits.experiments.papers.performance import (
    PAPER_ADAPTIVE,
    PAPER_UNIFORM,
    VECTORIZED,
    find_best_row,
)
from splits.experiments.report.tables import Cell, HtmlTable, make_cell

SPEED_TABLE = "speed_against_error_short.csv"
SPEED_CAPTION = (
    "Largest standard error of a spectrum against the time on one core, on logarithmic axes. "
    "Filled markers are measured, open ones scaled from another error. Uniform: the papers' "
    "algorithm with the same number of rays at all wavelengths, as the noisiest wavelength "
    "requires. Adaptive: a separate number of rays for each wavelength. Grey: theories, with "
    "their largest deviation from the reference, which is a difference of models."
)
SPEED_COLUMNS = (
    "medium", "target error", "this package (s)", "papers' algorithm, uniform (s)",
    "papers' algorithm, adaptive (s)", "time ratio, uniform", "time ratio, adaptive",
)  # fmt: skip


def make_speed_table(path: Path) -> HtmlTable:
    """Return the times of the vectorized kernel and of the papers' algorithm for each medium.

    The error is the smallest at which the benchmark has all three.
    """
    table = pd.read_csv(path)
    rows = []
    for medium in dict.fromkeys(table.medium):
        for error in sorted(table.error[table.medium == medium].dropna().unique()):
            found = [
                find_best_row(table, medium, method, error)
                for method in (VECTORIZED, PAPER_UNIFORM, PAPER_ADAPTIVE)
            ]
            seconds = [float(row.seconds) for row in found if row is not None]
            if len(seconds) == len(found):
                ratios = [time / seconds[0] for time in seconds[1:]]
                numbers = [float(f"{x:.3g}") for x in (error, *seconds, *ratios)]
                rows.append([Cell(str(medium)), *(make_cell(f"{x:g}") for x in numbers)])
                break
    return HtmlTable(list(SPEED_COLUMNS), rows, len(rows))
