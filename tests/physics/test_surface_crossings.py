"""Rays at rough surfaces: no missed intersections, reciprocity of visibility, hit statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_p_of_values, draw_samples, judge_p, judge_z
from chi2 import scale_sample_size as sample_size
from events import sample_unit_sphere
from numba import njit
from scipy import stats

from splits.kernels import rng
from splits.kernels.arithmetic import Vector, add_scaled, scale
from splits.kernels.interface import ComplexIndex, sample_interface
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    compute_height_tolerance,
    compute_normal_from_slope,
    find_first_intersection,
    nudge_off_surface,
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


# --- leaks --------------------------------------------------------------------------------------


@njit
def _trace_ray(state, fields, buffer, index, mu):
    """Return hits, points on the wrong side of the surface, and whether the search gave up.

    A ray from either side is reflected or refracted at the facets that it hits until it leaves.
    """
    surface = sample_realization(state, fields, buffer)
    above, below = ComplexIndex(1.0, 0.0), ComplexIndex(index, 0.0)
    side, leaks = 1.0 if rng.uniform(state) < 0.5 else -1.0, 0
    position = Vector(0.0, 0.0, side * surface.max_height)
    d = Vector(math.sqrt(1.0 - mu * mu), 0.0, -side * mu)
    for hits in range(50):
        hit = find_first_intersection(surface, position, d, side)
        if hit.distance == STEP_LIMIT_REACHED:
            return hits, leaks, 1
        length = hit.distance
        if hit.distance == NO_HIT:
            length = (surface.max_height - side * position.z) / max(side * d.z, 1e-300)
        # Three random points of the segment, and one where a last step that is too long would show.
        for i in range(4 if length > 0.0 else 0):
            s = length * (rng.uniform(state) if i else 1.0 - 1e-9)
            point = add_scaled(s, d, position)
            height = compute_height_and_slope(surface.waves, point.x, point.y).height
            if side * (point.z - height) < -4.0 * compute_height_tolerance(surface, point, s):
                leaks += 1
        if hit.distance == NO_HIT:
            return hits, leaks, 0
        position = add_scaled(hit.distance, d, position)
        upward = compute_normal_from_slope(hit.slope)
        near, far = (above, below) if side > 0.0 else (below, above)
        sample = sample_interface(d, scale(side, upward), near, far, rng.uniform(state))
        d = nudge_off_surface(
            sample.direction, scale(-side if sample.transmitted else side, upward)
        )
        side = -side if sample.transmitted else side
    return 50, leaks, 0


@NEEDS_JIT
@pytest.mark.parametrize("name", CASES)
def test_no_ray_misses_an_intersection(name):
    surface, index, angle, rays = CASES[name]
    fields = RoughSurface.from_input(surface).make_height_fields()
    mu = math.cos(math.radians(angle))
    buffer = allocate_realization(fields)
    hits, leaks, lost = draw_samples(_trace_ray, rays, fields, buffer, index, mu, width=3).T
    print(f"{name}: {hits.sum():.0f} crossings")
    assert leaks.sum() == lost.sum() == 0
    assert hits.sum() >= 20_000
    # Every ray hits the surface at least once, except near grazing incidence.
    assert hits.min() > 0 or angle > 85.0


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
