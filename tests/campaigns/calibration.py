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
from calibrated import CASES, Case, Told

from splits.figures.calibration import ALL, calibration_figure
from splits.figures.style import style
from splits.files import whole

LEAST = 4.0
"""Errors of what few rays see are not known from these rays: quantities that are not, on the whole,
this many stated errors large are left out."""


def off(runs: Sequence[Told], reference: Told | None = None) -> np.ndarray:
    """Return what runs are off in units of their stated errors, shape (runs, quantities)."""
    values, errors = (np.array(part) for part in zip(*runs, strict=True))
    size = np.abs(values.mean(axis=0)), np.sqrt((errors**2).mean(axis=0))
    known = (size[0] > LEAST * size[1]) & (errors > 0.0).all(axis=0)
    values, errors = values[:, known], errors[:, known]
    if reference is not None:
        truth, error = (part[known] for part in reference)
        return (values - truth) / np.hypot(errors, error)
    n = len(values)
    others = (values.sum(axis=0) - values) / (n - 1)
    return (values - others) / errors * np.sqrt((n - 1) / n)


def squares(case: Case, seeds: Iterable[int], use_reference: bool = True) -> dict[str, np.ndarray]:
    """Return mean squares of what every seed is off, by group of quantities.

    Parameters
    ----------
    case : Case
    seeds : iterable of int
    against : bool
        Whether runs are held against the reference of the case, if it has one.
    """
    told: dict[str, list[Told]] = {name: [] for name in case.readers}
    for seed in seeds:
        dataset = case.run(seed)
        if dataset.attrs.get("interpolation_error_bound"):
            raise ValueError(f"{case.instrument}, {case.medium}: seeds do not show all of an error")
        for name, read in case.readers.items():
            told[name].append(read(dataset))
    long_run = case.reference_run() if use_reference and case.reference_run else None
    found = {}
    for name, runs in told.items():
        z = off(runs, None if long_run is None else case.readers[name](long_run))
        if z.shape[1]:
            found[name] = (z**2).mean(axis=1)
    return found


def ratio(square: np.ndarray) -> tuple[float, float]:
    """Return a root mean square over seeds and its standard error."""
    root = float(np.sqrt(square.mean()))
    return root, float(square.std(ddof=1) / np.sqrt(square.size) / (2.0 * root))


def rows_of(case: Case, mean_squares: Mapping[str, np.ndarray]) -> list[dict[str, object]]:
    """Return the rows of a case: one for each group of quantities, and one for all of them."""
    groups = dict(mean_squares) | {ALL: np.mean(list(mean_squares.values()), axis=0)}
    rows = []
    for name, square in groups.items():
        value, error = ratio(square)
        rows.append(
            {
                "instrument": case.instrument, "medium": case.medium, "quantity": name,
                "seeds": square.size, "ratio": value, "ratio_stderr": error,
            }
        )  # fmt: skip
    return rows


def with_instruments(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with a row more for each instrument, over its media."""
    rows = []
    media = table[table.quantity == ALL]
    for instrument, part in media.groupby("instrument", sort=False):
        value = float(np.sqrt((part.ratio**2).mean()))
        error = float(np.sqrt(((part.ratio * part.ratio_stderr) ** 2).sum())) / len(part) / value
        rows.append(
            {
                "instrument": instrument, "medium": ALL, "quantity": ALL,
                "seeds": int(part.seeds.sum()), "ratio": value, "ratio_stderr": error,
            }
        )  # fmt: skip
    return pd.concat([table, pd.DataFrame(rows)], ignore_index=True)


def calibration(cases: Sequence[Case], seeds: int | None = None, first: int = 1) -> pd.DataFrame:
    """Run cases with successive seeds, printing as it goes, and return the table."""
    rows: list[dict[str, object]] = []
    for case in cases:
        begun = time.process_time()
        last = first + (seeds or case.n_seeds) - 1
        found = squares(case, range(first, last + 1))
        new = rows_of(case, found)
        spent = time.process_time() - begun
        print(f"{case.instrument}, {case.medium}: seeds {first} to {last}, {spent:.0f} s")
        for row in new:
            told = f"{row['ratio']:.3f} ± {row['ratio_stderr']:.3f}"
            print(f"  {row['quantity']}: {told}", flush=True)
        rows += new
    return with_instruments(pd.DataFrame(rows))


def main() -> None:
    """Write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="cases whose instrument and medium hold this")
    parser.add_argument("--seeds", type=int, help="for every case; by default its own number")
    parser.add_argument("--first", type=int, default=1, help="seed")
    asked = parser.parse_args()
    cases = [case for case in CASES if asked.only in f"{case.instrument}, {case.medium}"]
    table = calibration(cases, asked.seeds, asked.first)
    with whole(asked.folder / "calibration.csv") as aside:
        table.to_csv(aside, index=False, float_format="%.4f")
    with style(), whole(asked.folder / "images" / "calibration.png") as aside:
        calibration_figure(table).savefig(aside, dpi=200, metadata={"Software": None})
    print(table[table.medium == ALL].to_string(index=False))


if __name__ == "__main__":
    main()
