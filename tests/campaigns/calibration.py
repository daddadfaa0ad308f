"""Ratio of the scatter between seeds to the stated errors of every instrument.

    make calibration

or, for part of the cases,

    python tests/campaigns/calibration.py FOLDER [--only TEXT] [--seeds N] [--first SEED]

writes FOLDER/calibration.csv and FOLDER/images/calibration.png.  For each case of `calibrated` and
each set of quantities the table contains the root mean square, over seeds and quantities, of the
deviation of a run in units of its stated error.  The deviation is from the mean of all other seeds,
corrected for the error of that mean, or from a long run, whose error is included.  The error of
such a ratio is estimated from the scatter between seeds.  Rows "all" are root mean squares over the
sets of a medium, and over the media of an instrument.
"""

import argparse
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from calibrated import CASES, CalibrationCase, ValuesAndErrors
from calibration_figure import ALL_LABEL, draw_calibration

from splits.core.atomic import atomic_write
from splits.plotting.grammar import use_style

MIN_SIGNAL_SIGMA = 4.0
"""Quantities whose mean is a smaller multiple of their stated error are excluded: few rays
contribute to them, so that their errors are poorly estimated."""


def compute_deviations(
    runs: Sequence[ValuesAndErrors], reference: ValuesAndErrors | None = None
) -> np.ndarray:
    """Return deviations of runs in units of their stated errors, shape (runs, quantities)."""
    values, errors = (np.array(part) for part in zip(*runs, strict=True))
    signal = np.abs(values.mean(axis=0)), np.sqrt((errors**2).mean(axis=0))
    significant = (signal[0] > MIN_SIGNAL_SIGMA * signal[1]) & (errors > 0.0).all(axis=0)
    values, errors = values[:, significant], errors[:, significant]
    if reference is not None:
        expected, error = (part[significant] for part in reference)
        return (values - expected) / np.hypot(errors, error)
    n = len(values)
    others = (values.sum(axis=0) - values) / (n - 1)
    return (values - others) / errors * np.sqrt((n - 1) / n)


def compute_mean_squares(
    case: CalibrationCase, seeds: Iterable[int], use_reference: bool = True
) -> dict[str, np.ndarray]:
    """Return the mean square deviation of every seed, by set of quantities.

    Parameters
    ----------
    case : CalibrationCase
    seeds : iterable of int
    use_reference : bool
        Whether runs are compared with the reference of the case, if it has one.
    """
    results: dict[str, list[ValuesAndErrors]] = {name: [] for name in case.readers}
    for seed in seeds:
        dataset = case.run(seed)
        if dataset.attrs.get("interpolation_error_bound"):
            raise ValueError(
                f"{case.instrument}, {case.medium}: errors include interpolation bounds"
            )
        for name, read in case.readers.items():
            results[name].append(read(dataset))
    long_run = case.reference_run() if use_reference and case.reference_run else None
    mean_squares = {}
    for name, runs in results.items():
        z = compute_deviations(runs, None if long_run is None else case.readers[name](long_run))
        if z.shape[1]:
            mean_squares[name] = (z**2).mean(axis=1)
    return mean_squares


def compute_rms_ratio(square: np.ndarray) -> tuple[float, float]:
    """Return a root mean square over seeds and its standard error."""
    root = float(np.sqrt(square.mean()))
    return root, float(square.std(ddof=1) / np.sqrt(square.size) / (2.0 * root))


def make_rows(
    case: CalibrationCase, mean_squares: Mapping[str, np.ndarray]
) -> list[dict[str, object]]:
    """Return the rows of a case: one for each set of quantities, and one for all of them."""
    by_quantity = dict(mean_squares) | {ALL_LABEL: np.mean(list(mean_squares.values()), axis=0)}
    rows = []
    for name, square in by_quantity.items():
        value, error = compute_rms_ratio(square)
        rows.append(
            {
                "instrument": case.instrument, "medium": case.medium, "quantity": name,
                "seeds": square.size, "ratio": value, "ratio_stderr": error,
            }
        )  # fmt: skip
    return rows


def add_instrument_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with an added row for each instrument, over its media."""
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
    """Run cases with successive seeds, print the ratios, and return the table."""
    rows: list[dict[str, object]] = []
    for case in cases:
        start = time.process_time()
        last = first + (seeds or case.n_seeds) - 1
        mean_squares = compute_mean_squares(case, range(first, last + 1))
        new = make_rows(case, mean_squares)
        cpu_time_s = time.process_time() - start
        print(f"{case.instrument}, {case.medium}: seeds {first} to {last}, {cpu_time_s:.0f} s")
        for row in new:
            ratio = f"{row['ratio']:.3f} ± {row['ratio_stderr']:.3f}"
            print(f"  {row['quantity']}: {ratio}", flush=True)
        rows += new
    return add_instrument_rows(pd.DataFrame(rows))


def main() -> None:
    """Write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="part of the labels of cases to run")
    parser.add_argument("--seeds", type=int, help="number of seeds, by default that of each case")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    arguments = parser.parse_args()
    cases = [case for case in CASES if arguments.only in f"{case.instrument}, {case.medium}"]
    table = run_calibration(cases, arguments.seeds, arguments.first)
    with atomic_write(arguments.folder / "calibration.csv") as aside:
        table.to_csv(aside, index=False, float_format="%.4f")
    with use_style(), atomic_write(arguments.folder / "images" / "calibration.png") as aside:
        draw_calibration(table).savefig(aside, dpi=200, metadata={"Software": None})
    print(table[table.medium == ALL_LABEL].to_string(index=False))


if __name__ == "__main__":
    main()
