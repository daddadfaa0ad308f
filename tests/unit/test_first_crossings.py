"""First crossings of rays and rough surfaces, against dense scans and where they are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, scaled, stream
from rough_surfaces import GAUSSIAN, SURFACES, realised, summed
from scipy import optimize

from splits.media.rough_surface import RoughSurface
from splits.transport.numerics.vectors import Vector
from splits.transport.rough import march as kernels
from splits.transport.rough.march import GONE, LOST
from splits.transport.rough.wave_sums import KX, KY, LANES
from splits.transport.rough.waves import Slope, draw_waves, relief_at, room_for, surface_of


def crossing(surface, ray, side, farthest=math.inf):
    """Return the `Hit` of a ray (x, y, z, dx, dy, dz)."""
    ray = [float(x) for x in ray]
    return kernels.first_crossing(surface, Vector(*ray[:3]), Vector(*ray[3:]), side, farthest)


def tolerance(surface, x, y, s):
    return kernels.tolerance(surface, Vector(x, y, 0.0), s)


def gaps(waves, ray, side, s):
    """Return heights above the surface (below it for side −1) along a ray."""
    x, y, z, dx, dy, dz = ray
    return side * (z + s * dz - summed(waves, x + s * dx, y + s * dy))


def scanned(waves, ray, side, length, points):
    """Return the first crossing found by probing, NaN without one."""
    s = np.linspace(0.0, length, points)
    below = np.flatnonzero(gaps(waves, ray, side, s) < 0.0)
    if not below.size:
        return math.nan
    i = below[0]
    assert i > 0
    return optimize.brentq(
        lambda v: gaps(waves, ray, side, np.array([v]))[0], s[i - 1], s[i], xtol=1e-14
    )


def rays_from(generator, high, side, count):
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
    waves = np.zeros((4, LANES))
    waves[:, 3] = 0.7, 0.6, 0.8, 0.4
    waves[KX : KY + 1] *= steepness / (0.7 * 2.0 * np.pi)
    surface = surface_of(waves)
    high = surface.max_height
    assert high == 0.7
    for ray in rays_from(np.random.default_rng(3), high, side, 40):
        s, slope, _ = crossing(surface, ray, side)
        expected = scanned(waves, ray, side, 2.5 * high / abs(ray[5]), 20_001)
        assert s == pytest.approx(expected, rel=1e-9)
        at = ray[0] + s * ray[3], ray[1] + s * ray[4]
        assert slope == pytest.approx(relief_at(waves, *at).slope)
        assert abs(gaps(waves, ray, side, np.array([s]))[0]) <= tolerance(surface, *at, s)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_crossing_is_missed(name, side):
    generator = np.random.default_rng(4)
    grazed = 0
    for number in range(scaled(6_000) // 1000):
        surface = realised(SURFACES[name], number)
        waves = surface.waves
        for ray in rays_from(generator, surface.max_height, side, 10):
            s = crossing(surface, ray, side).distance
            assert s > 0.0
            probed = gaps(waves, ray, side, np.linspace(0.0, s * (1.0 - 1e-9), 3001))
            allowed = tolerance(surface, ray[0], ray[1], 2.0 * s)
            assert probed.min() >= -allowed
            gap = gaps(waves, ray, side, np.array([s]))[0]
            assert abs(gap) <= allowed
            # Beyond the crossing the ray is on the other side, unless it only touched the surface.
            ahead = gaps(waves, ray, side, s + 1e-6 * s * np.arange(1, 4))
            grazed += not (ahead < 0.0).any()
    assert grazed <= 1


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rays_that_stand_on_the_surface(side):
    surface = realised(GAUSSIAN)
    waves, high = surface.waves, surface.max_height
    generator = np.random.default_rng(5)
    away = 0
    for ray in rays_from(generator, high, side, 40):
        s, slope, _ = crossing(surface, ray, side)
        start = tuple(ray[i] + s * ray[i + 3] for i in range(3))
        n = side * np.array(kernels.normal_of(slope))
        assert n @ ray[3:] < 0.0
        for grazing in (0.0, 1e-15, 1e-12, 1e-6, 0.5):
            d = np.cross(n, generator.normal(size=3))
            d = kernels.cleared(Vector(*(d / np.linalg.norm(d) + grazing * n)), Vector(*n))
            assert np.dot(d, n) > 0.5 * kernels.GRAZING
            t = crossing(surface, (*start, *d), side).distance
            assert t == GONE or t > 0.0
            away += t == GONE
            length = t if t > 0.0 else (high - side * start[2]) / (side * d[2])
            probed = gaps(waves, (*start, *d), side, length * np.linspace(0.0, 1.0 - 1e-9, 2001))
            assert probed.min() >= -2.0 * tolerance(surface, *start[:2], length)
    assert 20 < away < 180


def test_a_surface_without_height_is_a_plane():
    fields = RoughSurface(GAUSSIAN | {"rms_height_m": 0.0}).make_height_fields()
    surface = draw_waves(stream(), fields, room_for(fields))
    assert surface.max_height == 0.0
    for dz in (-1.0, -0.3, -1e-3):
        flat = math.sqrt(1.0 - dz * dz)
        for side in (1.0, -1.0):
            s, slope, _ = crossing(surface, (1.0, 2.0, 3.0 * side, flat, 0.0, dz * side), side)
            assert s == pytest.approx(-3.0 / dz, rel=1e-14) and slope == (0.0, 0.0)
            away = crossing(surface, (1.0, 2.0, 0.0, flat, 0.0, -dz * side), side)
            assert away[:2] == (GONE, (0.0, 0.0))
    assert kernels.normal_of(Slope(0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_rays_that_meet_nothing():
    surface = realised(GAUSSIAN)
    high = surface.max_height

    def met(*ray, side=1.0, farthest=math.inf):
        return crossing(surface, ray, side, farthest).distance

    assert met(0.0, 0.0, 2.0 * high, 0.6, 0.0, 0.8) == GONE
    assert met(0.0, 0.0, 2.0 * high, 1.0, 0.0, 0.0) == GONE
    assert met(0.0, 0.0, -2.0 * high, 0.6, 0.0, -0.8, side=-1.0) == GONE
    down = 0.0, 0.0, 2.0 * high, 0.6, 0.0, -0.8
    s = met(*down)
    assert s > high / 0.8
    assert met(*down, farthest=1.001 * s) == s
    assert met(*down, farthest=0.999 * s) == GONE
    # Straight down and up, the height itself.
    height = relief_at(surface.waves, 3.0, 4.0).height
    assert met(3.0, 4.0, 5.0, 0.0, 0.0, -1.0) == pytest.approx(5.0 - height, rel=1e-12)
    below = met(3.0, 4.0, -5.0, 0.0, 0.0, 1.0, side=-1.0)
    assert below == pytest.approx(5.0 + height, rel=1e-12)


@NEEDS_JIT
def test_a_level_ray_that_never_meets_the_surface_is_lost():
    # cos t + cos(2t + π) is nowhere above 9/8; the bound on heights is 2.
    waves = np.zeros((4, LANES))
    waves[:, 6] = 1.0, 0.1, 0.0, 0.0
    waves[:, 7] = 1.0, 0.2, 0.0, 0.5
    surface = surface_of(waves)
    assert surface.max_height == 2.0
    level = 0.0, 0.0, 1.5, 1.0, 0.0, 0.0
    assert crossing(surface, level, 1.0).distance == LOST
    # Along its crests the same surface is level too.
    along = 0.0, 0.0, 1.5, 0.0, 1.0, 0.0
    assert crossing(surface, along, 1.0).distance == GONE


@NEEDS_JIT
def test_plain_python_finds_the_same():
    for name in SURFACES:
        surface = realised(SURFACES[name])
        for ray in rays_from(np.random.default_rng(6), surface.max_height, 1.0, 3):
            begin = surface, Vector(*ray[:3]), Vector(*ray[3:]), 1.0
            fast = kernels.first_crossing(*begin)
            slow = kernels.first_crossing.py_func(*begin)
            assert fast.distance == pytest.approx(slow.distance, rel=1e-9, abs=1e-9)
            assert fast.slope == pytest.approx(slow.slope, rel=1e-9, abs=1e-9)
