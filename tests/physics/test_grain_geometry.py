"""Chords and overlaps of spheroids against brute force; Cauchy's mean chord."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z
from events import sample_entry
from numba import njit
from spheroids import normalize, to_real_space, to_unit_sphere

import splits
from splits.kernels.grains import spheroid
from splits.kernels.grains.spheroid import EntryPoint, GrainSize, Segment, Spheroid
from splits.kernels.math import rng
from splits.kernels.math.vectors import Vector

B = 1.7
SPHERICITIES = (0.35, 0.7, 0.9, 1.0)
NO_LEG = -1.0


@pytest.fixture
def random():
    return np.random.default_rng(11)


def shape(psi):
    """Return semi-minor axis and flattening as kernels want them."""
    return B * psi * psi, 1.0 - psi * psi


def grain_at(q, axis, psi):
    """Return a grain with the ray at a point of its unit sphere."""
    c, flattening = shape(psi)
    return Spheroid(Vector(*q), Vector(*axis), flattening, c)


def form(psi, axis):
    """Return the matrix M of the spheroid xᵀ M x = 1 from a rotation into its own axes."""
    c = B * psi * psi
    turn = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, np.argsort(np.abs(axis))[:2]]]))[0]
    return turn @ np.diag([1 / B**2, 1 / c**2, 1 / c**2]) @ turn.T


def surface_point(random, psi, axis):
    """Return a random point on the surface, by scaling a random direction."""
    direction = normalize(random.normal(size=3))
    return direction / np.sqrt(direction @ form(psi, axis) @ direction)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_points_on_the_unit_sphere_are_points_of_the_surface(random, psi):
    c, flattening = shape(psi)
    for _ in range(100):
        axis = normalize(random.normal(size=3))
        m = form(psi, axis)
        p = surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        assert q @ q == pytest.approx(1.0, abs=1e-13)
        assert to_real_space(q, axis, c, flattening) == pytest.approx(p, abs=1e-13)
        n = np.array(spheroid.compute_outward_normal(grain_at(q, axis, psi)))
        assert n == pytest.approx(normalize(m @ p), abs=1e-12)
        z = q @ axis
        # The normal before it is scaled to 1, in units of q.
        assert spheroid.normal_length_squared(z, flattening) == pytest.approx(
            np.square(spheroid.scale_along_axis(Vector(*q), Vector(*axis), flattening)).sum(),
            abs=1e-13,
        )
        assert z == pytest.approx(p @ axis / B, abs=1e-13)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_against_roots_of_the_quadratic(random, psi):
    c, flattening = shape(psi)
    for _ in range(300):
        axis = normalize(random.normal(size=3))
        m = form(psi, axis)
        p = surface_point(random, psi, axis)
        d = normalize(random.normal(size=3))
        d = -d if d @ m @ p > 0.0 else d
        roots = np.roots([d @ m @ d, 2.0 * d @ m @ p, p @ m @ p - 1.0])
        q = to_unit_sphere(p, axis, c, flattening)
        length, there = spheroid.compute_chord(grain_at(q, axis, psi), Vector(*d))
        other = np.array(there.q)
        assert there[1:] == grain_at(q, axis, psi)[1:]
        assert length > 0.0
        assert length == pytest.approx(roots.real.max(), rel=1e-7, abs=1e-7)
        end = p + length * d
        assert end @ m @ end == pytest.approx(1.0, abs=1e-12)
        assert np.dot(other, other) == pytest.approx(1.0, abs=1e-15)
        assert to_real_space(other, axis, c, flattening) == pytest.approx(end, abs=1e-12)
        n = np.array(spheroid.compute_outward_normal(there))
        assert n == pytest.approx(normalize(m @ end), abs=1e-12)
        assert n @ d > 0.0


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_a_ray_that_points_away_has_no_chord(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        grain = grain_at(q, axis, psi)
        n = spheroid.compute_outward_normal(grain)
        d = d if d @ n > 0.0 else -d
        length, there = spheroid.compute_chord(grain, Vector(*d))
        assert (length, *there.q) == pytest.approx((0.0, *q), abs=1e-15)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_a_point_off_the_unit_sphere_is_brought_back(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        for off in (-1e-6, 1e-6):
            there = spheroid.compute_chord(grain_at((1.0 + off) * q, axis, psi), Vector(*d)).grain
            # Newton's method squares the error: 3/8 (2e-6)².
            assert np.linalg.norm(there.q) == pytest.approx(1.0, abs=2e-12)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_crosses_against_the_highest_and_lowest_point(random, psi):
    c, flattening = shape(psi)
    major, depth = c / (1.0 - flattening), 12.0
    for _ in range(50):
        axis = normalize(random.normal(size=3))
        m = form(psi, axis)
        p = surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        normal = Vector(*normalize(m @ p))
        entry = EntryPoint(grain_at(q, axis, psi), normal, float(q @ axis), major)
        # The topmost point has its gradient along z.
        top = np.linalg.solve(m, [0.0, 0.0, 1.0])
        top = (top / np.sqrt(top @ m @ top))[2]
        for hair in (-1e-12, 1e-12):
            for height in (p[2] - top + hair, p[2] + top - depth - hair):
                crosses = spheroid.overlaps_boundary(entry, height, -depth, 0.0)
                assert crosses == (hair > 0.0)
        # Somewhere at random, and between boundaries that are nearer than the grain is high.
        height = random.uniform(-depth, 0.0)
        outside = height - p[2] + top > 0.0 or height - p[2] - top < -depth
        assert spheroid.overlaps_boundary(entry, height, -depth, 0.0) == outside
        assert spheroid.overlaps_boundary(entry, -0.5 * top + p[2], -1.9 * top, 0.0)


def cuts(start, d, length, p, axis, psi):
    """Return whether a segment, from the grain's centre, cuts a grain known by a point p of it."""
    grain = grain_at(to_unit_sphere(p, axis, *shape(psi)), axis, psi)
    end = start + length * d - p
    return spheroid.overlaps_segment(grain, Segment(Vector(*end), Vector(*d), length))


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_cuts_against_points_along_the_segment(random, psi):
    c, flattening = shape(psi)
    steps = 2000
    cut = missed = 0
    for _ in range(400):
        axis = normalize(random.normal(size=3))
        m = form(psi, axis)
        # Through a point inside or near the grain, from a start and to an end on either side.
        d = normalize(random.normal(size=3))
        near = surface_point(random, psi, axis) * random.uniform(0.0, 2.0)
        start = near - d * random.normal() * B
        length = random.exponential(2.0 * B)
        points = start + np.linspace(0.0, length, steps)[:, None] * d
        nearest = np.einsum("ij,jk,ik->i", points, m, points).min()
        # Between two points the form falls at most (half a step)² / c² below the lower one.
        slack = (0.5 * length / (steps - 1) / c) ** 2
        # Whichever point of its surface a grain is known by.
        result = [
            cuts(start, d, length, surface_point(random, psi, axis), axis, psi) for _ in range(3)
        ]
        if nearest < 1.0:
            assert all(result)
            cut += 1
        elif nearest > 1.0 + slack:
            assert not any(result)
            missed += 1
        p = surface_point(random, psi, axis)
        # A leg that is not there cuts nothing.
        grain = grain_at(to_unit_sphere(p, axis, c, flattening), axis, psi)
        assert not spheroid.overlaps_segment(grain, Segment(Vector(*-p), Vector(*d), NO_LEG))
    assert cut > 50 and missed > 50


@njit
def _struck_chord(state, types, entry):
    """Return the straight chord through a struck grain that does not bend the ray."""
    b = 1.0 / rng.interpolate_quantile(types.curvature, 0, rng.uniform(state))
    psi = rng.interpolate_quantile(types.sphericity, 0, rng.uniform(state))
    d = Vector(0.48, -0.64, 0.6)
    return spheroid.compute_chord(
        sample_entry(state, d, GrainSize(b, 1.0 - psi * psi), entry).grain, d
    ).length


MEDIA = {
    "Table 1": {},
    "fine needles": {"grain_size_um": (50.0, 80.0), "sphericity": (0.3, 0.6, 0.4, 0.1)},
    "one sphere": {"grain_size_um": (500.0, 500.0), "sphericity": (1.0, 1.0, 1.0, 0.0)},
}


@NEEDS_JIT
def test_mean_chord_is_the_inverse_attenuation():
    # Cauchy: volume over mean outline, averaged over the grains struck, is 1/K of the ice.
    z = []
    for settings in MEDIA.values():
        snow = splits.Snow(**settings)
        chords = draw_samples(
            _struck_chord, 400_000, snow.make_grain_population().types, spheroid.PROJECTED_ENTRY
        )
        error = chords.std() / np.sqrt(chords.size)
        z.append((chords.mean() - 1.0 / snow.attenuation_per_m) / error)
    judge_z(z, "mean chord")
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_uniform_entry_shortens_the_chord_of_a_sphere():
    # Entry even over the facing half: cos even, chord s cos, so s/2 instead of 2s/3.
    snow = splits.Snow(**MEDIA["one sphere"])
    chords = draw_samples(
        _struck_chord, 400_000, snow.make_grain_population().types, spheroid.UNIFORM_ENTRY
    )
    error = chords.std() / np.sqrt(chords.size)
    judge_z([(chords.mean() - 250e-6) / error], "uniform entry")
