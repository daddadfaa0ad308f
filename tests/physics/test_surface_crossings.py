"""Rays at rough surfaces: none gets through unseen or is lost, and what they see is reciprocal."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, SEED, compute_p_of_values, draw_samples, judge_p, judge_z
from chi2 import scale_sample_size as sample_size
from events import sample_unit_sphere
from numba import njit
from scipy import stats

from splits.kernels.math import rng
from splits.kernels.math.vectors import Vector, add_scaled, scale
from splits.kernels.particle_layer.leak_census import (
    INTERSECTIONS,
    LEAKS,
    LOST_RAYS,
    SEGMENTS,
    count_leaks,
)
from splits.kernels.rough_surface.intersection import NO_HIT, find_first_intersection
from splits.kernels.rough_surface.realization import (
    allocate_realization,
    compute_height_and_slope,
    sample_realization,
)
from splits.media.rough_surface import RoughSurface

GAUSSIAN = {"wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
SEA = GAUSSIAN | {"rms_height_m": 0.1}
STEEP = GAUSSIAN | {"rms_height_m": 1.0}
FINE = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "waves": 24, "band_limit_per_m": 100.0}
PRINTED = FINE | {"correlation": "exponential_printed", "band_limit_per_m": None}
PAIR = [
    PRINTED | {"rms_height_m": 11.25, "wave_number_per_m": 0.025},
    PRINTED | {"rms_height_m": 0.2, "wave_number_per_m": 3.0},
]
# Surface, refractive index, angle of incidence, rays.
CASES = {
    "water": (SEA, 1.34, 40.0, 60_000),
    "water, grazing": (SEA, 1.34, 89.9, 30_000),
    "glass, steep": (STEEP, 1.52, 40.0, 40_000),
    "glass, steep, grazing": (STEEP, 1.52, 89.9, 15_000),
    "glass, exponential": (FINE, 1.52, 60.0, 40_000),
    "glass, no end of slopes": (FINE | {"band_limit_per_m": math.inf}, 1.52, 20.0, 12_000),
    "water, two scales": (PAIR, 1.34, 70.0, 20_000),
    "no contrast": (STEEP, 1.0, 60.0, 40_000),
}


@NEEDS_JIT
@pytest.mark.parametrize("name", CASES)
def test_no_ray_gets_through_unseen_or_lost(name):
    surface, index, angle, rays = CASES[name]
    fields = RoughSurface.from_input(surface).make_height_fields()
    mu = math.cos(math.radians(angle))
    counts, hits = count_leaks(SEED, 0, rays, fields, index, mu)
    print(f"{name}: {counts[INTERSECTIONS]} crossings, {counts[SEGMENTS]} legs")
    assert counts[LEAKS] == counts[LOST_RAYS] == 0
    assert counts[INTERSECTIONS] >= 50_000
    assert hits.sum() == rays and hits @ np.arange(hits.size) == counts[INTERSECTIONS]
    # Nothing goes up through the surface that did not come down through it.
    assert hits[0] == 0 or angle > 85.0


def test_rays_do_not_depend_on_how_they_are_shared_out():
    fields = RoughSurface(SEA).make_height_fields()
    whole = count_leaks(SEED, 0, 40, fields, 1.34, 0.5)
    parts = [count_leaks(SEED, first, 20, fields, 1.34, 0.5) for first in (0, 20)]
    for i in range(2):
        np.testing.assert_array_equal(whole[i], parts[0][i] + parts[1][i])


# --- reciprocity ------------------------------------------------------------------------------


@njit
def _there_and_back(state, fields, room, side):
    """Return the way to a crossing, and the way from there back past where it came from."""
    surface = sample_realization(state, fields, room)
    dx, dy, dz = sample_unit_sphere(state)
    d = Vector(dx, dy, -side * abs(dz))
    place = Vector(0.0, 0.0, side * surface.max_height * (1.0 - 2.0 * rng.uniform(state)))
    if side * (place.z - compute_height_and_slope(surface.waves, 0.0, 0.0).height) <= 0.0:
        return 0.0, 0.0, 0.0
    s, slope, _ = find_first_intersection(surface, place, d, side)
    # A point in sight sees where it is seen from: nothing is met before that.
    t = find_first_intersection(surface, add_scaled(s, d, place), scale(-1.0, d), side).distance
    into = side * (d.z - slope.x * d.x - slope.y * d.y)
    return s, t, into


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_points_in_sight_see_where_they_are_seen_from(name, side):
    fields = RoughSurface(CASES[name][0]).make_height_fields()
    out = draw_samples(
        _there_and_back, sample_size(50_000), fields, allocate_realization(fields), side, width=3
    )
    s, t, into = out[out[:, 0] != 0.0].T
    assert s.size > 0.3 * len(out) and s.min() > 0.0
    assert into.max() < 0.0
    np.testing.assert_array_less(s * (1.0 - 1e-9), np.where(t == NO_HIT, math.inf, t))
    assert (t == NO_HIT).mean() > 0.1


# --- what is met ------------------------------------------------------------------------------


@njit
def _met(state, fields, room, mu):
    """Return height and slopes where a ray from above first meets a surface."""
    surface = sample_realization(state, fields, room)
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, -mu)
    s, slope, _ = find_first_intersection(surface, Vector(0.0, 0.0, surface.max_height), d, 1.0)
    return surface.max_height - s * mu, slope.x, slope.y


@njit
def _in_sight(state, fields, room, mu):
    """Return the height of the surface at the origin and the share of a beam that meets it there.

    The latter in units of the mean plane's share, 0 if it is in shadow.
    """
    surface = sample_realization(state, fields, room)
    height, slope = compute_height_and_slope(surface.waves, 0.0, 0.0)
    d = Vector(-math.sqrt(1.0 - mu * mu), 0.0, mu)
    facing = 1.0 - slope.x * d.x / mu
    if facing <= 0.0:
        return height, 0.0
    s = find_first_intersection(surface, Vector(0.0, 0.0, height), d, 1.0).distance
    return height, facing if s == NO_HIT else 0.0


def drawn(sampler, surface, mu, count, **of):
    fields = RoughSurface(surface).make_height_fields()
    return draw_samples(sampler, sample_size(count), fields, allocate_realization(fields), mu, **of)


@NEEDS_JIT
def test_rays_straight_down_meet_heights_and_slopes_as_they_are():
    # Many waves, so that slopes are normal too: σ√(⟨λ²⟩/2) each way.
    height, *slopes = drawn(_met, STEEP | {"waves": 400}, 1.0, 10_000, width=3).T
    p = {"height": compute_p_of_values(height, stats.norm.cdf)}
    for axis, slope in zip("xy", slopes, strict=True):
        p[axis] = compute_p_of_values(slope / math.sqrt(2.0), stats.norm.cdf)
    judge_p(p)


@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_facets_are_met_by_their_projected_area(name):
    # What is in sight takes up all of a beam; so means over rays from afar are means over points
    # of the surface that rays towards the source find in sight, by their projected area.
    surface, z = CASES[name][0], []

    def compare(sample, expected, *others):
        variance = sum(part.var() / part.size for part in (sample, *others))
        z.append((sample.mean() - expected) / math.sqrt(variance))

    for i, mu in enumerate((0.9, 0.6, 0.3, 0.1)):
        met = drawn(_met, surface, mu, 20_000, ray=2 * i, width=3)
        height, slope, across = met.T
        assert (1.0 + slope * math.sqrt(1.0 - mu * mu) / mu).min() > 0.0
        point, share = drawn(_in_sight, surface, mu, 20_000, ray=2 * i + 1, width=2).T
        compare(share, 1.0)
        compare(height, (share * point).mean(), share * point)
        compare(across, 0.0)
    judge_z(z, name, independent=4)
