"""First crossings of rays and rough surfaces, against dense scans and where they are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, scale_sample_size, start_random_stream
from rough_surfaces import GAUSSIAN, SURFACES, draw_realization, sum_waves
from scipy import optimize

from splits.kernels.math.vectors import Vector
from splits.kernels.rough_surface import intersection as kernels
from splits.kernels.rough_surface.intersection import NO_HIT, STEP_LIMIT_REACHED
from splits.kernels.rough_surface.realization import (
    SurfaceSlope,
    allocate_realization,
    compute_height_and_slope,
    make_realization,
    sample_realization,
)
from splits.kernels.rough_surface.wave_sums import KX, KY, N_WAVE_LANES
from splits.media.rough_surface import RoughSurface


def find_first_crossing(surface, ray, side, farthest=math.inf):
    """Return the `Hit` of a ray (x, y, z, dx, dy, dz)."""
    ray = [float(x) for x in ray]
    return kernels.find_first_intersection(
        surface, Vector(*ray[:3]), Vector(*ray[3:]), side, farthest
    )


def compute_tolerance(surface, x, y, s):
    return kernels.compute_height_tolerance(surface, Vector(x, y, 0.0), s)


def compute_gaps(waves, ray, side, s):
    """Return heights above the surface (below it for side −1) along a ray."""
    x, y, z, dx, dy, dz = ray
    return side * (z + s * dz - sum_waves(waves, x + s * dx, y + s * dy))


def scan_first_crossing(waves, ray, side, length, points):
    """Return the first crossing found by probing, NaN without one."""
    s = np.linspace(0.0, length, points)
    below = np.flatnonzero(compute_gaps(waves, ray, side, s) < 0.0)
    if not below.size:
        return math.nan
    i = below[0]
    assert i > 0
    return optimize.brentq(
        lambda v: compute_gaps(waves, ray, side, np.array([v]))[0], s[i - 1], s[i], xtol=1e-14
    )


def draw_rays(generator, high, side, count):
    """Return rays from beyond the surface, in all directions towards it."""
    for _ in range(count):
        azimuth, climb = generator.uniform(0.0, 2.0 * np.pi), -generator.uniform(0.01, 1.0)
        flat = math.sqrt(1.0 - climb * climb)
        x, y = generator.uniform(-5.0, 5.0, 2)
        yield (
            x, y, 1.5 * side * high,
            flat * math.cos(azimuth), flat * math.sin(azimuth), side * climb,
        )  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("steepness", [0.1, 1.0, 5.0])
def test_crossings_of_one_wave(side, steepness):
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 3] = 0.7, 0.6, 0.8, 0.4
    waves[KX : KY + 1] *= steepness / (0.7 * 2.0 * np.pi)
    surface = make_realization(waves)
    high = surface.max_height
    assert high == 0.7
    for ray in draw_rays(np.random.default_rng(3), high, side, 40):
        s, slope, _ = find_first_crossing(surface, ray, side)
        expected = scan_first_crossing(waves, ray, side, 2.5 * high / abs(ray[5]), 20_001)
        assert s == pytest.approx(expected, rel=1e-9)
        at = ray[0] + s * ray[3], ray[1] + s * ray[4]
        assert slope == pytest.approx(compute_height_and_slope(waves, *at).slope)
        assert abs(compute_gaps(waves, ray, side, np.array([s]))[0]) <= compute_tolerance(
            surface, *at, s
        )


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_crossing_is_missed(name, side):
    generator = np.random.default_rng(4)
    grazed = 0
    for number in range(scale_sample_size(6_000) // 1000):
        surface = draw_realization(SURFACES[name], number)
        waves = surface.waves
        for ray in draw_rays(generator, surface.max_height, side, 10):
            s = find_first_crossing(surface, ray, side).distance
            assert s > 0.0
            probed = compute_gaps(waves, ray, side, np.linspace(0.0, s * (1.0 - 1e-9), 3001))
            allowed = compute_tolerance(surface, ray[0], ray[1], 2.0 * s)
            assert probed.min() >= -allowed
            gap = compute_gaps(waves, ray, side, np.array([s]))[0]
            assert abs(gap) <= allowed
            # Beyond the crossing the ray is on the other side, unless it only touched the surface.
            ahead = compute_gaps(waves, ray, side, s + 1e-6 * s * np.arange(1, 4))
            grazed += not (ahead < 0.0).any()
    assert grazed <= 1


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rays_that_stand_on_the_surface(side):
    surface = draw_realization(GAUSSIAN)
    waves, high = surface.waves, surface.max_height
    generator = np.random.default_rng(5)
    away = 0
    for ray in draw_rays(generator, high, side, 40):
        s, slope, _ = find_first_crossing(surface, ray, side)
        start = tuple(ray[i] + s * ray[i + 3] for i in range(3))
        n = side * np.array(kernels.compute_normal_from_slope(slope))
        assert n @ ray[3:] < 0.0
        for grazing in (0.0, 1e-15, 1e-12, 1e-6, 0.5):
            d = np.cross(n, generator.normal(size=3))
            d = kernels.nudge_off_surface(
                Vector(*(d / np.linalg.norm(d) + grazing * n)), Vector(*n)
            )
            assert np.dot(d, n) > 0.5 * kernels.MIN_COS_EXIT
            t = find_first_crossing(surface, (*start, *d), side).distance
            assert t == NO_HIT or t > 0.0
            away += t == NO_HIT
            length = t if t > 0.0 else (high - side * start[2]) / (side * d[2])
            probed = compute_gaps(
                waves, (*start, *d), side, length * np.linspace(0.0, 1.0 - 1e-9, 2001)
            )
            assert probed.min() >= -2.0 * compute_tolerance(surface, *start[:2], length)
    assert 20 < away < 180


def test_a_surface_without_height_is_a_plane():
    fields = RoughSurface(GAUSSIAN | {"rms_height_m": 0.0}).make_height_fields()
    surface = sample_realization(start_random_stream(), fields, allocate_realization(fields))
    assert surface.max_height == 0.0
    for dz in (-1.0, -0.3, -1e-3):
        flat = math.sqrt(1.0 - dz * dz)
        for side in (1.0, -1.0):
            s, slope, _ = find_first_crossing(
                surface, (1.0, 2.0, 3.0 * side, flat, 0.0, dz * side), side
            )
            assert s == pytest.approx(-3.0 / dz, rel=1e-14) and slope == (0.0, 0.0)
            away = find_first_crossing(surface, (1.0, 2.0, 0.0, flat, 0.0, -dz * side), side)
            assert away[:2] == (NO_HIT, (0.0, 0.0))
    assert kernels.compute_normal_from_slope(SurfaceSlope(0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_rays_that_meet_nothing():
    surface = draw_realization(GAUSSIAN)
    high = surface.max_height

    def met(*ray, side=1.0, farthest=math.inf):
        return find_first_crossing(surface, ray, side, farthest).distance

    assert met(0.0, 0.0, 2.0 * high, 0.6, 0.0, 0.8) == NO_HIT
    assert met(0.0, 0.0, 2.0 * high, 1.0, 0.0, 0.0) == NO_HIT
    assert met(0.0, 0.0, -2.0 * high, 0.6, 0.0, -0.8, side=-1.0) == NO_HIT
    down = 0.0, 0.0, 2.0 * high, 0.6, 0.0, -0.8
    s = met(*down)
    assert s > high / 0.8
    assert met(*down, farthest=1.001 * s) == s
    assert met(*down, farthest=0.999 * s) == NO_HIT
    # Straight down and up, the height itself.
    height = compute_height_and_slope(surface.waves, 3.0, 4.0).height
    assert met(3.0, 4.0, 5.0, 0.0, 0.0, -1.0) == pytest.approx(5.0 - height, rel=1e-12)
    below = met(3.0, 4.0, -5.0, 0.0, 0.0, 1.0, side=-1.0)
    assert below == pytest.approx(5.0 + height, rel=1e-12)


@NEEDS_JIT
def test_a_level_ray_that_never_meets_the_surface_is_lost():
    # cos t + cos(2t + π) is nowhere above 9/8; the bound on heights is 2.
    waves = np.zeros((4, N_WAVE_LANES))
    waves[:, 6] = 1.0, 0.1, 0.0, 0.0
    waves[:, 7] = 1.0, 0.2, 0.0, 0.5
    surface = make_realization(waves)
    assert surface.max_height == 2.0
    level = 0.0, 0.0, 1.5, 1.0, 0.0, 0.0
    assert find_first_crossing(surface, level, 1.0).distance == STEP_LIMIT_REACHED
    # Along its crests the same surface is level too.
    along = 0.0, 0.0, 1.5, 0.0, 1.0, 0.0
    assert find_first_crossing(surface, along, 1.0).distance == NO_HIT


@NEEDS_JIT
def test_plain_python_finds_the_same():
    for name in SURFACES:
        surface = draw_realization(SURFACES[name])
        for ray in draw_rays(np.random.default_rng(6), surface.max_height, 1.0, 3):
            begin = surface, Vector(*ray[:3]), Vector(*ray[3:]), 1.0
            fast = kernels.find_first_intersection(*begin)
            slow = kernels.find_first_intersection.py_func(*begin)
            assert fast.distance == pytest.approx(slow.distance, rel=1e-9, abs=1e-9)
            assert fast.slope == pytest.approx(slow.slope, rel=1e-9, abs=1e-9)
