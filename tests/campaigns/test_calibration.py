"""Agreement of the scatter between seeds with the stated errors of every instrument.

A few seeds of each by default.  The campaign proper is ``make campaign``, or

    CALIBRATION=all python -m pytest -s tests/campaigns/test_calibration.py

and ``make calibration`` makes the table and the figure of the documentation from the same runs.
"""

import os

import numpy as np
import pandas as pd
import pytest
from calibrated import CASES
from calibration import (
    MIN_SIGNAL_SIGMA,
    add_instrument_rows,
    compute_deviations,
    compute_mean_squares,
    make_rows,
    run_calibration,
)
from calibration_figure import ALL_LABEL, SHADED_RATIOS, draw_calibration
from chi2 import NEEDS_JIT, SIGNIFICANCE
from scipy import stats

import splits
from splits.core.discovery import list_instrument_names

FULL_CAMPAIGN = os.environ.get("CALIBRATION") == "all"
FEW_SEEDS = 6
INSTRUMENTS = {case.instrument: case for case in reversed(CASES)}
"""The first case of each instrument."""


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.skipif(FULL_CAMPAIGN, reason="all seeds are tested below")
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_few_seeds_scatter_within_stated_errors(instrument):
    """Quantities of a seed use the same rays, so they count as one degree of freedom."""
    mean_squares = compute_mean_squares(
        INSTRUMENTS[instrument], range(1, FEW_SEEDS + 1), use_reference=False
    )
    assert mean_squares
    significance = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / len(INSTRUMENTS) / len(mean_squares))
    bound = float(stats.chi2.isf(significance, FEW_SEEDS - 1) / (FEW_SEEDS - 1))
    for name, square in mean_squares.items():
        print(f"{instrument}, {name}: {square.mean() ** 0.5:.2f}, allowed {bound**0.5:.2f}")
        assert square.mean() <= bound, name


@NEEDS_JIT
@pytest.mark.skipif(not FULL_CAMPAIGN, reason="takes minutes: make campaign")
def test_all_seeds_scatter_as_stated():
    table = run_calibration(CASES)
    assert table.seeds.min() >= 30
    means = table[table.medium == ALL_LABEL]
    print(means.to_string(index=False))
    bad = means[(means.ratio < SHADED_RATIOS[0]) | (means.ratio > SHADED_RATIOS[1])]
    again = "to repeat: python tests/campaigns/calibration.py FOLDER --only '{}'"
    assert bad.empty, "\n".join(again.format(name) for name in bad.instrument)


def test_cases_cover_all_instruments():
    instrument_names = {case.instrument.partition(",")[0] for case in CASES}
    assert instrument_names == {*list_instrument_names()}
    assert instrument_names <= set(dir(splits))


@pytest.mark.parametrize("stated", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("with_reference", [True, False])
def test_ratio_detects_wrong_errors(stated, with_reference):
    rng = np.random.default_rng(5)
    values = 100.0 + rng.standard_normal((400, 3))
    runs = [(value, np.full(3, stated)) for value in values]
    reference = (np.full(3, 100.0), np.zeros(3)) if with_reference else None
    ratio = np.sqrt((compute_deviations(runs, reference) ** 2).mean())
    # 1200 values determine it to 2 %.
    assert abs(ratio * stated - 1.0) < 0.08


def test_quantities_with_large_errors_are_excluded():
    means = np.array([0.9, 1.1]) * MIN_SIGNAL_SIGMA
    runs = [(means + 0.1 * step, np.ones(2)) for step in (-1.0, 0.0, 1.0)]
    assert compute_deviations(runs).shape == (3, 1)


def test_instrument_rows_are_means_over_media():
    case = CASES[0]
    rows = [
        row
        for medium, size in (("a", 1.0), ("b", 4.0))
        for row in make_rows(
            case._replace(medium=medium),
            {"x": size * np.array([0.5, 1.5]), "y": size * np.array([1.5, 0.5])},
        )
    ]
    table = add_instrument_rows(pd.DataFrame(rows))
    last = table.iloc[-1]
    assert (last.instrument, last.medium, last.seeds) == (case.instrument, ALL_LABEL, 4)
    assert last.ratio == pytest.approx(2.5**0.5)
    # The mean of both sets has no scatter.
    assert last.ratio_stderr == 0.0
    first = table.iloc[0]
    assert first.ratio == 1.0 and first.ratio_stderr == pytest.approx(0.5**0.5 / 2**0.5 / 2.0)
    figure = draw_calibration(table)
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [case.instrument]
    assert axes.lines[1].get_xdata().tolist() == [1.0, 1.0, 2.0, 2.0]


def test_documented_calibration_covers_all_instruments(pytestconfig):
    table = pd.read_csv(pytestconfig.rootpath / "docs" / "calibration.csv")
    means = table[table.medium == ALL_LABEL]
    assert list(means.instrument) == list(dict.fromkeys(case.instrument for case in CASES))
    assert table.seeds.min() >= 30
    assert means.ratio.between(*SHADED_RATIOS).all()
    assert (pytestconfig.rootpath / "docs" / "images" / "calibration.png").is_file()
