"""Lines through the origin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest
from scipy.stats import t as student_t

from splits.analysis.anisotropy import fit_proportional


def test_points_on_a_line_have_its_slope():
    x = np.array([0.1, 0.4, 0.9])
    line = fit_proportional(x, 1.2 * x)
    assert line.slope == pytest.approx(1.2)
    assert line.scatter == pytest.approx(0.0, abs=1e-12)


def test_errors_are_those_of_the_scatter():
    random = np.random.default_rng(4)
    x = np.linspace(0.1, 1.0, 12)
    lines = [fit_proportional(x, 0.8 * x + 0.1 * random.standard_normal(12)) for _ in range(400)]
    off = [(one.slope - 0.8) / one.stderr for one in lines]
    # One of twelve degrees of freedom is the slope's.
    assert kstest(off, student_t(11).cdf).pvalue > 0.01
    assert np.mean([one.scatter**2 for one in lines]) == pytest.approx(0.01, rel=0.1)
