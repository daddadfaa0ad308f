"""Half-normal numbers, directions on circle, sphere and in lobes, and the frames around them."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw, judge_p, p_of_counts, p_of_values, scaled
from events import lane_words, singly, tried, tried_by_lane, unit_sphere
from numba import njit
from scipy import stats

import splits
from splits.transport.grains.surface import Stand, contrast
from splits.transport.numerics import elementary, rng, vectors
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.faces import Index

COUNT = scaled(200_000)
NORMALS = np.array(
    [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [1.0, 0.0, 0.0],
        [0.0, -1.0, -0.0],
        [0.6, 0.0, -0.8],
        [-0.48, 0.64, 0.6],
        [1e-9, -1e-9, -1.0],
        [0.8, -0.6, 1e-12],
    ]
)


def evenly(u):
    return u


def azimuth_share(x, y):
    """Return the azimuth as a fraction of a turn."""
    return (np.arctan2(y, x) / (2.0 * np.pi)) % 1.0


def p_square(a, b, cells=12):
    """Return the chi-square p-value of pairs that should fill the unit square evenly."""
    counts = np.histogram2d(a, b, bins=cells, range=((0, 1), (0, 1)))[0]
    assert counts.sum() == a.size
    return p_of_counts(counts, np.full(cells * cells, 1.0 / cells**2))


def test_half_normal():
    x = draw(rng.half_normal, COUNT)
    # Cells far out in the tail as well as cells of equal probability.
    edges = np.concatenate([np.arange(1, 50) / 50, 1.0 - np.array([1e-2, 3e-3, 1e-3, 3e-4])])
    p = {
        "half normal": p_of_values(x, stats.halfnorm.cdf, edges),
        "successive": p_square(stats.halfnorm.cdf(x[::2]), stats.halfnorm.cdf(x[1::2])),
    }
    judge_p(p)


def test_unit_circle():
    points = draw(rng.unit_circle, COUNT, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    judge_p({"azimuth": p_of_values(azimuth_share(*points.T), evenly, 101)})


@njit
def _circle(state):
    return elementary.circle(rng.uniform(state))


@njit
def _half_circle(state):
    return elementary.half_circle(rng.uniform(state))


def test_circle():
    points = draw(_circle, COUNT, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    judge_p({"azimuth": p_of_values(azimuth_share(*points.T), evenly, 101)})


def test_half_circle():
    points = draw(_half_circle, COUNT, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    assert points[:, 0].min() > 0.0
    angle = np.arctan2(points[:, 1], points[:, 0])
    judge_p({"angle": p_of_values(angle / np.pi + 0.5, evenly, 101)})


def test_unit_sphere():
    points = draw(unit_sphere, COUNT, width=3)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-14
    x, y, z = points.T
    # Archimedes: every coordinate is uniform, and independent of the azimuth around it.
    judge_p(
        {
            "around z": p_square(0.5 * (1 + z), azimuth_share(x, y)),
            "around x": p_square(0.5 * (1 + x), azimuth_share(y, z)),
            "around y": p_square(0.5 * (1 + y), azimuth_share(z, x)),
        }
    )


@njit
def _lobe(state, x, y, z):
    return vectors.lobe(Vector(x, y, z), rng.uniform(state), rng.uniform(state))


@njit
def _single_lobe(state, x, y, z):
    u, turn = np.float32(rng.uniform(state)), np.float32(rng.uniform(state))
    d = vectors.lobe(singly(Vector(x, y, z)), u, turn)
    return float(d.x), float(d.y), float(d.z)


def judge_lobe(sampler, rounding, *args, sign=1.0):
    """Fail unless directions around normals, or against them, have the density cosθ/π."""
    p = {}
    for normal in NORMALS:
        points = sign * draw(sampler, COUNT, *normal, *args, width=3)
        assert np.abs((points**2).sum(axis=1) - 1.0).max() < rounding
        # An independent frame: any two vectors that complete the normal.
        u = np.cross(normal, [0.267, 0.535, 0.802])
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        cosine = points @ normal
        assert cosine.min() > (0.0 if rounding < 1e-7 else -rounding)
        square = np.clip(cosine, 0.0, 1.0) ** 2
        p[tuple(normal)] = p_square(square, azimuth_share(points @ u, points @ v))
    judge_p(p)


def test_lobe():
    judge_lobe(_lobe, 1e-14)


@NEEDS_JIT
def test_lobe_in_single_precision():
    judge_lobe(_single_lobe, 1e-6)


MEDIA = contrast(Index(1.0, 0.0), Index(1.31, 0.0))
RULES = splits.Readings().rules()


@njit
def _grain_lobe(state, x, y, z, through):
    """Return where a rough grain sends a ray that was to go to the wrong side of its surface."""
    normal = Vector(x, y, z)
    # Any direction against the normal.
    t = vectors.tangents(normal)
    d = vectors.combined(0.6, t.u, -0.8, normal)
    after = tried(state, d, Stand(0.0, 1.0, True, through), normal, 0.5, MEDIA, RULES)
    return after.direction if after.accepted and after.transmitted == through else Vector(0.0, 0.0, 0.0)


@njit
def _grain_lobe_by_lane(state, x, y, z, words, through):
    normal = Vector(x, y, z)
    t = vectors.tangents(normal)
    d = singly(vectors.combined(0.6, t.u, -0.8, normal))
    stand = Stand(np.float32(0.0), np.float32(1.0), True, through)
    zero, one = np.float32(0.0), np.float32(1.0)
    media = contrast(Index(one, zero), Index(np.float32(1.31), zero))
    after = tried_by_lane(words, d, stand, singly(normal), np.float32(0.25), media, RULES)
    sound = after.accepted and after.transmitted == through
    return after.direction if sound else singly(Vector(0.0, 0.0, 0.0))


@pytest.mark.parametrize("through", [False, True])
def test_lobe_of_a_grain(through):
    judge_lobe(_grain_lobe, 1e-14, through, sign=-1.0 if through else 1.0)


@NEEDS_JIT
@pytest.mark.parametrize("through", [False, True])
def test_lobe_of_a_grain_in_single_precision(through):
    words = lane_words()
    judge_lobe(_grain_lobe_by_lane, 1e-6, words, through, sign=-1.0 if through else 1.0)


@njit
def _bases(normals, out):
    for i in range(normals.shape[0]):
        t = vectors.tangents(Vector(normals[i, 0], normals[i, 1], normals[i, 2]))
        for j in range(3):
            out[i, j] = t.u[j]
            out[i, 3 + j] = t.v[j]


def test_tangents():
    random = draw(unit_sphere, scaled(20_000), width=3)
    near_pole = np.array([[1e-8, 1e-8, 1.0], [1e-8, -1e-8, -1.0], [0.0, 1.0, 0.0]])
    normals = np.concatenate([NORMALS, near_pole, random])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    out = np.empty((len(normals), 6))
    _bases(normals, out)
    frame = np.stack([out[:, :3], out[:, 3:], normals], axis=1)
    gram = frame @ frame.transpose(0, 2, 1)
    assert np.abs(gram - np.eye(3)).max() < 1e-14
    assert np.abs(np.linalg.det(frame) - 1.0).max() < 1e-14


def test_around_keeps_the_polar_angle():
    for cosine in (-1.0, -0.3, 0.0, 0.4, 1.0):
        sine = np.sqrt(1.0 - cosine**2)
        for normal in NORMALS[:6]:
            d = np.array(vectors.around(Vector(*normal), Angle(cosine, sine), Angle(0.28, -0.96)))
            assert abs(d @ normal - cosine) < 1e-14
            assert abs(d @ d - 1.0) < 1e-14


def test_mirrored():
    for normal in NORMALS[:6]:
        d = np.array([0.36, -0.48, 0.8])
        m = np.array(vectors.mirrored(Vector(*d), Vector(*normal)))
        assert abs(m @ m - 1.0) < 1e-14
        assert abs(m @ normal + d @ normal) < 1e-14
        assert np.abs(np.cross(m - d, normal)).max() < 1e-14
