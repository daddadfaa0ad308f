"""First intersections of rays with rough surfaces, against dense scans and exact cases."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, scale_sample_size, start_random_stream
from rough_surfaces import GAUSSIAN, SURFACES, draw_realization, sum_waves
from scipy import optimize

from splits.kernels.arithmetic import Vector
from splits.kernels.rough_surface import intersection
from splits.kernels.rough_surface.intersection import NO_HIT, STEP_LIMIT_REACHED
from splits.kernels.rough_surface.realization import (
    KX,
    KY,
    N_WAVE_LANES,
    SurfaceSlope,
    allocate_realization,
    compute_height_and_slope,
    make_realization,
    sample_realization,
)
from splits.media.rough_surface import RoughSurface


def find_intersection(surface, ray, side, max_distance=math.inf):
    """Return the `Hit` of a ray (x, y, z, dx, dy, dz)."""
    ray = [float(x) for x in ray]
    return intersection.find_first_intersection(
        surface, Vector(*ray[:3]), Vector(*ray[3:]), side, max_distance
    )


def compute_tolerance(surface, x, y, s):
    return intersection.compute_height_tolerance(surface, Vector(x, y, 0.0), s)


def compute_gaps(waves, ray, side, s):
    """Return heights above the surface (below it for side −1) along a ray."""
    x, y, z, dx, dy, dz = ray
    return side * (z + s * dz - sum_waves(waves, x + s * dx, y + s * dy))


def scan_for_intersection(waves, ray, side, length, points):
    """Return the distance of the first intersection on a dense grid, NaN without one."""
    s = np.linspace(0.0, length, points)
    below = np.flatnonzero(compute_gaps(waves, ray, side, s) < 0.0)
    if not below.size:
        return math.nan
    i = below[0]
    assert i > 0
    return optimize.brentq(
        lambda v: compute_gaps(waves, ray, side, np.array([v]))[0], s[i - 1], s[i], xtol=1e-14
    )


def draw_rays(generator, max_height, side, n_rays):
    """Return rays that start outside the surface and travel towards it."""
    for _ in range(n_rays):
        azimuth, dz = generator.uniform(0.0, 2.0 * np.pi), -generator.uniform(0.01, 1.0)
        horizontal = math.sqrt(1.0 - dz * dz)
        x, y = generator.uniform(-5.0, 5.0, 2)
        yield (
            x, y, 1.5 * side * max_height,
            horizontal * math.cos(azimuth), horizontal * math.sin(azimuth), side * dz,
        )  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("steepness", [0.1, 1.0, 5.0])
def test_intersections_with_one_wave_match_a_scan(side, steepness):
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 3] = 0.7, 0.6, 0.8, 0.4
    waves[KX : KY + 1] *= steepness / (0.7 * 2.0 * np.pi)
    surface = make_realization(waves)
    max_height = surface.max_height
    assert max_height == 0.7
    for ray in draw_rays(np.random.default_rng(3), max_height, side, 40):
        s, slope, _ = find_intersection(surface, ray, side)
        expected = scan_for_intersection(waves, ray, side, 2.5 * max_height / abs(ray[5]), 20_001)
        assert s == pytest.approx(expected, rel=1e-9)
        position = ray[0] + s * ray[3], ray[1] + s * ray[4]
        assert slope == pytest.approx(compute_height_and_slope(waves, *position).slope)
        assert abs(compute_gaps(waves, ray, side, np.array([s]))[0]) <= compute_tolerance(
            surface, *position, s
        )


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_intersection_is_missed(name, side):
    generator = np.random.default_rng(4)
    n_grazing = 0
    for realization in range(scale_sample_size(6_000) // 1000):
        surface = draw_realization(SURFACES[name], realization)
        waves = surface.waves
        for ray in draw_rays(generator, surface.max_height, side, 10):
            s = find_intersection(surface, ray, side).distance
            assert s > 0.0
            gaps = compute_gaps(waves, ray, side, np.linspace(0.0, s * (1.0 - 1e-9), 3001))
            allowed = compute_tolerance(surface, ray[0], ray[1], 2.0 * s)
            assert gaps.min() >= -allowed
            gap = compute_gaps(waves, ray, side, np.array([s]))[0]
            assert abs(gap) <= allowed
            # After the intersection the ray is on the other side, except for grazing rays.
            gaps_after = compute_gaps(waves, ray, side, s + 1e-6 * s * np.arange(1, 4))
            n_grazing += not (gaps_after < 0.0).any()
    assert n_grazing <= 1


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rays_that_start_on_the_surface(side):
    surface = draw_realization(GAUSSIAN)
    waves, max_height = surface.waves, surface.max_height
    generator = np.random.default_rng(5)
    n_escaped = 0
    for ray in draw_rays(generator, max_height, side, 40):
        s, slope, _ = find_intersection(surface, ray, side)
        start = tuple(ray[i] + s * ray[i + 3] for i in range(3))
        n = side * np.array(intersection.compute_normal_from_slope(slope))
        assert n @ ray[3:] < 0.0
        for grazing in (0.0, 1e-15, 1e-12, 1e-6, 0.5):
            d = np.cross(n, generator.normal(size=3))
            d = intersection.nudge_off_surface(
                Vector(*(d / np.linalg.norm(d) + grazing * n)), Vector(*n)
            )
            assert np.dot(d, n) > 0.5 * intersection.MIN_COS_EXIT
            t = find_intersection(surface, (*start, *d), side).distance
            assert t == NO_HIT or t > 0.0
            n_escaped += t == NO_HIT
            length = t if t > 0.0 else (max_height - side * start[2]) / (side * d[2])
            gaps = compute_gaps(
                waves, (*start, *d), side, length * np.linspace(0.0, 1.0 - 1e-9, 2001)
            )
            assert gaps.min() >= -2.0 * compute_tolerance(surface, *start[:2], length)
    assert 20 < n_escaped < 180


def test_zero_height_gives_a_plane():
    fields = RoughSurface(GAUSSIAN | {"rms_height_m": 0.0}).make_height_fields()
    surface = sample_realization(start_random_stream(), fields, allocate_realization(fields))
    assert surface.max_height == 0.0
    for dz in (-1.0, -0.3, -1e-3):
        dx = math.sqrt(1.0 - dz * dz)
        for side in (1.0, -1.0):
            s, slope, _ = find_intersection(
                surface, (1.0, 2.0, 3.0 * side, dx, 0.0, dz * side), side
            )
            assert s == pytest.approx(-3.0 / dz, rel=1e-14) and slope == (0.0, 0.0)
            upward = find_intersection(surface, (1.0, 2.0, 0.0, dx, 0.0, -dz * side), side)
            assert upward[:2] == (NO_HIT, (0.0, 0.0))
    assert intersection.compute_normal_from_slope(SurfaceSlope(0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_rays_without_intersection():
    surface = draw_realization(GAUSSIAN)
    max_height = surface.max_height

    def find_distance(*ray, side=1.0, max_distance=math.inf):
        return find_intersection(surface, ray, side, max_distance).distance

    assert find_distance(0.0, 0.0, 2.0 * max_height, 0.6, 0.0, 0.8) == NO_HIT
    assert find_distance(0.0, 0.0, 2.0 * max_height, 1.0, 0.0, 0.0) == NO_HIT
    assert find_distance(0.0, 0.0, -2.0 * max_height, 0.6, 0.0, -0.8, side=-1.0) == NO_HIT
    downward = 0.0, 0.0, 2.0 * max_height, 0.6, 0.0, -0.8
    s = find_distance(*downward)
    assert s > max_height / 0.8
    assert find_distance(*downward, max_distance=1.001 * s) == s
    assert find_distance(*downward, max_distance=0.999 * s) == NO_HIT
    # Vertical rays hit the surface at its height.
    height = compute_height_and_slope(surface.waves, 3.0, 4.0).height
    assert find_distance(3.0, 4.0, 5.0, 0.0, 0.0, -1.0) == pytest.approx(5.0 - height, rel=1e-12)
    from_below = find_distance(3.0, 4.0, -5.0, 0.0, 0.0, 1.0, side=-1.0)
    assert from_below == pytest.approx(5.0 + height, rel=1e-12)


@pytest.mark.long
@NEEDS_JIT
def test_horizontal_ray_without_intersection_is_lost():
    # cos t + cos(2t + π) is nowhere above 9/8; the bound on heights is 2.
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 6] = 1.0, 0.1, 0.0, 0.0
    waves[:, 7] = 1.0, 0.2, 0.0, 0.5
    surface = make_realization(waves)
    assert surface.max_height == 2.0
    horizontal = 0.0, 0.0, 1.5, 1.0, 0.0, 0.0
    assert find_intersection(surface, horizontal, 1.0).distance == STEP_LIMIT_REACHED
    # Along its crests the same surface is horizontal too.
    along_crests = 0.0, 0.0, 1.5, 0.0, 1.0, 0.0
    assert find_intersection(surface, along_crests, 1.0).distance == NO_HIT


@NEEDS_JIT
def test_compiled_and_interpreted_intersections_agree():
    for name in SURFACES:
        surface = draw_realization(SURFACES[name])
        for ray in draw_rays(np.random.default_rng(6), surface.max_height, 1.0, 3):
            arguments = surface, Vector(*ray[:3]), Vector(*ray[3:]), 1.0
            compiled = intersection.find_first_intersection(*arguments)
            interpreted = intersection.find_first_intersection.py_func(*arguments)
            assert compiled.distance == pytest.approx(interpreted.distance, rel=1e-9, abs=1e-9)
            assert compiled.slope == pytest.approx(interpreted.slope, rel=1e-9, abs=1e-9)
