"""Half-normal numbers, directions on circle, sphere and in lobes, and local frames."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import (
    NEEDS_JIT,
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    scale_sample_size,
)
from events import (
    attempt_interaction,
    attempt_interaction_by_lane,
    make_lanes,
    sample_unit_sphere,
    to_single_precision,
)
from numba import njit
from scipy import stats

import splits
from splits.kernels import arithmetic, rng
from splits.kernels.arithmetic import Angle, Vector
from splits.kernels.grains.surface import InterfaceState, relative_index
from splits.kernels.interface import ComplexIndex

N_SAMPLES = scale_sample_size(200_000)
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


def uniform_cdf(u):
    return u


def compute_azimuth_fraction(x, y):
    """Return the azimuth as a fraction of a turn."""
    return (np.arctan2(y, x) / (2.0 * np.pi)) % 1.0


def compute_p_of_unit_square(a, b, bins=12):
    """Return the chi-square p-value of pairs that should be uniform on the unit square."""
    counts = np.histogram2d(a, b, bins=bins, range=((0, 1), (0, 1)))[0]
    assert counts.sum() == a.size
    return compute_p_of_counts(counts, np.full(bins * bins, 1.0 / bins**2))


def test_half_normal_numbers_follow_their_distribution():
    x = draw_samples(rng.sample_half_normal, N_SAMPLES)
    # Bins far in the tail as well as bins of equal probability.
    edges = np.concatenate([np.arange(1, 50) / 50, 1.0 - np.array([1e-2, 3e-3, 1e-3, 3e-4])])
    p = {
        "half normal": compute_p_of_values(x, stats.halfnorm.cdf, edges),
        "successive": compute_p_of_unit_square(
            stats.halfnorm.cdf(x[::2]), stats.halfnorm.cdf(x[1::2])
        ),
    }
    judge_p(p)


def test_azimuths_are_uniform():
    points = draw_samples(rng.sample_azimuth, N_SAMPLES, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    judge_p({"azimuth": compute_p_of_values(compute_azimuth_fraction(*points.T), uniform_cdf, 101)})


@njit
def _sample_circle(state):
    return arithmetic.sample_circle(rng.uniform(state))


@njit
def _sample_half_circle(state):
    return arithmetic.sample_half_circle(rng.uniform(state))


def test_circle_directions_are_uniform():
    points = draw_samples(_sample_circle, N_SAMPLES, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    judge_p({"azimuth": compute_p_of_values(compute_azimuth_fraction(*points.T), uniform_cdf, 101)})


def test_half_circle_directions_are_uniform():
    points = draw_samples(_sample_half_circle, N_SAMPLES, width=2)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    assert points[:, 0].min() > 0.0
    angle = np.arctan2(points[:, 1], points[:, 0])
    judge_p({"angle": compute_p_of_values(angle / np.pi + 0.5, uniform_cdf, 101)})


def test_sphere_directions_are_uniform():
    points = draw_samples(sample_unit_sphere, N_SAMPLES, width=3)
    assert np.abs((points**2).sum(axis=1) - 1.0).max() < 1e-14
    x, y, z = points.T
    # By Archimedes' theorem every coordinate is uniform and independent of the azimuth around it.
    judge_p(
        {
            "around z": compute_p_of_unit_square(0.5 * (1 + z), compute_azimuth_fraction(x, y)),
            "around x": compute_p_of_unit_square(0.5 * (1 + x), compute_azimuth_fraction(y, z)),
            "around y": compute_p_of_unit_square(0.5 * (1 + y), compute_azimuth_fraction(z, x)),
        }
    )


@njit
def _sample_lobe(state, x, y, z):
    return arithmetic.sample_cosine_lobe(Vector(x, y, z), rng.uniform(state), rng.uniform(state))


@njit
def _sample_single_precision_lobe(state, x, y, z):
    u, u_azimuth = np.float32(rng.uniform(state)), np.float32(rng.uniform(state))
    d = arithmetic.sample_cosine_lobe(to_single_precision(Vector(x, y, z)), u, u_azimuth)
    return float(d.x), float(d.y), float(d.z)


def judge_lobe(sampler, rounding, *args, sign=1.0):
    """Fail unless directions around normals, or against them, have the density cosθ/π."""
    p = {}
    for normal in NORMALS:
        points = sign * draw_samples(sampler, N_SAMPLES, *normal, *args, width=3)
        assert np.abs((points**2).sum(axis=1) - 1.0).max() < rounding
        # The frame around the normal is independent of that of the kernel.
        u = np.cross(normal, [0.267, 0.535, 0.802])
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        cosine = points @ normal
        assert cosine.min() > (0.0 if rounding < 1e-7 else -rounding)
        square = np.clip(cosine, 0.0, 1.0) ** 2
        p[tuple(normal)] = compute_p_of_unit_square(
            square, compute_azimuth_fraction(points @ u, points @ v)
        )
    judge_p(p)


def test_cosine_lobe_follows_its_density():
    judge_lobe(_sample_lobe, 1e-14)


@NEEDS_JIT
def test_cosine_lobe_in_single_precision():
    judge_lobe(_sample_single_precision_lobe, 1e-6)


MEDIA = relative_index(ComplexIndex(1.0, 0.0), ComplexIndex(1.31, 0.0))
RULES = splits.Interpretation().to_sampling_rules()


@njit
def _sample_grain_lobe(state, x, y, z, transmitted):
    """Return the lobe direction of a ray that a facet of a grain sent to the wrong side."""
    normal = Vector(x, y, z)
    # Any direction against the normal.
    t = arithmetic.make_tangents(normal)
    d = arithmetic.linear_combination(0.6, t.u, -0.8, normal)
    result = attempt_interaction(
        state, d, InterfaceState(0.0, 1.0, True, transmitted), normal, 0.5, MEDIA, RULES
    )
    return (
        result.direction
        if result.accepted and result.transmitted == transmitted
        else Vector(0.0, 0.0, 0.0)
    )


@njit
def _sample_grain_lobe_by_lane(state, x, y, z, lanes, transmitted):
    normal = Vector(x, y, z)
    t = arithmetic.make_tangents(normal)
    d = to_single_precision(arithmetic.linear_combination(0.6, t.u, -0.8, normal))
    interface_state = InterfaceState(np.float32(0.0), np.float32(1.0), True, transmitted)
    zero, one = np.float32(0.0), np.float32(1.0)
    media = relative_index(ComplexIndex(one, zero), ComplexIndex(np.float32(1.31), zero))
    result = attempt_interaction_by_lane(
        lanes, d, interface_state, to_single_precision(normal), np.float32(0.25), media, RULES
    )
    valid = result.accepted and result.transmitted == transmitted
    return result.direction if valid else to_single_precision(Vector(0.0, 0.0, 0.0))


@pytest.mark.parametrize("transmitted", [False, True])
def test_lobe_of_a_grain_follows_the_cosine(transmitted):
    judge_lobe(_sample_grain_lobe, 1e-14, transmitted, sign=-1.0 if transmitted else 1.0)


@NEEDS_JIT
@pytest.mark.parametrize("transmitted", [False, True])
def test_lobe_of_a_grain_in_single_precision(transmitted):
    lanes = make_lanes()
    judge_lobe(
        _sample_grain_lobe_by_lane, 1e-6, lanes, transmitted, sign=-1.0 if transmitted else 1.0
    )


@njit
def _make_bases(normals, out):
    for i in range(normals.shape[0]):
        t = arithmetic.make_tangents(Vector(normals[i, 0], normals[i, 1], normals[i, 2]))
        for j in range(3):
            out[i, j] = t.u[j]
            out[i, 3 + j] = t.v[j]


def test_tangents_are_orthonormal():
    random = draw_samples(sample_unit_sphere, scale_sample_size(20_000), width=3)
    near_pole = np.array([[1e-8, 1e-8, 1.0], [1e-8, -1e-8, -1.0], [0.0, 1.0, 0.0]])
    normals = np.concatenate([NORMALS, near_pole, random])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    out = np.empty((len(normals), 6))
    _make_bases(normals, out)
    frame = np.stack([out[:, :3], out[:, 3:], normals], axis=1)
    gram = frame @ frame.transpose(0, 2, 1)
    assert np.abs(gram - np.eye(3)).max() < 1e-14
    assert np.abs(np.linalg.det(frame) - 1.0).max() < 1e-14


def test_rotate_around_keeps_the_polar_angle():
    for cosine in (-1.0, -0.3, 0.0, 0.4, 1.0):
        sine = np.sqrt(1.0 - cosine**2)
        for normal in NORMALS[:6]:
            d = np.array(
                arithmetic.direction_around(
                    Vector(*normal), Angle(cosine, sine), Angle(0.28, -0.96)
                )
            )
            assert abs(d @ normal - cosine) < 1e-14
            assert abs(d @ d - 1.0) < 1e-14


def test_reflect_reverses_the_normal_component():
    for normal in NORMALS[:6]:
        d = np.array([0.36, -0.48, 0.8])
        m = np.array(arithmetic.reflect(Vector(*d), Vector(*normal)))
        assert abs(m @ m - 1.0) < 1e-14
        assert abs(m @ normal + d @ normal) < 1e-14
        assert np.abs(np.cross(m - d, normal)).max() < 1e-14
