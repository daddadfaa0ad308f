"""Nodes: few refractive indices that stand for a spectrum, within the tolerance asked for."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits import Snow
from splits.media.medium import Interface
from splits.simulation.diffusion import diffuse_reflectance
from splits.simulation.interpolation_bounds import (
    MAX_LOG_CURVATURE,
    compute_contrasts,
    compute_entering_light,
)
from splits.simulation.spectral_nodes import MAX_NODES, choose_nodes

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


def make_interfaces(dry, wet):
    """Return the interfaces of ice under air and water of the given shares."""
    return [Interface(dry, 0, 2), Interface(wet, 1, 2)]


HALF_WET = make_interfaces(0.5, 0.5)


def load_indices(wavelengths, **settings):
    """Return the indices of a sample at the wavelengths its tables hold, and its interfaces."""
    snow = Snow(**settings)
    table = snow.refractive_index["ice"].wavelength_nm
    inside = wavelengths[wavelengths >= table[0]]
    return snow.compute_refractive_indices(inside), snow.list_interfaces()


def make_linear_indices(start, stop, count=50, water=1.33):
    """Return indices whose ice changes from start to stop, under air and water."""
    index = np.ones((count, 3), dtype=complex)
    index[:, 1] = water
    index[:, 2] = np.linspace(start, stop, count)
    return index


@pytest.mark.parametrize("tolerance", [0.01, 0.001])
@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_nodes_stand_for_the_spectrum(spectrum, sample, tolerance):
    index, interfaces = load_indices(SPECTRA[spectrum], **SAMPLES[sample])
    nodes = choose_nodes(index, interfaces, tolerance)
    assert nodes.weights.shape == (len(nodes.index), len(index))
    assert (nodes.weights >= 0.0).all()
    np.testing.assert_allclose(nodes.weights.sum(axis=0), 1.0, rtol=1e-12)
    assert (nodes.weights.max(axis=1) > 0.0).all(), "every node is drawn on"
    assert ((nodes.weights > 0.0).sum(axis=0) <= 2).all()
    assert nodes.interpolation_bound.shape == (len(index),)
    assert nodes.interpolation_bound.max() <= tolerance
    for node in nodes.index:
        assert (node == index).all(axis=1).any(), "nodes are indices of the spectrum"


def test_a_solar_spectrum_takes_few_nodes_and_more_if_asked_for_more():
    index, interfaces = load_indices(SPECTRA["solar"])
    counts = [len(choose_nodes(index, interfaces, t).index) for t in (0.01, 0.001, 1e-4)]
    assert counts[0] <= 3
    assert counts[1] <= 6
    assert counts == sorted(counts)


def test_a_constant_index_takes_one_node():
    nodes = choose_nodes(make_linear_indices(1.31, 1.31), HALF_WET, 1e-6)
    np.testing.assert_allclose(nodes.index, [[1.0, 1.33, 1.31]])
    assert (nodes.weights == 1.0).all()
    assert (nodes.interpolation_bound == 0.0).all()


@pytest.mark.parametrize("index", [1.31, 1.31 + 1e-6j, 1.31 + 0.2j])
def test_a_single_wavelength_is_its_own_node(index):
    one = make_linear_indices(index, index, count=1)
    nodes = choose_nodes(one, HALF_WET, 1e-6)
    np.testing.assert_allclose(nodes.index, one)
    assert nodes.weights.tolist() == [[1.0]]
    assert nodes.interpolation_bound.tolist() == [0.0]


def test_two_wavelengths_far_apart_are_not_mixed():
    index = make_linear_indices(1.2, 1.6, count=2)
    nodes = choose_nodes(index, HALF_WET, 1e-6)
    np.testing.assert_array_equal(nodes.weights.T @ nodes.index, index)
    assert nodes.interpolation_bound.max() == 0.0


def test_contrast_is_the_relative_index_step_and_grows_with_extinction():
    index = make_linear_indices(1.31, 1.31, count=3)
    index[1, 2] = 1.31 + 0.5j
    index[2, 2] = 1.0
    u = compute_contrasts(index, make_interfaces(0.8, 0.2))
    np.testing.assert_allclose(u[0], [0.8 * 0.31, -0.2 * (1.33 / 1.31 - 1.0)])
    reflectance = abs((0.31 + 0.5j) / (2.31 + 0.5j)) ** 2
    equivalent = 1.0 + u[1, 0] / 0.8
    assert ((equivalent - 1.0) / (equivalent + 1.0)) ** 2 == pytest.approx(reflectance)
    assert u[2, 0] == 0.0
    np.testing.assert_allclose(u[:, 1] < 0.0, [True, True, True])


def test_a_vanishing_contrast_is_not_interpolated_across():
    # Ice optically thinner than water, then denser: at equality nothing is reflected.
    index = make_linear_indices(1.30, 1.36, count=61)
    nodes = choose_nodes(index, make_interfaces(0.0, 1.0), 1e-3)
    assert nodes.interpolation_bound.max() <= 1e-3
    own = compute_contrasts(index, make_interfaces(0.0, 1.0)).sum(axis=1)
    drawn = compute_contrasts(nodes.index, make_interfaces(0.0, 1.0)).sum(axis=1)
    np.testing.assert_allclose(nodes.weights.T @ drawn, own, atol=2e-3 * np.abs(own).max())
    for weights in nodes.weights.T:
        signs = np.sign(drawn[weights > 0.0])
        assert signs.min() == signs.max()


def test_few_dark_grains_among_clear_ones_count():
    # One per cent of opaque grains whose index moves: what enters them decides absorption.
    index = np.ones((40, 4), dtype=complex)
    index[:, 2] = 1.55
    index[:, 3] = np.linspace(2.1, 2.6, 40) + 0.5j
    interfaces = [Interface(0.99, 0, 2), Interface(0.01, 0, 3)]
    lone = choose_nodes(index[[0, -1]], interfaces, 1.0)
    assert lone.interpolation_bound.max() > 0.02
    assert compute_entering_light(index, interfaces)[:, 0].max() == 0.0
    assert len(choose_nodes(index, interfaces, 1e-3).index) > 1


@pytest.mark.parametrize("sample", ["Table 1", "dry", "filled with water"])
@pytest.mark.parametrize("step", [10.0, 150.0])
def test_nodes_lie_as_near_as_the_tolerance_needs(step, sample):
    # Any function of the mean contrast with |d²f/d(ln c)²| <= CURVATURE is met: here ½ C (ln c)².
    index, interfaces = load_indices(np.arange(400.0, 2501.0, step), **SAMPLES[sample])
    tolerance = 1e-3
    nodes = choose_nodes(index, interfaces, tolerance)
    own = np.log(np.abs(compute_contrasts(index, interfaces)).sum(axis=1))
    drawn = np.log(np.abs(compute_contrasts(nodes.index, interfaces)).sum(axis=1))
    middle = own.mean()
    missed = nodes.weights.T @ (0.5 * MAX_LOG_CURVATURE * (drawn - middle) ** 2)
    missed -= 0.5 * MAX_LOG_CURVATURE * (own - middle) ** 2
    assert np.abs(missed).max() <= tolerance
    assert np.abs(nodes.weights.T @ drawn - own).max() <= 0.1


def test_water_that_is_not_there_does_not_matter():
    index = make_linear_indices(1.30, 1.36, count=61)
    with_water = choose_nodes(index, make_interfaces(0.0, 1.0), 1e-3)
    without = choose_nodes(index, make_interfaces(1.0, 0.0), 1e-3)
    assert len(without.index) < len(with_water.index)


def test_extinction_alone_needs_nodes_only_where_it_reflects():
    index = make_linear_indices(1.31, 1.31)
    index[:, 2] += 1j * np.geomspace(1e-9, 1e-3, 50)
    assert len(choose_nodes(index, HALF_WET, 1e-3).index) == 1
    index[:, 2] += 1j * np.linspace(0.0, 1.0, 50)
    assert len(choose_nodes(index, HALF_WET, 1e-3).index) > 3


def test_too_many_nodes_give_way_to_one_per_wavelength():
    index = make_linear_indices(1.2, 1.6, count=3 * MAX_NODES)
    nodes = choose_nodes(index, HALF_WET, 1e-9)
    np.testing.assert_array_equal(nodes.weights.T @ nodes.index, index)
    assert (nodes.interpolation_bound == 0.0).all()


def test_the_order_of_wavelengths_does_not_matter():
    index, interfaces = load_indices(SPECTRA["solar"])
    nodes, turned = (choose_nodes(i, interfaces, 0.001) for i in (index, index[::-1]))
    np.testing.assert_array_equal(nodes.index, turned.index)
    np.testing.assert_array_equal(nodes.interpolation_bound, turned.interpolation_bound[::-1])


def test_a_face_that_hardly_reflects_asks_for_no_nodes():
    """What reflects 1e-6 of the light may double without anybody's seeing it."""
    index = np.ones((50, 2), dtype=complex)
    index[:, 0], index[:, 1] = 1.33, np.linspace(1.329, 1.331, 50)
    faint = choose_nodes(index, [Interface(1.0, 0, 1, "boundary")], 0.002)
    assert len(faint.index) <= 2
    index[:, 1] += 0.2
    strong = choose_nodes(index, [Interface(1.0, 0, 1, "boundary")], 1e-5)
    assert len(strong.index) > len(faint.index)


@pytest.mark.parametrize("lid", [1.32, 1.33, 1.335, 1.5])
@pytest.mark.parametrize("below", [0.0, 0.02, 0.3, 0.9])
def test_faces_met_from_either_side_stay_within_their_bound(lid, below):
    """A lid on wet sand: from some wavelength on the denser side is the other.

    Diffuse light, a clear lid, and pores that send back a part of what enters them.
    """
    wavelengths = np.arange(400.0, 1001.0, 50.0)
    layer = splits.ParticleLayer(
        optical_thickness=1.0, refractive_index=lid, bottom_albedo=None, depth_m=0.02
    )
    stack = splits.Stack([layer, splits.Sand(saturation=1.0)])
    index = stack.compute_refractive_indices(wavelengths)
    names = stack.list_materials()
    n = index[:, names.index("layers.1.water")].real / lid
    outer, inner = diffuse_reflectance(n), diffuse_reflectance(1.0 / n)
    seen = outer + (1.0 - outer) * (1.0 - inner) * below / (1.0 - inner * below)
    for tolerance in (1e-2, 1e-3, 2e-4):
        nodes = choose_nodes(index, stack.list_interfaces(), tolerance)
        rows = [np.flatnonzero((index == node).all(axis=1))[0] for node in nodes.index]
        missed = np.abs(seen[rows] @ nodes.weights - seen)
        assert (missed <= nodes.interpolation_bound + 1e-12).all(), (
            tolerance,
            missed.max(),
            nodes.interpolation_bound.max(),
        )


def test_faces_between_layers_are_judged_wherever_indices_may_change():
    def air(last):
        return {"air": {"wavelength_nm": [400, 1000], "n": [1.5, last], "k": [0, 0]}}

    sands = [splits.Sand(refractive_index=air(last)) for last in (1.4, 1.5)]
    lid = splits.ParticleLayer(
        optical_thickness=1.0, refractive_index=1.31, bottom_albedo=None, depth_m=0.1
    )
    for stack in (splits.Stack([lid, sands[0]]), splits.Stack(sands)):
        pairs = {
            (i.outer_material, i.inner_material)
            for i in stack.list_interfaces()
            if i.location == "boundary"
        }
        names = stack.list_materials()
        told = {(names[near], names[far]) for near, far in pairs}
        below = "layers.1.air" if "layers.1.air" in names else names[0]
        assert any(below in pair for pair in told), told
