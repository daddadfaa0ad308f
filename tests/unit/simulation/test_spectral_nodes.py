"""Spectra from few refractive indices, and from a fixed number of rays."""

import numpy as np
import pytest

import splits
from splits import Sand, Snow
from splits.media.medium import Interface
from splits.simulation.deep_medium import diffuse_reflectance
from splits.simulation.spectral_nodes import (
    MAX_LOG_CURVATURE,
    MAX_NODES,
    choose_nodes,
    compute_contrasts,
    compute_entering_light,
    make_nodes,
)

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
    """Return the interfaces of ice with air and with water of the given fractions."""
    return [Interface(dry, 0, 2), Interface(wet, 1, 2)]


HALF_WET = make_interfaces(0.5, 0.5)


def load_indices(wavelengths, **settings):
    """Return the indices of a sample at the wavelengths of its tables, and its interfaces."""
    snow = Snow(**settings)
    table = snow.refractive_index["ice"].wavelength_nm
    covered = wavelengths[wavelengths >= table[0]]
    return snow.compute_refractive_indices(covered), snow.list_interfaces()


def make_linear_indices(start, stop, n_wavelengths=50, water=1.33):
    """Return indices whose ice changes from start to stop, under air and water."""
    index = np.ones((n_wavelengths, 3), dtype=complex)
    index[:, 1] = water
    index[:, 2] = np.linspace(start, stop, n_wavelengths)
    return index


@pytest.mark.parametrize("tolerance", [0.01, 0.001])
@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_nodes_represent_the_spectrum_within_tolerance(spectrum, sample, tolerance):
    index, interfaces = load_indices(SPECTRA[spectrum], **SAMPLES[sample])
    nodes = choose_nodes(index, interfaces, tolerance)
    assert nodes.weights.shape == (len(nodes.index), len(index))
    assert (nodes.weights >= 0.0).all()
    np.testing.assert_allclose(nodes.weights.sum(axis=0), 1.0, rtol=1e-12)
    assert (nodes.weights.max(axis=1) > 0.0).all(), "every node is used"
    assert ((nodes.weights > 0.0).sum(axis=0) <= 2).all()
    assert nodes.interpolation_bound.shape == (len(index),)
    assert nodes.interpolation_bound.max() <= tolerance
    for node in nodes.index:
        assert (node == index).all(axis=1).any(), "nodes are indices of the spectrum"


def test_number_of_nodes_grows_as_the_tolerance_decreases():
    index, interfaces = load_indices(SPECTRA["solar"])
    counts = [
        len(choose_nodes(index, interfaces, tolerance).index) for tolerance in (0.01, 0.001, 1e-4)
    ]
    assert counts[0] <= 3
    assert counts[1] <= 6
    assert counts == sorted(counts)


def test_a_constant_index_needs_one_node():
    nodes = choose_nodes(make_linear_indices(1.31, 1.31), HALF_WET, 1e-6)
    np.testing.assert_allclose(nodes.index, [[1.0, 1.33, 1.31]])
    assert (nodes.weights == 1.0).all()
    assert (nodes.interpolation_bound == 0.0).all()


@pytest.mark.parametrize("ice_index", [1.31, 1.31 + 1e-6j, 1.31 + 0.2j])
def test_a_single_wavelength_is_its_own_node(ice_index):
    index = make_linear_indices(ice_index, ice_index, n_wavelengths=1)
    nodes = choose_nodes(index, HALF_WET, 1e-6)
    np.testing.assert_allclose(nodes.index, index)
    assert nodes.weights.tolist() == [[1.0]]
    assert nodes.interpolation_bound.tolist() == [0.0]


def test_two_wavelengths_far_apart_are_not_mixed():
    index = make_linear_indices(1.2, 1.6, n_wavelengths=2)
    nodes = choose_nodes(index, HALF_WET, 1e-6)
    np.testing.assert_array_equal(nodes.weights.T @ nodes.index, index)
    assert nodes.interpolation_bound.max() == 0.0


def test_contrast_is_the_relative_index_step():
    index = make_linear_indices(1.31, 1.31, n_wavelengths=3)
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
    index = make_linear_indices(1.30, 1.36, n_wavelengths=61)
    nodes = choose_nodes(index, make_interfaces(0.0, 1.0), 1e-3)
    assert nodes.interpolation_bound.max() <= 1e-3
    exact = compute_contrasts(index, make_interfaces(0.0, 1.0)).sum(axis=1)
    at_nodes = compute_contrasts(nodes.index, make_interfaces(0.0, 1.0)).sum(axis=1)
    np.testing.assert_allclose(nodes.weights.T @ at_nodes, exact, atol=2e-3 * np.abs(exact).max())
    for weights in nodes.weights.T:
        signs = np.sign(at_nodes[weights > 0.0])
        assert signs.min() == signs.max()


def test_few_absorbing_grains_are_resolved():
    # One per cent of opaque grains of varying index: the light that enters them is absorbed.
    index = np.ones((40, 4), dtype=complex)
    index[:, 2] = 1.55
    index[:, 3] = np.linspace(2.1, 2.6, 40) + 0.5j
    interfaces = [Interface(0.99, 0, 2), Interface(0.01, 0, 3)]
    two_nodes = choose_nodes(index[[0, -1]], interfaces, 1.0)
    assert two_nodes.interpolation_bound.max() > 0.02
    assert compute_entering_light(index, interfaces)[:, 0].max() == 0.0
    assert len(choose_nodes(index, interfaces, 1e-3).index) > 1


@pytest.mark.parametrize("sample", ["Table 1", "dry", "filled with water"])
@pytest.mark.parametrize("step", [10.0, 150.0])
def test_node_spacing_satisfies_the_curvature_bound(step, sample):
    # The bound applies to any function of the mean contrast c with |d²f/d(ln c)²| at most
    # MAX_LOG_CURVATURE = C: here ½ C (ln c)².
    index, interfaces = load_indices(np.arange(400.0, 2501.0, step), **SAMPLES[sample])
    tolerance = 1e-3
    nodes = choose_nodes(index, interfaces, tolerance)
    exact = np.log(np.abs(compute_contrasts(index, interfaces)).sum(axis=1))
    at_nodes = np.log(np.abs(compute_contrasts(nodes.index, interfaces)).sum(axis=1))
    middle = exact.mean()
    error = nodes.weights.T @ (0.5 * MAX_LOG_CURVATURE * (at_nodes - middle) ** 2)
    error -= 0.5 * MAX_LOG_CURVATURE * (exact - middle) ** 2
    assert np.abs(error).max() <= tolerance
    assert np.abs(nodes.weights.T @ at_nodes - exact).max() <= 0.1


def test_absent_water_needs_no_nodes():
    index = make_linear_indices(1.30, 1.36, n_wavelengths=61)
    with_water = choose_nodes(index, make_interfaces(0.0, 1.0), 1e-3)
    without = choose_nodes(index, make_interfaces(1.0, 0.0), 1e-3)
    assert len(without.index) < len(with_water.index)


def test_extinction_needs_nodes_only_if_it_reflects():
    index = make_linear_indices(1.31, 1.31)
    index[:, 2] += 1j * np.geomspace(1e-9, 1e-3, 50)
    assert len(choose_nodes(index, HALF_WET, 1e-3).index) == 1
    index[:, 2] += 1j * np.linspace(0.0, 1.0, 50)
    assert len(choose_nodes(index, HALF_WET, 1e-3).index) > 3


def test_too_many_nodes_become_one_per_wavelength():
    index = make_linear_indices(1.2, 1.6, n_wavelengths=3 * MAX_NODES)
    nodes = choose_nodes(index, HALF_WET, 1e-9)
    np.testing.assert_array_equal(nodes.weights.T @ nodes.index, index)
    assert (nodes.interpolation_bound == 0.0).all()


def test_the_order_of_wavelengths_does_not_matter():
    index, interfaces = load_indices(SPECTRA["solar"])
    nodes, reversed_nodes = (choose_nodes(i, interfaces, 0.001) for i in (index, index[::-1]))
    np.testing.assert_array_equal(nodes.index, reversed_nodes.index)
    np.testing.assert_array_equal(
        nodes.interpolation_bound, reversed_nodes.interpolation_bound[::-1]
    )


def test_a_weakly_reflecting_boundary_needs_few_nodes():
    """A doubling of a reflectance of 1e-6 is far below the tolerance."""
    index = np.ones((50, 2), dtype=complex)
    index[:, 0], index[:, 1] = 1.33, np.linspace(1.329, 1.331, 50)
    faint = choose_nodes(index, [Interface(1.0, 0, 1, "boundary")], 0.002)
    assert len(faint.index) <= 2
    index[:, 1] += 0.2
    strong = choose_nodes(index, [Interface(1.0, 0, 1, "boundary")], 1e-5)
    assert len(strong.index) > len(faint.index)


@pytest.mark.parametrize("layer_index", [1.32, 1.33, 1.335, 1.5])
@pytest.mark.parametrize("bottom_reflectance", [0.0, 0.02, 0.3, 0.9])
def test_boundary_reflectance_stays_within_its_bound(layer_index, bottom_reflectance):
    """A layer on wet sand whose optically denser side changes with wavelength.

    Diffuse light, a clear layer, and pores that reflect a fraction of the light that enters.
    """
    wavelengths = np.arange(400.0, 1001.0, 50.0)
    layer = splits.ParticleLayer(
        optical_thickness=1.0, refractive_index=layer_index, ground=None, depth_m=0.02
    )
    stack = splits.Stack([layer, splits.Sand(saturation=1.0)])
    index = stack.compute_refractive_indices(wavelengths)
    names = stack.list_materials()
    n = index[:, names.index("layers.1.water")].real / layer_index
    outer, inner = diffuse_reflectance(n), diffuse_reflectance(1.0 / n)
    reflectance = outer + (1.0 - outer) * (1.0 - inner) * bottom_reflectance / (
        1.0 - inner * bottom_reflectance
    )
    for tolerance in (1e-2, 1e-3, 2e-4):
        nodes = choose_nodes(index, stack.list_interfaces(), tolerance)
        rows = [np.flatnonzero((index == node).all(axis=1))[0] for node in nodes.index]
        error = np.abs(reflectance[rows] @ nodes.weights - reflectance)
        assert (error <= nodes.interpolation_bound + 1e-12).all(), (
            tolerance,
            error.max(),
            nodes.interpolation_bound.max(),
        )


def test_boundaries_with_varying_indices_are_listed():
    def make_air(last):
        return {"air": {"wavelength_nm": [400, 1000], "n": [1.5, last], "k": [0, 0]}}

    sands = [splits.Sand(refractive_index=make_air(last)) for last in (1.4, 1.5)]
    layer = splits.ParticleLayer(
        optical_thickness=1.0, refractive_index=1.31, ground=None, depth_m=0.1
    )
    for stack in (splits.Stack([layer, sands[0]]), splits.Stack(sands)):
        pairs = {
            (i.outer_material, i.inner_material)
            for i in stack.list_interfaces()
            if i.location == "boundary"
        }
        names = stack.list_materials()
        boundary_pairs = {(names[near], names[far]) for near, far in pairs}
        lower_air = "layers.1.air" if "layers.1.air" in names else names[0]
        assert any(lower_air in pair for pair in boundary_pairs), boundary_pairs


WAVELENGTHS = np.arange(400.0, 1001.0, 50.0)
ROWS = (0, 4, len(WAVELENGTHS) - 1)
SAND = {
    "iron_oxide": 0.015,
    "hematite_ratio": 0.3,
    "magnetite": 0.02,
    "partition": (0.3, 0.4, 0.3),
    "texture": (0.003, 0.08, 0.917),
}


def test_nodes_at_given_wavelengths_represent_the_spectrum():
    medium = Sand(**SAND)
    index = medium.compute_refractive_indices(WAVELENGTHS)
    nodes = make_nodes(index, medium.list_interfaces(), ROWS)
    np.testing.assert_array_equal(nodes.index, index[list(ROWS)])
    np.testing.assert_allclose(nodes.weights.sum(axis=0), 1.0, rtol=1e-12)
    assert ((nodes.weights > 0.0).sum(axis=0) <= 2).all()
    np.testing.assert_array_equal(nodes.weights[:, list(ROWS)], np.eye(len(ROWS)))
    assert (nodes.interpolation_bound[list(ROWS)] == 0.0).all()
    exact, at_nodes = (
        compute_contrasts(i, medium.list_interfaces()).sum(axis=1) for i in (index, nodes.index)
    )
    np.testing.assert_allclose(nodes.weights.T @ at_nodes, exact, rtol=0.05)
