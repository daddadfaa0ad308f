"""Measured profiles assigned to layers."""

from __future__ import annotations

import itertools
import tracemalloc

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


def average_all_pairs(measured, top, thickness):
    """Return means over layers from the overlaps of all layers with all intervals or points."""
    bottom = (top + thickness)[:, None]
    if (measured.thickness_m == 0.0).all():
        weights = 1.0 * ((measured.top_m >= top[:, None]) & (measured.top_m < bottom))
    else:
        lowest = np.minimum(bottom, measured.top_m + measured.thickness_m)
        weights = lowest - np.maximum(top[:, None], measured.top_m)
        weights = np.where(weights > 1e-6, weights, 0.0)
    total = weights.sum(axis=1)
    between = interpolate_to_layers(measured, top, thickness, extend=True)
    return np.where(total > 0, weights @ measured.values / np.where(total > 0, total, 1), between)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("points", [True, False])
def test_intervals_alone_and_points_alone_have_the_means_of_all_pairs(points, seed):
    """Intervals may overlap each other, lie in each other, and have any order."""
    random = np.random.default_rng(seed)
    n, thickness = random.integers(1, 40), random.uniform(0.001, 0.3, random.integers(1, 20))
    top = np.cumsum(thickness) - thickness
    lengths = np.zeros(n) if points else random.choice([0.01, 0.05, 0.3, 2.0], n)
    tops = np.round(random.uniform(0.0, top[-1] + 0.2, n), random.choice([2, 8]))
    measured = DepthProfile(tops, lengths, random.uniform(50, 900, n))
    found = average_over_layers(measured, top, thickness, extend=True)
    np.testing.assert_allclose(found, average_all_pairs(measured, top, thickness), rtol=1e-13)


@pytest.mark.parametrize("seed", range(10))
def test_points_share_the_part_of_a_layer_without_intervals(seed):
    """The mean is that of a fine grid, whose free cells have the mean of the free points."""
    random = np.random.default_rng(seed)
    cells = np.arange(1000)
    tops = np.sort(random.choice(cells[::10], 12, replace=False))
    lengths = np.minimum(random.integers(1, 60, 12), np.diff(tops, append=1000))
    depths = random.choice(cells[5::10], 60)
    values = random.uniform(5.0, 60.0, 72)
    grid = np.full(1000, np.nan)
    for top, length, value in zip(tops, lengths, values, strict=False):
        grid[top : top + length] = value
    measured = DepthProfile(
        np.concatenate([tops, depths]) / 1e3, np.append(lengths, np.zeros(60)) / 1e3, values
    )
    shuffled = random.permutation(72)
    measured = DepthProfile(*(column[shuffled] for column in measured))
    edges = np.arange(0, 1001, 100)
    found = average_over_layers(measured, edges[:-1] / 1e3, np.full(10, 0.1), extend=True)
    for i, (first, last) in enumerate(itertools.pairwise(edges)):
        layer = grid[first:last].copy()
        free = [v for d, v in zip(depths, values[12:], strict=True)
                if first <= d < last and np.isnan(grid[d])]  # fmt: skip
        if free:
            layer[np.isnan(layer)] = np.mean(free)
        assert found[i] == pytest.approx(np.nanmean(layer), rel=1e-9)


def test_points_change_nothing_where_intervals_cover_the_layer():
    intervals = [(0.0, 0.2, 5.0), (0.2, 0.2, 2.0), (0.2, 0.2, 4.0), (0.4, 0.4, 7.0), (0.8, 0.2, 1)]
    alone = average_over_layers(profile(*intervals), TOP, THICKNESS, extend=True)
    points = [(depth, 0.0, 100.0) for depth in (0.0, 0.1, 0.2, 0.39, 0.4, 0.8, 0.95)]
    both = average_over_layers(profile(*points, *intervals), TOP, THICKNESS, extend=True)
    np.testing.assert_allclose(both, alone, rtol=1e-12)
    np.testing.assert_allclose(alone, [5.0, 3.0, 7.0, 1.0])


def test_two_intervals_at_one_depth_do_not_outweigh_the_points():
    measured = [(0.0, 0.05, 5.0), (0.0, 0.05, 7.0), (0.1, 0.0, 2.0), (0.15, 0.0, 4.0)]
    mean = average_over_layers(profile(*measured), TOP[:1], THICKNESS[:1], extend=True)
    np.testing.assert_allclose(mean, [(0.05 * 6.0 + 0.15 * 3.0) / 0.2])


@pytest.mark.parametrize("thickness", [0.0, 2.5e-4, 5.0])
def test_memory_grows_with_the_number_of_intervals_only(thickness):
    """One array over all layers and intervals would take 32 MB."""
    n, step = 2000, 2.5e-4
    top = np.arange(n) * step
    measured = DepthProfile(top + 1e-5, np.full(n, thickness), 300.0 + np.arange(n) % 7)
    tracemalloc.start()
    average_over_layers(measured, top, np.full(n, step), extend=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6
