"""Half-normal numbers, directions on circle, sphere and in lobes, and the frames around them."""

from __future__ import annotations

import numpy as np
from chi2 import draw, judge_p, p_of_counts, p_of_values, scaled
from numba import njit
from scipy import stats

from splits.transport import frames, rng

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


def test_unit_sphere():
    points = draw(rng.unit_sphere, COUNT, width=3)
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


def test_cosine_lobe():
    p = {}
    for normal in NORMALS:
        points = draw(frames.cosine_lobe, COUNT, *normal, width=3)
        assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-14
        # An independent frame: any two vectors that complete the normal.
        u = np.cross(normal, [0.267, 0.535, 0.802])
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        cosine = points @ normal
        assert cosine.min() > 0.0
        p[tuple(normal)] = p_square(cosine**2, azimuth_share(points @ u, points @ v))
    judge_p(p)


@njit
def _bases(normals, out):
    for i in range(normals.shape[0]):
        basis = frames.orthonormal_basis(normals[i, 0], normals[i, 1], normals[i, 2])
        for j in range(6):
            out[i, j] = basis[j]


def test_orthonormal_basis():
    random = draw(rng.unit_sphere, scaled(20_000), width=3)
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
            d = np.array(frames.around(*normal, cosine, sine, 0.28, -0.96))
            assert abs(d @ normal - cosine) < 1e-14
            assert abs(d @ d - 1.0) < 1e-14


def test_mirrored():
    for normal in NORMALS[:6]:
        d = np.array([0.36, -0.48, 0.8])
        m = np.array(frames.mirrored(*d, *normal))
        assert abs(m @ m - 1.0) < 1e-14
        assert abs(m @ normal + d @ normal) < 1e-14
        assert np.abs(np.cross(m - d, normal)).max() < 1e-14
