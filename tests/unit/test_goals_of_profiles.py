"""What profiles are asked for: quantities by band or wavelength, and who contributes to them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from splits.instruments.ensemble import GROUPS
from splits.instruments.inside_errors import FEW, rare_of, unseen_light
from splits.instruments.inside_goal import Goal, members_of, wanted

RANDOM = np.random.default_rng(1)


def levels(*served):
    return SimpleNamespace(
        levels=[SimpleNamespace(served=np.array(one, dtype=bool)) for one in served]
    )


ENSEMBLES = [levels([1, 1, 1, 0], [0, 1, 1, 0]), levels([0, 1, 1, 1])]
ROWS = [
    RANDOM.random((GROUPS, 3, 4)) * np.array([1, 1, 1, 0]),
    RANDOM.random((GROUPS, 3, 4)) * np.array([0, 1, 1, 1]),
]


def test_members_of_bands_add_up():
    goal = Goal(0.01, True, RANDOM.random((2, 4)), np.ones(2))
    members = members_of(goal, ENSEMBLES, ROWS)
    np.testing.assert_allclose(members.values.sum(axis=0), goal.average_over_bands(sum(ROWS)))
    # The first wavelength hears one level of the first ensemble, the next two hear both.
    assert members.membership.tolist() == [[1, 0, 0], [1, 1, 0], [0, 0, 1]]
    assert members.column_mask.shape == (3, 2)
    assert members.column_mask.all()


def test_members_of_wavelengths_are_ensembles():
    members = members_of(Goal(0.01), ENSEMBLES, ROWS)
    assert members.membership.tolist() == [[1, 1, 0], [0, 0, 1]]
    np.testing.assert_array_equal(members.values, np.stack(ROWS))


def test_rays_wanted_by_wavelength_are_what_the_variance_asks_for():
    """A wavelength that draws on one ensemble alone asks nothing of the other."""
    ensembles = [levels([1, 1, 0]), levels([0, 1, 1])]
    for level in (one for e in ensembles for one in e.levels):
        level.n_rays, level.n_segments = 1024, 10 * 1024
    scatter = (
        RANDOM.standard_normal((2, GROUPS, 1, 3))
        * np.array([[1, 0.5, 0], [0, 0.5, 1]])[:, np.newaxis, np.newaxis]
    )
    error = scatter.sum(axis=0).std(axis=0, ddof=1).max() / np.sqrt(GROUPS)
    goal = Goal(error / 2.0, False)
    found = wanted(goal, ensembles, [0.1 + each for each in scatter], np.zeros((1, 3)))
    assert (found > 1.5 * 1024).all()
    assert (found < 6.0 * 1024).all()


def test_quantities_are_irradiances_or_only_what_is_absorbed_and_reflected():
    light, absorbed = RANDOM.random((GROUPS, 2, 3, 4)), RANDOM.random((GROUPS, 2, 4))
    assert Goal(0.01).select_quantities(light, absorbed).shape == (GROUPS, 8, 4)
    rows = Goal(0.01, limit_irradiance=False).select_quantities(light, absorbed)
    np.testing.assert_array_equal(rows[:, 0], light[:, 1, 0])
    np.testing.assert_array_equal(rows[:, 1:], absorbed)


def test_limits_share_the_variance_of_a_band():
    parts = np.array([0.3, 1.0])
    one, other = (Goal(0.01, band_weights=np.ones((2, 1)), variance_fractions=share) for share in (parts, 1 - parts))
    np.testing.assert_allclose(one.stderr_limits**2 + other.stderr_limits**2, 1e-4)


def test_what_is_not_seen_is_at_most_what_reaches_the_plane_above():
    down = np.zeros((GROUPS, 4, 1))
    down[:, 0], down[:, 1] = 1.0, 1e-6
    least = np.array([1e-3])
    expected = [1e-3, 1e-3, 4e-6, 4e-6, 4e-6]
    np.testing.assert_allclose(unseen_light(down, least)[:, 0], expected)


def test_what_few_groups_decide_may_be_off_by_one_more():
    none, one, every = np.zeros((GROUPS, 1)), np.zeros((GROUPS, 1)), np.ones((GROUPS, 1))
    one[0] = 1.0
    skew = np.full((GROUPS, 1), 1e-6)
    skew[: FEW - 2] = 1.0
    unseen = np.array([0.01])
    assert rare_of(none, unseen) == 0.01
    assert rare_of(one, unseen) == np.hypot(0.01, 1.0 / GROUPS)
    assert rare_of(skew, unseen) == 1.0 / GROUPS
    assert rare_of(every, unseen) == 0.0
