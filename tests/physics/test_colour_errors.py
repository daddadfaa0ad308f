"""Stated errors of colours against the scatter of repeated runs."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from chi2 import NEEDS_JIT, judge_p
from scipy.stats import chi2

import splits
from splits.analysis.colour import make_colour_table

WAVELENGTHS = np.arange(400.0, 781.0, 10.0)
SEEDS = range(1, 41)
SANDS = {
    "default": {},
    "hematite": {"iron_oxide": 0.04, "hematite_ratio": 1.0},
    "wet goethite": {"iron_oxide": 0.02, "hematite_ratio": 0.0, "saturation": 1.0},
}
"""Chosen before any was run: paths at two to four refractive indices, and colours that differ."""


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_colours_scatter_as_stated():
    """The spread of a ratio over 40 seeds is 11 %; nine of them are judged as a family."""
    freedom = len(SEEDS) - 1
    ratios, p = {}, {}
    for name, settings in SANDS.items():
        sand = splits.Sand(**settings)
        runs = [
            splits.spectrophotometer(sand, WAVELENGTHS, max_stderr=0.005, seed=s) for s in SEEDS
        ]
        table = pd.concat([make_colour_table(run) for run in runs])
        for axis in "Lab":
            square = table[axis].var() / (table[f"{axis}_stderr"] ** 2).mean()
            below = chi2.cdf(freedom * square, freedom)
            label = f"{axis}* of {name}"
            ratios[label], p[label] = np.sqrt(square), 2.0 * min(below, 1.0 - below)
    print("scatter over stated:", ", ".join(f"{k} {v:.2f}" for k, v in ratios.items()))
    judge_p(p)
