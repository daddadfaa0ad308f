"""Stopping rule of profiles: quantities by band or wavelength, and their variance terms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from splits.instruments.flux_errors import (
    MIN_NONZERO_BATCHES,
    bound_unsampled_light,
    estimate_rare_event_error,
)
from splits.instruments.flux_stopping_rule import (
    FluxStoppingRule,
    allocate_flux_rays,
    make_variance_terms,
)
from splits.simulation.tally import N_BATCHES

RANDOM = np.random.default_rng(1)


def make_strata(*masks):
    return SimpleNamespace(
        strata=[SimpleNamespace(wavelength_mask=np.array(mask, dtype=bool)) for mask in masks]
    )


ENSEMBLES = [make_strata([1, 1, 1, 0], [0, 1, 1, 0]), make_strata([0, 1, 1, 1])]
DEVIATIONS = [
    RANDOM.random((N_BATCHES, 3, 4)) * np.array([1, 1, 1, 0]),
    RANDOM.random((N_BATCHES, 3, 4)) * np.array([0, 1, 1, 1]),
]


def test_variance_terms_of_bands_add_up():
    rule = FluxStoppingRule(0.01, True, RANDOM.random((2, 4)), np.ones(2))
    terms = make_variance_terms(rule, ENSEMBLES, DEVIATIONS)
    np.testing.assert_allclose(terms.values.sum(axis=0), rule.average_over_bands(sum(DEVIATIONS)))
    # The first wavelength uses one stratum of the first ensemble, the next two use both.
    assert terms.membership.tolist() == [[1, 0, 0], [1, 1, 0], [0, 0, 1]]
    assert terms.column_mask.shape == (3, 2)
    assert terms.column_mask.all()


def test_variance_terms_of_wavelengths_are_ensembles():
    terms = make_variance_terms(FluxStoppingRule(0.01), ENSEMBLES, DEVIATIONS)
    assert terms.membership.tolist() == [[1, 1, 0], [0, 0, 1]]
    np.testing.assert_array_equal(terms.values, np.stack(DEVIATIONS))


def test_rays_are_allocated_by_variance():
    """A wavelength that uses one ensemble only needs no rays of the other."""
    ensembles = [make_strata([1, 1, 0]), make_strata([0, 1, 1])]
    for stratum in (member for e in ensembles for member in e.strata):
        stratum.n_rays, stratum.n_segments = 1024, 10 * 1024
    scatter = (
        RANDOM.standard_normal((2, N_BATCHES, 1, 3))
        * np.array([[1, 0.5, 0], [0, 0.5, 1]])[:, np.newaxis, np.newaxis]
    )
    error = scatter.sum(axis=0).std(axis=0, ddof=1).max() / np.sqrt(N_BATCHES)
    rule = FluxStoppingRule(error / 2.0, False)
    n_rays = allocate_flux_rays(rule, ensembles, [0.1 + row for row in scatter], np.zeros((1, 3)))
    assert (n_rays > 1.5 * 1024).all()
    assert (n_rays < 6.0 * 1024).all()


def test_irradiances_are_optional_in_the_stopping_rule():
    irradiance, absorptance = RANDOM.random((N_BATCHES, 2, 3, 4)), RANDOM.random((N_BATCHES, 2, 4))
    assert FluxStoppingRule(0.01).select_quantities(irradiance, absorptance).shape == (
        N_BATCHES,
        8,
        4,
    )
    rows = FluxStoppingRule(0.01, limit_irradiance=False).select_quantities(irradiance, absorptance)
    np.testing.assert_array_equal(rows[:, 0], irradiance[:, 1, 0])
    np.testing.assert_array_equal(rows[:, 1:], absorptance)


def test_limits_are_fractions_of_the_band_variance():
    fractions = np.array([0.3, 1.0])
    one, other = (
        FluxStoppingRule(0.01, band_weights=np.ones((2, 1)), variance_fractions=fraction)
        for fraction in (fractions, 1 - fractions)
    )
    np.testing.assert_allclose(one.stderr_limits**2 + other.stderr_limits**2, 1e-4)


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
    skewed[: MIN_NONZERO_BATCHES - 2] = 1.0
    bound = np.array([0.01])
    assert estimate_rare_event_error(none, bound) == 0.01
    assert estimate_rare_event_error(one, bound) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(skewed, bound) == 1.0 / N_BATCHES
    assert estimate_rare_event_error(every, bound) == 0.0
