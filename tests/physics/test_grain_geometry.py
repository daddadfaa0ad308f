"""Chords and overlaps of spheroids against brute force; Cauchy's mean chord."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw, judge_z
from numba import njit

import splits
from splits.transport import rng, spheroid

B = 1.7
SPHERICITIES = (0.35, 0.7, 0.9, 1.0)


@pytest.fixture
def random():
    return np.random.default_rng(11)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def shape(psi):
    """Return semi-minor axis, 1/c² and 1/b² − 1/c² as kernels want them."""
    c = B * psi * psi
    return c, 1.0 / c**2, 1.0 / B**2 - 1.0 / c**2


def form(psi, axis):
    """Return the matrix M of the spheroid xᵀ M x = 1 from a rotation into its own axes."""
    c = B * psi * psi
    turn = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, np.argsort(np.abs(axis))[:2]]]))[0]
    return turn @ np.diag([1 / B**2, 1 / c**2, 1 / c**2]) @ turn.T


def surface_point(random, psi, axis):
    """Return a random point on the surface, by scaling a random direction."""
    direction = unit(random.normal(size=3))
    return direction / np.sqrt(direction @ form(psi, axis) @ direction)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_chord_against_roots_of_the_quadratic(random, psi):
    _, minor2, shift = shape(psi)
    for _ in range(300):
        axis = unit(random.normal(size=3))
        m = form(psi, axis)
        p = surface_point(random, psi, axis)
        d = unit(random.normal(size=3))
        d = -d if d @ m @ p > 0.0 else d
        roots = np.roots([d @ m @ d, 2.0 * d @ m @ p, p @ m @ p - 1.0])
        length = spheroid.chord(*p, *d, *axis, minor2, shift)
        assert length > 0.0
        assert length == pytest.approx(roots.real.max(), rel=1e-7, abs=1e-7)
        end = p + length * d
        assert end @ m @ end == pytest.approx(1.0, abs=1e-12)
        n = np.array(spheroid.normal_at(*end, *axis, minor2, shift))
        assert n == pytest.approx(unit(m @ end), abs=1e-12)
        assert n @ d > 0.0


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_half_height_against_the_surface(random, psi):
    c, _, _ = shape(psi)
    for _ in range(20):
        axis = unit(random.normal(size=3))
        m = form(psi, axis)
        # The topmost point has its gradient along z.
        top = np.linalg.solve(m, [0.0, 0.0, 1.0])
        top /= np.sqrt(top @ m @ top)
        assert spheroid.half_height(axis[2], B, c) == pytest.approx(top[2], rel=1e-12)


@pytest.mark.parametrize("psi", SPHERICITIES)
def test_cuts_segment_against_points_along_it(random, psi):
    c, minor2, shift = shape(psi)
    steps = 2000
    cut = missed = 0
    for _ in range(400):
        axis = unit(random.normal(size=3))
        m = form(psi, axis)
        # Through a point inside or near the grain, from a start and to an end on either side.
        d = unit(random.normal(size=3))
        near = surface_point(random, psi, axis) * random.uniform(0.0, 2.0)
        start = near - d * random.normal() * B
        length = random.exponential(2.0 * B)
        points = start + np.linspace(0.0, length, steps)[:, None] * d
        nearest = np.einsum("ij,jk,ik->i", points, m, points).min()
        # Between two points the form falls at most (half a step)² / c² below the lower one.
        slack = (0.5 * length / (steps - 1) / c) ** 2
        result = spheroid.cuts_segment(*start, *d, length, *axis, minor2, shift)
        if nearest < 1.0:
            assert result
            cut += 1
        elif nearest > 1.0 + slack:
            assert not result
            missed += 1
    assert cut > 50 and missed > 50


@njit
def _struck_chord(state, grains, entry):
    """Return the straight chord through a struck grain that does not bend the ray."""
    b = 1.0 / rng.from_table(grains.curvature, 0, rng.uniform(state))
    psi = rng.from_table(grains.sphericity, 0, rng.uniform(state))
    d1, d2, d3 = 0.48, -0.64, 0.6
    p1, p2, p3, w1, w2, w3, _, _, _ = spheroid.struck_point(state, d1, d2, d3, b, psi, entry)
    minor2 = 1.0 / (b * psi * psi) ** 2
    shift = 1.0 / (b * b) - minor2
    return spheroid.chord(p1, p2, p3, d1, d2, d3, w1, w2, w3, minor2, shift)


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
        chords = draw(_struck_chord, 400_000, snow.grains(), spheroid.PROJECTED)
        error = chords.std() / np.sqrt(chords.size)
        z.append((chords.mean() - 1.0 / snow.attenuation_per_m) / error)
    judge_z(z, "mean chord")
    assert np.abs(z).max() < 3.0


@NEEDS_JIT
def test_uniform_entry_shortens_the_chord_of_a_sphere():
    # Entry even over the facing half: cos even, chord s cos, so s/2 instead of 2s/3.
    snow = splits.Snow(**MEDIA["one sphere"])
    chords = draw(_struck_chord, 400_000, snow.grains(), spheroid.UNIFORM)
    error = chords.std() / np.sqrt(chords.size)
    judge_z([(chords.mean() - 250e-6) / error], "uniform entry")
