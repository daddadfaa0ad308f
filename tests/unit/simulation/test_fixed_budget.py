"""Spectra from a fixed number of rays: right, reproducible, smooth in the medium's parameters."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound

from splits import Sand, Snow, spectrophotometer
from splits.simulation.fixed_budget import choose_node_rows, estimate_fixed_budget
from splits.simulation.interpolation_bounds import compute_contrasts
from splits.simulation.runner import RAYS_PER_CHUNK
from splits.simulation.spectral_nodes import make_nodes

WAVELENGTHS = np.arange(400.0, 1001.0, 50.0)
ROWS = choose_node_rows(len(WAVELENGTHS))
SAND = {
    "iron_oxide": 0.015,
    "hematite_ratio": 0.3,
    "magnetite": 0.02,
    "partition": (0.3, 0.4, 0.3),
    "texture": (0.003, 0.08, 0.917),
}
NEIGHBOURS = {
    "clay": {"texture": (0.0033, 0.08, 0.9167)},
    "magnetite": {"magnetite": 0.022},
    "iron oxide": {"iron_oxide": 0.0153},
}


def simulate_fixed(medium, rays, seed, threads=None):
    return estimate_fixed_budget(medium, WAVELENGTHS, 10.0, ROWS, rays, seed, threads)


@NEEDS_JIT
@pytest.mark.parametrize(
    "medium", [Sand(**SAND), Snow(saturation=0.3, depth_m=0.03)], ids=["sand", "snow"]
)
def test_it_agrees_with_the_spectrophotometer(medium):
    mean, stderr, groups = simulate_fixed(medium, 32_768, 1)
    other = spectrophotometer(medium, WAVELENGTHS, 10.0, max_stderr=0.003, seed=2)
    assert mean.shape == stderr.shape == (3, len(WAVELENGTHS))
    np.testing.assert_allclose(mean.sum(axis=0), 1.0, rtol=1e-12)
    assert (stderr > 0.0).all()
    seen = mean[:2] > 0.0
    np.testing.assert_allclose((groups**2).sum(axis=0)[seen], stderr[:2][seen] ** 2, rtol=1e-9)
    for row, name in enumerate(("reflectance", "transmittance", "absorptance")):
        error = np.hypot(stderr[row], other[f"{name}_stderr"])
        # 0.01 is what interpolation between three nodes may miss.
        bound = 0.01 + compute_z_bound(3 * len(WAVELENGTHS)) * error
        assert (np.abs(mean[row] - other[name]) < bound).all()


@NEEDS_JIT
def test_more_rays_mean_smaller_errors():
    few, many = (
        simulate_fixed(Sand(**SAND), rays, 1)[1][0]
        for rays in (4 * RAYS_PER_CHUNK, 64 * RAYS_PER_CHUNK)
    )
    np.testing.assert_allclose(few / many, 4.0, rtol=0.3)


@NEEDS_JIT
def test_the_same_seed_gives_the_same_numbers_on_any_number_of_threads():
    one, two, other = (
        simulate_fixed(Sand(**SAND), 256, seed, threads)[0]
        for seed, threads in ((5, 1), (5, 3), (6, 1))
    )
    np.testing.assert_array_equal(one, two)
    assert (one[0] != other[0]).all()


@pytest.fixture(scope="module")
def base():
    return np.array([simulate_fixed(Sand(**SAND), 256, seed)[0][0] for seed in range(16)])


@NEEDS_JIT
@pytest.mark.parametrize("neighbour", NEIGHBOURS)
def test_neighbours_share_most_of_their_noise(base, neighbour):
    medium = Sand(**{**SAND, **NEIGHBOURS[neighbour]})
    near = np.array([simulate_fixed(medium, 256, seed)[0][0] for seed in range(16)])
    common = (near - base).var(axis=0, ddof=1).sum()
    independent = (near.var(axis=0, ddof=1) + base.var(axis=0, ddof=1)).sum()
    assert independent > 5.0 * common


def test_nodes_at_given_wavelengths_are_kept_and_serve_all():
    medium = Sand(**SAND)
    index = medium.compute_refractive_indices(WAVELENGTHS)
    nodes = make_nodes(index, medium.list_interfaces(), ROWS)
    np.testing.assert_array_equal(nodes.index, index[list(ROWS)])
    np.testing.assert_allclose(nodes.weights.sum(axis=0), 1.0, rtol=1e-12)
    assert ((nodes.weights > 0.0).sum(axis=0) <= 2).all()
    np.testing.assert_array_equal(nodes.weights[:, list(ROWS)], np.eye(len(ROWS)))
    assert (nodes.interpolation_bound[list(ROWS)] == 0.0).all()
    own, drawn = (
        compute_contrasts(i, medium.list_interfaces()).sum(axis=1) for i in (index, nodes.index)
    )
    np.testing.assert_allclose(nodes.weights.T @ drawn, own, rtol=0.05)


@NEEDS_JIT
def test_a_node_that_nothing_draws_on_is_not_in_the_way():
    # Snow of one index: the first node serves every wavelength.
    snow = Snow(saturation=0.0, refractive_index={"ice": 1.31})
    mean, *_ = simulate_fixed(snow, 128, 1)
    alone, *_ = estimate_fixed_budget(snow, WAVELENGTHS, 10.0, ROWS[:1], 128, 1)
    np.testing.assert_array_equal(mean, alone)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"node_rows": []}, "node_rows"),
        ({"node_rows": [0, 0]}, "node_rows"),
        ({"node_rows": [13]}, "node_rows.*0 to 12"),
        ({"rays_per_node": 0}, "rays_per_node = 0"),
        ({"rays_per_node": 1.5}, "rays_per_node = 1.5"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": True}, "seed = True"),
        ({"incidence_deg": 90.0}, "incidence_deg"),
        ({"wavelength_nm": [500.0, 400.0]}, "increasing"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    good = {
        "wavelength_nm": WAVELENGTHS,
        "incidence_deg": 0.0,
        "node_rows": ROWS,
        "rays_per_node": 128,
        "seed": 1,
    }
    with pytest.raises(ValueError, match=message):
        estimate_fixed_budget(Snow(), **{**good, **arguments})
