"""Rays at rough surfaces: no missed intersections, reciprocity of visibility, hit statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, SEED, compute_p_of_values, draw_samples, judge_p, judge_z
from chi2 import scale_sample_size as sample_size
from events import sample_unit_sphere
from numba import njit
from scipy import stats

from splits.kernels import rng
from splits.kernels.arithmetic import Vector, add_scaled, scale
from splits.kernels.rough_surface.intersection import NO_HIT, find_first_intersection
from splits.kernels.rough_surface.missed_intersections import (
    INTERSECTIONS,
    LEAKS,
    LOST_RAYS,
    SEGMENTS,
    count_leaks,
)
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
    "glass, unbounded slopes": (FINE | {"band_limit_per_m": math.inf}, 1.52, 20.0, 12_000),
    "water, two scales": (PAIR, 1.34, 70.0, 20_000),
    "no contrast": (STEEP, 1.0, 60.0, 40_000),
}


@NEEDS_JIT
@pytest.mark.parametrize("name", CASES)
def test_no_ray_misses_an_intersection(name):
    surface, index, angle, rays = CASES[name]
    fields = RoughSurface.from_input(surface).make_height_fields()
    mu = math.cos(math.radians(angle))
    counts, hits = count_leaks(SEED, 0, rays, fields, index, mu)
    print(f"{name}: {counts[INTERSECTIONS]} crossings, {counts[SEGMENTS]} segments")
    assert counts[LEAKS] == counts[LOST_RAYS] == 0
    assert counts[INTERSECTIONS] >= 50_000
    assert hits.sum() == rays and hits @ np.arange(hits.size) == counts[INTERSECTIONS]
    # Every ray hits the surface at least once, except near grazing incidence.
    assert hits[0] == 0 or angle > 85.0


def test_counts_are_additive_over_chunks_of_rays():
    fields = RoughSurface(SEA).make_height_fields()
    total = count_leaks(SEED, 0, 40, fields, 1.34, 0.5)
    parts = [count_leaks(SEED, first, 20, fields, 1.34, 0.5) for first in (0, 20)]
    for i in range(2):
        np.testing.assert_array_equal(total[i], parts[0][i] + parts[1][i])


# --- reciprocity ------------------------------------------------------------------------------


@njit
def _trace_reverse_ray(state, fields, buffer, side):
    """Return distances to an intersection and along the reverse ray, and the normal component."""
    surface = sample_realization(state, fields, buffer)
    dx, dy, dz = sample_unit_sphere(state)
    d = Vector(dx, dy, -side * abs(dz))
    position = Vector(0.0, 0.0, side * surface.max_height * (1.0 - 2.0 * rng.uniform(state)))
    if side * (position.z - compute_height_and_slope(surface.waves, 0.0, 0.0).height) <= 0.0:
        return 0.0, 0.0, 0.0
    s, slope, _ = find_first_intersection(surface, position, d, side)
    # Visibility is mutual: the reverse ray hits nothing before the starting point.
    t = find_first_intersection(surface, add_scaled(s, d, position), scale(-1.0, d), side).distance
    normal_component = side * (d.z - slope.x * d.x - slope.y * d.y)
    return s, t, normal_component


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_visibility_is_mutual(name, side):
    fields = RoughSurface(CASES[name][0]).make_height_fields()
    out = draw_samples(
        _trace_reverse_ray, sample_size(50_000), fields, allocate_realization(fields), side, width=3
    )
    s, t, normal_component = out[out[:, 0] != 0.0].T
    assert s.size > 0.3 * len(out) and s.min() > 0.0
    assert normal_component.max() < 0.0
    np.testing.assert_array_less(s * (1.0 - 1e-9), np.where(t == NO_HIT, math.inf, t))
    assert (t == NO_HIT).mean() > 0.1


# --- hit statistics ---------------------------------------------------------------------------


@njit
def _sample_hit(state, fields, buffer, mu):
    """Return height and slopes where a ray from above first hits a surface."""
    surface = sample_realization(state, fields, buffer)
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, -mu)
    s, slope, _ = find_first_intersection(surface, Vector(0.0, 0.0, surface.max_height), d, 1.0)
    return surface.max_height - s * mu, slope.x, slope.y


@njit
def _sample_visibility(state, fields, buffer, mu):
    """Return the height of the surface at the origin and the part of a beam that hits it there.

    The latter is in units of the part that hits the mean plane, and 0 in shadow.
    """
    surface = sample_realization(state, fields, buffer)
    height, slope = compute_height_and_slope(surface.waves, 0.0, 0.0)
    d = Vector(-math.sqrt(1.0 - mu * mu), 0.0, mu)
    facing = 1.0 - slope.x * d.x / mu
    if facing <= 0.0:
        return height, 0.0
    s = find_first_intersection(surface, Vector(0.0, 0.0, height), d, 1.0).distance
    return height, facing if s == NO_HIT else 0.0


def sample_surface(sampler, surface, mu, count, **options):
    fields = RoughSurface(surface).make_height_fields()
    return draw_samples(
        sampler, sample_size(count), fields, allocate_realization(fields), mu, **options
    )


@NEEDS_JIT
def test_vertical_rays_sample_the_height_and_slope_distributions():
    # With many waves the slopes are normal too, with σ√(⟨λ²⟩/2) along each axis.
    height, *slopes = sample_surface(_sample_hit, STEEP | {"waves": 400}, 1.0, 10_000, width=3).T
    p = {"height": compute_p_of_values(height, stats.norm.cdf)}
    for axis, slope in zip("xy", slopes, strict=True):
        p[axis] = compute_p_of_values(slope / math.sqrt(2.0), stats.norm.cdf)
    judge_p(p)


@pytest.mark.parametrize("name", ["water", "glass, steep", "glass, exponential"])
def test_hits_are_weighted_by_projected_area(name):
    # Visible points intercept the whole beam.  Means over rays therefore equal means over surface
    # points with a free line of sight to the source, weighted by projected area.
    surface, z = CASES[name][0], []

    def compare(sample, expected, *others):
        variance = sum(part.var() / part.size for part in (sample, *others))
        z.append((sample.mean() - expected) / math.sqrt(variance))

    for i, mu in enumerate((0.9, 0.6, 0.3, 0.1)):
        hits = sample_surface(_sample_hit, surface, mu, 20_000, ray=2 * i, width=3)
        height, slope, across = hits.T
        assert (1.0 + slope * math.sqrt(1.0 - mu * mu) / mu).min() > 0.0
        point, weight = sample_surface(
            _sample_visibility, surface, mu, 20_000, ray=2 * i + 1, width=2
        ).T
        compare(weight, 1.0)
        compare(height, (weight * point).mean(), weight * point)
        compare(across, 0.0)
    judge_z(z, name, independent=4)
