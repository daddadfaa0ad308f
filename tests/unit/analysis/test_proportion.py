"""Fits of lines through the origin."""

import numpy as np
import pytest
from scipy.stats import kstest
from scipy.stats import t as student_t

from splits.analysis.measured import fit_proportional


def test_slope_of_exact_points_is_recovered():
    x = np.array([0.1, 0.4, 0.9])
    line = fit_proportional(x, 1.2 * x)
    assert line.slope == pytest.approx(1.2)
    assert line.scatter == pytest.approx(0.0, abs=1e-12)


def test_slope_errors_follow_student_t():
    random = np.random.default_rng(4)
    x = np.linspace(0.1, 1.0, 12)
    lines = [fit_proportional(x, 0.8 * x + 0.1 * random.standard_normal(12)) for _ in range(400)]
    scores = [(line.slope - 0.8) / line.stderr for line in lines]
    # The slope takes one of twelve degrees of freedom.
    assert kstest(scores, student_t(11).cdf).pvalue > 0.01
    assert np.mean([line.scatter**2 for line in lines]) == pytest.approx(0.01, rel=0.1)
