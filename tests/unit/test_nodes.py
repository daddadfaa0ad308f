"""Nodes: few refractive indices that stand for a spectrum, within the tolerance asked for."""

from __future__ import annotations

import numpy as np
import pytest

from splits import Snow
from splits.instruments.nodes import CURVATURE, MAX_EXTINCTION, MAX_RESIDUAL, choose_nodes

SPECTRA = {
    "solar": np.arange(400.0, 2501.0, 10.0),
    "mid-infrared": np.arange(2500.0, 4001.0, 10.0),
    "all": np.geomspace(200.0, 50_000.0, 300),
}
SAMPLES = {
    "Table 1": {},
    "dry": {"saturation": 0.0},
    "filled with water": {"saturation": 1.0},
    "other tables": {
        "saturation": 0.3,
        "refractive_index": {
            "ice": "warren_brandt_2008_picard_2016",
            "water": "segelstein_1981",
        },
    },
}
HALF = (0.5, 0.5)


def indices(wavelengths, **settings):
    """Return the indices of a sample at the wavelengths its tables hold, and its pore shares."""
    snow = Snow(**settings)
    table = snow.refractive_index["ice"].wavelength_nm
    inside = wavelengths[wavelengths >= table[0]]
    return snow.indices(inside), (1.0 - snow.saturation, snow.saturation)


def linear(start, stop, count=50, water=1.33):
    """Return indices whose ice changes from start to stop, under air and water."""
    index = np.ones((count, 3), dtype=complex)
    index[:, 1] = water
    index[:, 2] = np.linspace(start, stop, count)
    return index


@pytest.mark.parametrize("tolerance", [0.01, 0.001])
@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_nodes_stand_for_the_spectrum(spectrum, sample, tolerance):
    index, share = indices(SPECTRA[spectrum], **SAMPLES[sample])
    nodes = choose_nodes(index, share, tolerance)
    assert nodes.weights.shape == (len(nodes.index), len(index))
    assert (nodes.weights >= 0.0).all()
    np.testing.assert_allclose(nodes.weights.sum(axis=0), 1.0, rtol=1e-12)
    assert (nodes.weights.max(axis=1) > 0.0).all(), "every node is drawn on"
    assert nodes.bias.shape == (len(index),)
    assert nodes.bias.max() <= tolerance
    assert (nodes.index.real > 0.0).all()
    assert (nodes.index.imag >= 0.0).all()
    mixed = nodes.weights.T @ nodes.index.real
    squared = nodes.weights.T @ nodes.index.imag**2
    assert np.abs(mixed - index.real).max() <= MAX_RESIDUAL
    assert np.abs(squared - index.imag**2).max() <= MAX_RESIDUAL


def test_a_solar_spectrum_takes_few_nodes_and_more_if_asked_for_more():
    index, share = indices(SPECTRA["solar"])
    counts = [len(choose_nodes(index, share, tolerance).index) for tolerance in (0.01, 0.001, 1e-4)]
    assert counts[0] <= 10
    assert counts == sorted(counts)


def test_nodes_stay_near_the_spectrum():
    index, share = indices(SPECTRA["all"])
    nodes = choose_nodes(index, share, 0.01)
    low, high = index.real.min(axis=0), index.real.max(axis=0)
    room = 0.25 * (high - low) + MAX_RESIDUAL
    assert ((nodes.index.real >= low - room) & (nodes.index.real <= high + room)).all()


def test_a_constant_index_takes_one_node():
    nodes = choose_nodes(linear(1.31, 1.31), HALF, 1e-6)
    np.testing.assert_allclose(nodes.index, [[1.0, 1.33, 1.31]])
    assert (nodes.weights == 1.0).all()
    assert (nodes.bias == 0.0).all()


@pytest.mark.parametrize("index", [1.31, 1.31 + 1e-6j, 1.31 + 0.2j])
def test_a_single_wavelength_is_its_own_node(index):
    one = linear(index, index, count=1)
    nodes = choose_nodes(one, HALF, 1e-6)
    np.testing.assert_allclose(nodes.index, one)
    assert nodes.weights.tolist() == [[1.0]]
    assert nodes.bias.tolist() == [0.0]


def test_two_wavelengths_far_apart_are_not_mixed():
    index = linear(1.2, 1.6, count=2)
    nodes = choose_nodes(index, HALF, 1e-6)
    np.testing.assert_allclose(nodes.weights.T @ nodes.index, index, atol=1e-12)
    assert nodes.bias.max() <= 1e-6


def test_a_contrast_that_changes_sign_is_not_interpolated_across():
    # Ice optically thinner than water, then denser: at equality nothing is reflected.
    index = linear(1.30, 1.36, count=61)
    tolerance = 1e-3
    nodes = choose_nodes(index, (0.0, 1.0), tolerance)
    assert nodes.bias.max() <= tolerance
    contrast = nodes.index[:, 2].real / nodes.index[:, 1].real - 1.0
    for weights in nodes.weights.T:
        drawn = contrast[weights > 0.0]
        assert drawn.min() * drawn.max() >= 0.0


@pytest.mark.parametrize("sample", ["Table 1", "dry", "filled with water"])
@pytest.mark.parametrize("step", [10.0, 150.0])
def test_nodes_lie_as_near_as_the_tolerance_needs(step, sample):
    # Jensen's gap of a function with |f''| <= CURVATURE, from the nodes that are drawn on.
    index, share = indices(np.arange(400.0, 2501.0, step), **SAMPLES[sample])
    tolerance = 1e-3
    nodes = choose_nodes(index, share, tolerance)
    gap = np.zeros(len(index))
    for pore in (0, 1):
        drawn = (nodes.index[:, 2] / nodes.index[:, pore]).real[:, np.newaxis] - 1.0
        wanted = (index[:, 2] / index[:, pore]).real - 1.0
        relative = (drawn - wanted) / np.minimum(np.abs(drawn), np.abs(wanted))
        gap += share[pore] * 0.5 * CURVATURE * (nodes.weights * relative**2).sum(axis=0)
    assert gap.max() <= 2.0 * tolerance


def test_water_that_is_not_there_does_not_matter():
    index = linear(1.30, 1.36, count=61)
    with_water = choose_nodes(index, (0.0, 1.0), 1e-3)
    without = choose_nodes(index, (1.0, 0.0), 1e-3)
    assert len(without.index) < len(with_water.index)


def test_strong_absorbers_are_traced_by_themselves():
    index = linear(1.3, 1.31)
    index[20:25, 2] += 1j * np.linspace(2.0, 4.0, 5) * MAX_EXTINCTION
    nodes = choose_nodes(index, HALF, 0.01)
    strong = nodes.weights[:, 20:25]
    assert sorted(strong.max(axis=0)) == [1.0] * 5
    used = strong.argmax(axis=0)
    np.testing.assert_array_equal(nodes.index[used], index[20:25])
    assert (nodes.bias[20:25] == 0.0).all()


def test_equal_strong_absorbers_share_a_node():
    index = linear(1.4 + 0.1j, 1.4 + 0.1j, count=7)
    nodes = choose_nodes(index, HALF, 0.01)
    np.testing.assert_array_equal(nodes.index, index[:1])
    assert (nodes.weights == 1.0).all()


def test_the_order_of_wavelengths_does_not_matter():
    index, share = indices(SPECTRA["solar"])
    nodes, turned = (choose_nodes(i, share, 0.001) for i in (index, index[::-1]))
    assert len(nodes.index) == len(turned.index)
    np.testing.assert_allclose(nodes.bias, turned.bias[::-1], rtol=1e-6)
