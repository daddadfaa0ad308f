"""Spectra from a fixed number of rays: accuracy, reproducibility, correlated noise."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound

from splits import Sand, Snow, spectrophotometer
from splits.simulation.spectral_nodes import compute_contrasts, make_nodes
from splits.simulation.spectral_tally import choose_node_rows, estimate_fixed_budget
from splits.simulation.tally import RAYS_PER_CHUNK

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
def test_fixed_budget_agrees_with_the_spectrophotometer(medium):
    mean, stderr, batches = simulate_fixed(medium, 32_768, 1)
    expected = spectrophotometer(medium, WAVELENGTHS, 10.0, max_stderr=0.003, seed=2)
    assert mean.shape == stderr.shape == (3, len(WAVELENGTHS))
    np.testing.assert_allclose(mean.sum(axis=0), 1.0, rtol=1e-12)
    assert (stderr > 0.0).all()
    detected = mean[:2] > 0.0
    np.testing.assert_allclose(
        (batches**2).sum(axis=0)[detected], stderr[:2][detected] ** 2, rtol=1e-9
    )
    for row, name in enumerate(("reflectance", "transmittance", "absorptance")):
        error = np.hypot(stderr[row], expected[f"{name}_stderr"])
        # 0.01 is a bound of the interpolation error between three nodes.
        bound = 0.01 + compute_z_bound(3 * len(WAVELENGTHS)) * error
        assert (np.abs(mean[row] - expected[name]) < bound).all()


@NEEDS_JIT
def test_errors_decrease_with_the_number_of_rays():
    coarse, fine = (
        simulate_fixed(Sand(**SAND), rays, 1)[1][0]
        for rays in (4 * RAYS_PER_CHUNK, 64 * RAYS_PER_CHUNK)
    )
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.3)


@NEEDS_JIT
def test_result_is_independent_of_the_number_of_threads():
    one_thread, three_threads, other_seed = (
        simulate_fixed(Sand(**SAND), 256, seed, threads)[0]
        for seed, threads in ((5, 1), (5, 3), (6, 1))
    )
    np.testing.assert_array_equal(one_thread, three_threads)
    assert (one_thread[0] != other_seed[0]).all()


@pytest.fixture(scope="module")
def base():
    return np.array([simulate_fixed(Sand(**SAND), 256, seed)[0][0] for seed in range(16)])


@NEEDS_JIT
@pytest.mark.parametrize("neighbour", NEIGHBOURS)
def test_noise_of_similar_media_is_correlated(base, neighbour):
    medium = Sand(**{**SAND, **NEIGHBOURS[neighbour]})
    perturbed = np.array([simulate_fixed(medium, 256, seed)[0][0] for seed in range(16)])
    common = (perturbed - base).var(axis=0, ddof=1).sum()
    independent = (perturbed.var(axis=0, ddof=1) + base.var(axis=0, ddof=1)).sum()
    assert independent > 5.0 * common


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


@NEEDS_JIT
def test_unused_nodes_do_not_affect_the_result():
    # With a constant index all wavelengths use the first node.
    snow = Snow(saturation=0.0, refractive_index={"ice": 1.31})
    mean, *_ = simulate_fixed(snow, 128, 1)
    single, *_ = estimate_fixed_budget(snow, WAVELENGTHS, 10.0, ROWS[:1], 128, 1)
    np.testing.assert_array_equal(mean, single)


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
def test_invalid_input_is_rejected(arguments, message):
    valid = {
        "wavelength_nm": WAVELENGTHS,
        "incidence_deg": 0.0,
        "node_rows": ROWS,
        "rays_per_node": 128,
        "seed": 1,
    }
    with pytest.raises(ValueError, match=message):
        estimate_fixed_budget(Snow(), **{**valid, **arguments})
