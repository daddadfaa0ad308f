"""Chords and overlaps of spheroids against direct evaluation; Cauchy's mean chord."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z
from events import sample_entry
from numba import njit
from spheroids import normalize, to_real_space, to_unit_sphere

import splits
from splits.kernels import rng
from splits.kernels.arithmetic import Vector
from splits.kernels.grains import spheroid
from splits.kernels.grains.spheroid import EntryPoint, GrainSize, Spheroid
from splits.kernels.scene import PROJECTED_ENTRY, UNIFORM_ENTRY, Segment

B = 1.7
SPHERICITIES = (0.35, 0.7, 0.9, 1.0)
NO_SEGMENT_LENGTH = -1.0


@pytest.fixture
def random():
    return np.random.default_rng(11)


def compute_shape(psi):
    """Return semi-minor axis and flattening, the parameters of the kernels."""
    return B * psi * psi, 1.0 - psi * psi


def make_grain(q, axis, psi):
    """Return a grain with the ray at a point of its unit sphere."""
    c, flattening = compute_shape(psi)
    return Spheroid(Vector(*q), Vector(*axis), flattening, c)


def make_quadratic_form(psi, axis):
    """Return the matrix M of the spheroid xᵀ M x = 1 by a rotation from its principal axes."""
    c = B * psi * psi
    rotation = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, np.argsort(np.abs(axis))[:2]]]))[0]
    return rotation @ np.diag([1 / B**2, 1 / c**2, 1 / c**2]) @ rotation.T


def sample_surface_point(random, psi, axis):
    """Return a random point on the surface, by scaling a random direction."""
    direction = normalize(random.normal(size=3))
    return direction / np.sqrt(direction @ make_quadratic_form(psi, axis) @ direction)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_unit_sphere_points_map_to_the_surface(random, psi):
    c, flattening = compute_shape(psi)
    for _ in range(100):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        assert q @ q == pytest.approx(1.0, abs=1e-13)
        assert to_real_space(q, axis, c, flattening) == pytest.approx(p, abs=1e-13)
        n = np.array(spheroid.compute_outward_normal(make_grain(q, axis, psi)))
        assert n == pytest.approx(normalize(m @ p), abs=1e-12)
        z = q @ axis
        # The squared length of the normal before normalization, in units of q.
        assert spheroid.normal_length_squared(z, flattening) == pytest.approx(
            np.square(spheroid.scale_along_axis(Vector(*q), Vector(*axis), flattening)).sum(),
            abs=1e-13,
        )
        assert z == pytest.approx(p @ axis / B, abs=1e-13)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_agrees_with_roots_of_the_quadratic(random, psi):
    c, flattening = compute_shape(psi)
    for _ in range(300):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        d = normalize(random.normal(size=3))
        d = -d if d @ m @ p > 0.0 else d
        roots = np.roots([d @ m @ d, 2.0 * d @ m @ p, p @ m @ p - 1.0])
        q = to_unit_sphere(p, axis, c, flattening)
        length, exit_grain = spheroid.compute_chord(make_grain(q, axis, psi), Vector(*d))
        other = np.array(exit_grain.q)
        assert exit_grain[1:] == make_grain(q, axis, psi)[1:]
        assert length > 0.0
        assert length == pytest.approx(roots.real.max(), rel=1e-7, abs=1e-7)
        end = p + length * d
        assert end @ m @ end == pytest.approx(1.0, abs=1e-12)
        assert np.dot(other, other) == pytest.approx(1.0, abs=1e-15)
        assert to_real_space(other, axis, c, flattening) == pytest.approx(end, abs=1e-12)
        n = np.array(spheroid.compute_outward_normal(exit_grain))
        assert n == pytest.approx(normalize(m @ end), abs=1e-12)
        assert n @ d > 0.0


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_outward_ray_has_no_chord(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        grain = make_grain(q, axis, psi)
        n = spheroid.compute_outward_normal(grain)
        d = d if d @ n > 0.0 else -d
        length, exit_grain = spheroid.compute_chord(grain, Vector(*d))
        assert (length, *exit_grain.q) == pytest.approx((0.0, *q), abs=1e-15)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_normalizes_points_off_the_unit_sphere(random, psi):
    for _ in range(100):
        axis, q, d = normalize(random.normal(size=(3, 3)))
        for offset in (-1e-6, 1e-6):
            exit_grain = spheroid.compute_chord(
                make_grain((1.0 + offset) * q, axis, psi), Vector(*d)
            ).grain
            # The error of Newton's method is quadratic: 3/8 (2e-6)².
            assert np.linalg.norm(exit_grain.q) == pytest.approx(1.0, abs=2e-12)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_boundary_overlap_agrees_with_extreme_heights(random, psi):
    c, flattening = compute_shape(psi)
    major, depth = c / (1.0 - flattening), 12.0
    for _ in range(50):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        p = sample_surface_point(random, psi, axis)
        q = to_unit_sphere(p, axis, c, flattening)
        normal = Vector(*normalize(m @ p))
        entry = EntryPoint(make_grain(q, axis, psi), normal, float(q @ axis), major)
        # At the topmost point the gradient is along z.
        top = np.linalg.solve(m, [0.0, 0.0, 1.0])
        top = (top / np.sqrt(top @ m @ top))[2]
        for excess in (-1e-12, 1e-12):
            for height in (p[2] - top + excess, p[2] + top - depth - excess):
                overlaps = spheroid.overlaps_boundary(entry, height, -depth, 0.0)
                assert overlaps == (excess > 0.0)
        # A random height, and boundaries closer than the height of the grain.
        height = random.uniform(-depth, 0.0)
        outside = height - p[2] + top > 0.0 or height - p[2] - top < -depth
        assert spheroid.overlaps_boundary(entry, height, -depth, 0.0) == outside
        assert spheroid.overlaps_boundary(entry, -0.5 * top + p[2], -1.9 * top, 0.0)


def overlaps_segment(start, d, length, p, axis, psi):
    """Return whether a segment, relative to the centre, overlaps a grain of surface point p."""
    grain = make_grain(to_unit_sphere(p, axis, *compute_shape(psi)), axis, psi)
    end = start + length * d - p
    return spheroid.overlaps_segment(grain, Segment(Vector(*end), Vector(*d), length))


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_segment_overlap_agrees_with_sampled_points(random, psi):
    c, flattening = compute_shape(psi)
    steps = 2000
    n_overlapping = n_separate = 0
    for _ in range(400):
        axis = normalize(random.normal(size=3))
        m = make_quadratic_form(psi, axis)
        # Segments through a point inside or near the grain, in any direction.
        d = normalize(random.normal(size=3))
        near = sample_surface_point(random, psi, axis) * random.uniform(0.0, 2.0)
        start = near - d * random.normal() * B
        length = random.exponential(2.0 * B)
        points = start + np.linspace(0.0, length, steps)[:, None] * d
        nearest = np.einsum("ij,jk,ik->i", points, m, points).min()
        # Between two points the quadratic form is at most (half a step)² / c² below the lower one.
        tolerance = (0.5 * length / (steps - 1) / c) ** 2
        # The result must not depend on the surface point that represents the grain.
        result = [
            overlaps_segment(start, d, length, sample_surface_point(random, psi, axis), axis, psi)
            for _ in range(3)
        ]
        if nearest < 1.0:
            assert all(result)
            n_overlapping += 1
        elif nearest > 1.0 + tolerance:
            assert not any(result)
            n_separate += 1
        p = sample_surface_point(random, psi, axis)
        # A missing segment overlaps nothing.
        grain = make_grain(to_unit_sphere(p, axis, c, flattening), axis, psi)
        assert not spheroid.overlaps_segment(
            grain, Segment(Vector(*-p), Vector(*d), NO_SEGMENT_LENGTH)
        )
    assert n_overlapping > 50 and n_separate > 50


@njit
def _sample_chord(state, types, entry):
    """Return the chord of a straight ray through a sampled grain."""
    b = 1.0 / rng.interpolate_quantile(types.inverse_semi_major, 0, rng.uniform(state))
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
    # Cauchy: volume over mean projected area, averaged over the grains that are hit, is 1/K.
    z = []
    for settings in MEDIA.values():
        snow = splits.Snow(**settings)
        chords = draw_samples(
            _sample_chord, 400_000, snow.make_grain_population().types, PROJECTED_ENTRY
        )
        error = chords.std() / np.sqrt(chords.size)
        z.append((chords.mean() - 1.0 / snow.attenuation_per_m) / error)
    judge_z(z, "mean chord")
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_uniform_entry_shortens_the_chord_of_a_sphere():
    # Uniform entry makes cos uniform, with chord s cos, so the mean is s/2 instead of 2s/3.
    snow = splits.Snow(**MEDIA["one sphere"])
    chords = draw_samples(_sample_chord, 400_000, snow.make_grain_population().types, UNIFORM_ENTRY)
    error = chords.std() / np.sqrt(chords.size)
    judge_z([(chords.mean() - 250e-6) / error], "uniform entry")
