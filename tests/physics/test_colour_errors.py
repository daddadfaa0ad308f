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
"""Sands chosen before any results were known: two to four refractive indices, unlike colours."""


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_errors_of_colours_agree_with_scatter():
    """A ratio from 40 seeds is uncertain by 11 %; nine ratios are tested together."""
    freedom = len(SEEDS) - 1
    ratios, p = {}, {}
    for name, settings in SANDS.items():
        sand = splits.Sand(**settings)
        runs = [
            splits.spectrophotometer(sand, WAVELENGTHS, max_stderr=0.005, seed=s) for s in SEEDS
        ]
        table = pd.concat([make_colour_table(run) for run in runs])
        for axis in "Lab":
            variance_ratio = table[axis].var() / (table[f"{axis}_stderr"] ** 2).mean()
            probability = chi2.cdf(freedom * variance_ratio, freedom)
            label = f"{axis}* of {name}"
            ratios[label], p[label] = (
                np.sqrt(variance_ratio),
                2.0 * min(probability, 1.0 - probability),
            )
    print("scatter over stated:", ", ".join(f"{k} {v:.2f}" for k, v in ratios.items()))
    judge_p(p)
