"""Quantities inside a medium that determine when a run stops, and their variance terms."""

from __future__ import annotations

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.flux_tally import (
    MIN_EFFECTIVE_BATCHES,
    FluxTarget,
    allocate_flux_rays,
    bound_unsampled_light,
    estimate_rare_event_error,
    estimate_unseen_reflection,
    make_variance_terms,
)
from splits.instruments.profiles import make_sky_targets
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.strata import Stratum
from splits.simulation.tally import UNSEEN_RAYS

RANDOM = np.random.default_rng(1)
ROWS = np.array([0, 1, 2, 1, 2, 3])
"""Wavelengths of the node rows: three of the first node, three of the second."""
CONTRIBUTES = np.array([[1, 1, 1, 0, 0, 0], [0, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], dtype=bool)
"""The first node has two strata, the second has one."""
VALUES = RANDOM.random((N_BATCHES, 3, 6))


def make_uncorrelated_values():
    """Return values whose scatter is not correlated between node rows of different strata."""
    contrasts = np.linalg.qr(np.column_stack([np.ones(N_BATCHES), RANDOM.random((N_BATCHES, 3))]))
    pattern = np.array([1, 2, 2, 3, 3, 3])
    return contrasts.Q[:, np.newaxis, pattern] * RANDOM.random((3, 6))


def test_variance_terms_of_bands_add_up():
    target = FluxTarget(True, RANDOM.random((2, 4)), np.ones(2))
    terms = make_variance_terms(target, VALUES, ROWS, CONTRIBUTES)
    # The first wavelength uses one stratum of the first node, the next two use both.
    node_rows_by_strata = {(1, 0, 0): [0], (1, 1, 0): [1, 2], (0, 0, 1): [3, 4, 5]}
    columns = [
        terms.columns[(one == terms.contributes.T).all(axis=1)] for one in node_rows_by_strata
    ]
    assert [sorted(one) for one in columns] == [[0, 1]] * 3
    assert terms.variances.shape == (3, 6)
    for strata, node_rows in node_rows_by_strata.items():
        by_band = VALUES[..., node_rows] @ target.band_weights[:, ROWS[node_rows]].T
        for band in range(2):
            term = (strata == terms.contributes.T).all(axis=1) & (terms.columns == band)
            np.testing.assert_allclose(
                terms.variances[:, term], compute_batch_stderr(by_band[..., [band]]) ** 2
            )
    uncorrelated = make_uncorrelated_values()
    terms = make_variance_terms(target, uncorrelated, ROWS, CONTRIBUTES)
    by_wavelength = np.zeros((N_BATCHES, 3, 4))
    np.add.at(by_wavelength, (..., ROWS), uncorrelated)
    np.testing.assert_allclose(
        terms.sum_columns(terms.variances),
        compute_batch_stderr(target.average_over_bands(by_wavelength)) ** 2,
    )


def test_variance_terms_of_wavelengths_are_node_rows():
    terms = make_variance_terms(FluxTarget(), VALUES, ROWS, CONTRIBUTES)
    np.testing.assert_array_equal(terms.contributes, CONTRIBUTES)
    np.testing.assert_array_equal(terms.columns, ROWS)
    np.testing.assert_allclose(terms.variances, compute_batch_stderr(VALUES) ** 2)


def test_rays_are_allocated_by_variance():
    """A wavelength that uses one node only needs no rays of the other."""
    strata = [Stratum(i, None, slice(0), None, n_rays=1024, n_segments=10 * 1024) for i in range(2)]
    scatter = (
        RANDOM.standard_normal((2, N_BATCHES, 1, 3))
        * np.array([[1, 0.5, 0], [0, 0.5, 1]])[:, np.newaxis, np.newaxis]
    )
    error = scatter.sum(axis=0).std(axis=0, ddof=1).max() / np.sqrt(N_BATCHES)
    values = 0.1 + np.concatenate([scatter[0][..., :2], scatter[1][..., 1:]], axis=-1)
    contributes = np.array([[1, 1, 0, 0], [0, 0, 1, 1]], dtype=bool)
    max_variance = np.full((1, 3), (error / 2.0) ** 2)
    n_rays = allocate_flux_rays(
        FluxTarget(False), strata, values, np.array([0, 1, 1, 2]), contributes, max_variance
    )
    assert (n_rays > 1.5 * 1024).all()
    assert (n_rays < 6.0 * 1024).all()


def test_irradiances_are_optional_in_the_target():
    # Two irradiances at three depths, and absorptances of two intervals.
    quantities = RANDOM.random((N_BATCHES, 8, 4))
    np.testing.assert_array_equal(FluxTarget().select_quantities(quantities, 3), quantities)
    rows = FluxTarget(limit_irradiance=False).select_quantities(quantities, 3)
    np.testing.assert_array_equal(rows, quantities[:, [3, 6, 7]])


def test_variance_fractions_of_direct_and_diffuse_light_add_up():
    direct_fraction, weights = RANDOM.random(4), RANDOM.random((2, 4))
    direct, diffuse = make_sky_targets(direct_fraction, weights, limit_irradiance=False)
    np.testing.assert_allclose(direct.variance_fractions + diffuse.variance_fractions, 1.0)


def test_unsampled_light_is_bounded_by_the_plane_above():
    downward = np.zeros((N_BATCHES, 4, 1))
    downward[:, 0], downward[:, 1] = 1.0, 1e-6
    lower_bound = np.array([1e-3])
    expected = [1e-3, 1e-3, 4e-6, 4e-6, 4e-6]
    np.testing.assert_allclose(bound_unsampled_light(downward, lower_bound)[:, 0], expected)


def test_rare_event_error_accounts_for_few_batches():
    none, one, every = np.zeros((N_BATCHES, 1)), np.zeros((N_BATCHES, 1)), np.ones((N_BATCHES, 1))
    one[0] = 1.0
    skewed = np.full((N_BATCHES, 1), 1e-6)
    skewed[: MIN_EFFECTIVE_BATCHES - 2] = 1.0
    bound = np.array([0.01])
    assert estimate_rare_event_error(none, bound) == 0.01
    assert estimate_rare_event_error(one, bound) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(skewed, bound) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(every, bound) == 0.0


def test_upward_light_without_scatter_has_the_error_of_unseen_reflections():
    """Where all light is reflected, no ray can add to it."""
    downward = np.ones((N_BATCHES, 3, 1))
    upward = np.full((N_BATCHES, 3, 1), 1e-9)
    upward[:, 1], upward[:, 2] = 1.0, 0.5
    upward[: N_BATCHES // 2, 2] = 0.4
    error = estimate_unseen_reflection(downward, upward, np.full((3, 1), 1e-3))
    np.testing.assert_allclose(error[:, 0], [np.sqrt(UNSEEN_RAYS) * 1e-3, 0.0, 0.0], atol=1e-9)
