"""Stated errors of every instrument against the scatter of seeds: a table and a figure.

    make calibration

or, with part of it,

    python tests/campaigns/calibration.py FOLDER [--only TEXT] [--seeds N] [--first SEED]

writes FOLDER/calibration.csv and FOLDER/images/calibration.png.  For each case of
`calibrated` and each group of quantities the table holds the root mean square, over seeds and
quantities, of what a run is off in units of the error it states: off from the mean of all other
seeds, divided by what the scatter of that mean adds, or off from a long run, whose error counts.
The error of such a ratio comes from the scatter between seeds.  Rows "all" are root mean squares
over the groups of a medium, and over the media of an instrument.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from calibrated import CASES, CalibrationCase, ValuesAndErrors
from calibration_figure import ALL_LABEL, draw_calibration

from splits.core.atomic import atomic_write
from splits.plotting.style import use_style

MIN_SIGNAL_SIGMA = 4.0
"""Errors of what few rays see are not known from these rays: quantities that are not, on the whole,
this many stated errors large are left out."""


def compute_deviations(
    runs: Sequence[ValuesAndErrors], reference: ValuesAndErrors | None = None
) -> np.ndarray:
    """Return what runs are off in units of their stated errors, shape (runs, quantities)."""
    values, errors = (np.array(part) for part in zip(*runs, strict=True))
    size = np.abs(values.mean(axis=0)), np.sqrt((errors**2).mean(axis=0))
    known = (size[0] > MIN_SIGNAL_SIGMA * size[1]) & (errors > 0.0).all(axis=0)
    values, errors = values[:, known], errors[:, known]
    if reference is not None:
        truth, error = (part[known] for part in reference)
        return (values - truth) / np.hypot(errors, error)
    n = len(values)
    others = (values.sum(axis=0) - values) / (n - 1)
    return (values - others) / errors * np.sqrt((n - 1) / n)


def compute_mean_squares(
    case: CalibrationCase, seeds: Iterable[int], use_reference: bool = True
) -> dict[str, np.ndarray]:
    """Return mean squares of what every seed is off, by group of quantities.

    Parameters
    ----------
    case : Case
    seeds : iterable of int
    against : bool
        Whether runs are held against the reference of the case, if it has one.
    """
    told: dict[str, list[ValuesAndErrors]] = {name: [] for name in case.readers}
    for seed in seeds:
        dataset = case.run(seed)
        if dataset.attrs.get("interpolation_error_bound"):
            raise ValueError(f"{case.instrument}, {case.medium}: seeds do not show all of an error")
        for name, read in case.readers.items():
            told[name].append(read(dataset))
    long_run = case.reference_run() if use_reference and case.reference_run else None
    found = {}
    for name, runs in told.items():
        z = compute_deviations(runs, None if long_run is None else case.readers[name](long_run))
        if z.shape[1]:
            found[name] = (z**2).mean(axis=1)
    return found


def compute_rms_ratio(square: np.ndarray) -> tuple[float, float]:
    """Return a root mean square over seeds and its standard error."""
    root = float(np.sqrt(square.mean()))
    return root, float(square.std(ddof=1) / np.sqrt(square.size) / (2.0 * root))


def make_rows(
    case: CalibrationCase, mean_squares: Mapping[str, np.ndarray]
) -> list[dict[str, object]]:
    """Return the rows of a case: one for each group of quantities, and one for all of them."""
    groups = dict(mean_squares) | {ALL_LABEL: np.mean(list(mean_squares.values()), axis=0)}
    rows = []
    for name, square in groups.items():
        value, error = compute_rms_ratio(square)
        rows.append(
            {
                "instrument": case.instrument, "medium": case.medium, "quantity": name,
                "seeds": square.size, "ratio": value, "ratio_stderr": error,
            }
        )  # fmt: skip
    return rows


def add_instrument_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with a row more for each instrument, over its media."""
    rows = []
    media = table[table.quantity == ALL_LABEL]
    for instrument, part in media.groupby("instrument", sort=False):
        value = float(np.sqrt((part.ratio**2).mean()))
        error = float(np.sqrt(((part.ratio * part.ratio_stderr) ** 2).sum())) / len(part) / value
        rows.append(
            {
                "instrument": instrument, "medium": ALL_LABEL, "quantity": ALL_LABEL,
                "seeds": int(part.seeds.sum()), "ratio": value, "ratio_stderr": error,
            }
        )  # fmt: skip
    return pd.concat([table, pd.DataFrame(rows)], ignore_index=True)


def run_calibration(
    cases: Sequence[CalibrationCase], seeds: int | None = None, first: int = 1
) -> pd.DataFrame:
    """Run cases with successive seeds, printing as it goes, and return the table."""
    rows: list[dict[str, object]] = []
    for case in cases:
        begun = time.process_time()
        last = first + (seeds or case.n_seeds) - 1
        found = compute_mean_squares(case, range(first, last + 1))
        new = make_rows(case, found)
        spent = time.process_time() - begun
        print(f"{case.instrument}, {case.medium}: seeds {first} to {last}, {spent:.0f} s")
        for row in new:
            told = f"{row['ratio']:.3f} ± {row['ratio_stderr']:.3f}"
            print(f"  {row['quantity']}: {told}", flush=True)
        rows += new
    return add_instrument_rows(pd.DataFrame(rows))


def main() -> None:
    """Write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="cases whose instrument and medium hold this")
    parser.add_argument("--seeds", type=int, help="for every case; by default its own number")
    parser.add_argument("--first", type=int, default=1, help="seed")
    asked = parser.parse_args()
    cases = [case for case in CASES if asked.only in f"{case.instrument}, {case.medium}"]
    table = run_calibration(cases, asked.seeds, asked.first)
    with atomic_write(asked.folder / "calibration.csv") as aside:
        table.to_csv(aside, index=False, float_format="%.4f")
    with use_style(), atomic_write(asked.folder / "images" / "calibration.png") as aside:
        draw_calibration(table).savefig(aside, dpi=200, metadata={"Software": None})
    print(table[table.medium == ALL_LABEL].to_string(index=False))


if __name__ == "__main__":
    main()
