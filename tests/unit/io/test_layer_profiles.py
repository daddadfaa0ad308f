"""Measured profiles assigned to layers."""

from __future__ import annotations

import numpy as np
import pytest

from splits.io.layer_profiles import DepthProfile, average_over_layers, interpolate_to_layers

TOP, THICKNESS = np.array([0.0, 0.2, 0.4, 0.8]), np.array([0.2, 0.2, 0.4, 0.2])


def profile(*rows):
    return DepthProfile(*np.array(rows, dtype=float).T)


@pytest.mark.parametrize("extend", [True, False])
def test_the_mean_over_layers_conserves_the_total_of_a_complete_profile(extend):
    measured = profile((0.0, 0.1, 5.0), (0.1, 0.3, 2.0), (0.4, 0.35, 7.0), (0.75, 0.25, 1.0))
    mean = average_over_layers(measured, TOP, THICKNESS, extend=extend)
    assert mean @ THICKNESS == pytest.approx(measured.values @ measured.thickness_m)
    np.testing.assert_allclose(mean[:2], [3.5, 2.0])


def test_gaps_are_dropped_and_the_order_does_not_matter():
    rows = [(0.4, 0.2, 3.0), (0.0, 0.2, 1.0), (0.2, 0.2, np.nan), (np.nan, 0.1, 9.0)]
    mean = average_over_layers(profile(*rows), TOP, THICKNESS, extend=True)
    np.testing.assert_allclose(mean, [1.0, 2.0, 3.0, 3.0])
    assert np.isnan(average_over_layers(profile(rows[2]), TOP, THICKNESS, extend=True)).all()


def test_a_contact_by_rounding_is_no_overlap():
    measured = profile((0.0, 0.2 + 1e-15, 1.0), (0.3, 0.1, 5.0))
    assert average_over_layers(measured, TOP, THICKNESS, extend=True)[1] == pytest.approx(5.0)


def test_points_are_interpolated_to_the_middle_of_layers():
    measured = profile((0.0, 0.0, -10.0), (0.6, 0.0, -4.0))
    for extend, last in ((True, -4.0), (False, np.nan)):
        values = interpolate_to_layers(measured, TOP, THICKNESS, extend=extend)
        np.testing.assert_allclose(values, [-9.0, -7.0, -4.0, last])
