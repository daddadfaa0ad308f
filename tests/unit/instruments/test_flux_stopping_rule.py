"""What profiles are asked for: quantities by band or wavelength, and who contributes to them."""

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


def make_strata(*served):
    return SimpleNamespace(
        strata=[SimpleNamespace(wavelength_mask=np.array(one, dtype=bool)) for one in served]
    )


N_PATH_GROUPS = [make_strata([1, 1, 1, 0], [0, 1, 1, 0]), make_strata([0, 1, 1, 1])]
ROWS = [
    RANDOM.random((N_BATCHES, 3, 4)) * np.array([1, 1, 1, 0]),
    RANDOM.random((N_BATCHES, 3, 4)) * np.array([0, 1, 1, 1]),
]


def test_members_of_bands_add_up():
    goal = FluxStoppingRule(0.01, True, RANDOM.random((2, 4)), np.ones(2))
    members = make_variance_terms(goal, N_PATH_GROUPS, ROWS)
    np.testing.assert_allclose(members.values.sum(axis=0), goal.average_over_bands(sum(ROWS)))
    # The first wavelength hears one level of the first ensemble, the next two hear both.
    assert members.membership.tolist() == [[1, 0, 0], [1, 1, 0], [0, 0, 1]]
    assert members.column_mask.shape == (3, 2)
    assert members.column_mask.all()


def test_members_of_wavelengths_are_ensembles():
    members = make_variance_terms(FluxStoppingRule(0.01), N_PATH_GROUPS, ROWS)
    assert members.membership.tolist() == [[1, 1, 0], [0, 0, 1]]
    np.testing.assert_array_equal(members.values, np.stack(ROWS))


def test_rays_wanted_by_wavelength_are_what_the_variance_asks_for():
    """A wavelength that draws on one ensemble alone asks nothing of the other."""
    ensembles = [make_strata([1, 1, 0]), make_strata([0, 1, 1])]
    for level in (one for e in ensembles for one in e.strata):
        level.n_rays, level.n_segments = 1024, 10 * 1024
    scatter = (
        RANDOM.standard_normal((2, N_BATCHES, 1, 3))
        * np.array([[1, 0.5, 0], [0, 0.5, 1]])[:, np.newaxis, np.newaxis]
    )
    error = scatter.sum(axis=0).std(axis=0, ddof=1).max() / np.sqrt(N_BATCHES)
    goal = FluxStoppingRule(error / 2.0, False)
    found = allocate_flux_rays(goal, ensembles, [0.1 + each for each in scatter], np.zeros((1, 3)))
    assert (found > 1.5 * 1024).all()
    assert (found < 6.0 * 1024).all()


def test_quantities_are_irradiances_or_only_what_is_absorbed_and_reflected():
    light, absorbed = RANDOM.random((N_BATCHES, 2, 3, 4)), RANDOM.random((N_BATCHES, 2, 4))
    assert FluxStoppingRule(0.01).select_quantities(light, absorbed).shape == (N_BATCHES, 8, 4)
    rows = FluxStoppingRule(0.01, limit_irradiance=False).select_quantities(light, absorbed)
    np.testing.assert_array_equal(rows[:, 0], light[:, 1, 0])
    np.testing.assert_array_equal(rows[:, 1:], absorbed)


def test_limits_share_the_variance_of_a_band():
    parts = np.array([0.3, 1.0])
    one, other = (
        FluxStoppingRule(0.01, band_weights=np.ones((2, 1)), variance_fractions=share)
        for share in (parts, 1 - parts)
    )
    np.testing.assert_allclose(one.stderr_limits**2 + other.stderr_limits**2, 1e-4)


def test_what_is_not_seen_is_at_most_what_reaches_the_plane_above():
    down = np.zeros((N_BATCHES, 4, 1))
    down[:, 0], down[:, 1] = 1.0, 1e-6
    least = np.array([1e-3])
    expected = [1e-3, 1e-3, 4e-6, 4e-6, 4e-6]
    np.testing.assert_allclose(bound_unsampled_light(down, least)[:, 0], expected)


def test_what_few_groups_decide_may_be_off_by_one_more():
    none, one, every = np.zeros((N_BATCHES, 1)), np.zeros((N_BATCHES, 1)), np.ones((N_BATCHES, 1))
    one[0] = 1.0
    skew = np.full((N_BATCHES, 1), 1e-6)
    skew[: MIN_NONZERO_BATCHES - 2] = 1.0
    unseen = np.array([0.01])
    assert estimate_rare_event_error(none, unseen) == 0.01
    assert estimate_rare_event_error(one, unseen) == np.hypot(0.01, 1.0 / N_BATCHES)
    assert estimate_rare_event_error(skew, unseen) == 1.0 / N_BATCHES
    assert estimate_rare_event_error(every, unseen) == 0.0
