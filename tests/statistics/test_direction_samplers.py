"""Uniform and half-normal random numbers, directions in lobes, and independence of streams."""

import numpy as np
import pytest
from chi2 import (
    NEEDS_JIT,
    SEED,
    compute_p_of_unit_square,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
    uniform_cdf,
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
from splits.kernels.arithmetic import Angle
from splits.kernels.grains.surface import InterfaceState, relative_index
from splits.kernels.interface import ComplexIndex
from splits.kernels.scene import Vector

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


def compute_azimuth_fraction(x, y):
    """Return the azimuth as a fraction of a turn."""
    return (np.arctan2(y, x) / (2.0 * np.pi)) % 1.0


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


@pytest.mark.parametrize(
    ("sampler", "rounding"),
    [
        (_sample_lobe, 1e-14),
        pytest.param(_sample_single_precision_lobe, 1e-6, marks=NEEDS_JIT),
    ],
    ids=["double", "single"],
)
def test_cosine_lobe_follows_its_density(sampler, rounding):
    judge_lobe(sampler, rounding)


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


MASK = 2**64 - 1
N_STREAMS = scale_sample_size(400_000)


@njit
def _fill_first_numbers(state, seeds, ensembles, rays, out):
    for i in range(out.shape[0]):
        rng.start_stream(state, seeds[i], ensembles[i], rays[i])
        for j in range(out.shape[1]):
            out[i, j] = rng.uniform(state)


def draw_first_numbers(count, seed=None, ensemble=None, ray=None, width=4):
    """Return the first numbers of `count` streams; arguments that are None run over 0, 1, 2, …"""
    numbers = np.arange(count)
    fixed = [numbers if x is None else np.full(count, x) for x in (seed, ensemble, ray)]
    out = np.empty((count, width))
    _fill_first_numbers(np.zeros(1, dtype=np.uint64), *fixed, out)
    return out


NEIGHBOURS = {
    "rays": {"seed": SEED, "ensemble": 0},
    "ensembles": {"seed": SEED, "ray": 0},
    "seeds": {"ensemble": 0, "ray": 0},
}


def compute_correlation_z(a, b):
    """Return the correlation of two uniform samples in standard errors (variance 1/12 each)."""
    return ((a - 0.5) * (b - 0.5)).sum() * 12.0 / np.sqrt(a.size)


def test_numbers_are_uniform_singly_and_in_pairs():
    u = draw_samples(rng.uniform, N_STREAMS)
    p = {"one": compute_p_of_values(u, lambda x: x, 128)}
    for lag in (1, 2, 3):
        n = (u.size - lag) // 2
        p[f"pairs at lag {lag}"] = compute_p_of_unit_square(u[: 2 * n : 2], u[lag::2][:n])
    judge_p(p)


def test_numbers_have_no_serial_correlation():
    u = draw_samples(rng.uniform, N_STREAMS)
    judge_z([compute_correlation_z(u[:-lag], u[lag:]) for lag in (1, 2, 3, 4, 5, 8, 16, 64)])


def test_low_bits_are_uniform():
    # The last 13 of the 53 bits: a weak finaliser would leave patterns in them.
    u = draw_samples(rng.uniform, N_STREAMS)
    low = np.modf(u * 2.0**40)[0]
    judge_p({"low bits": compute_p_of_values(low, lambda x: x, 64)})


def test_neighbouring_streams_are_uniform():
    p = {}
    for name, fixed in NEIGHBOURS.items():
        out = draw_first_numbers(N_STREAMS // 4, **fixed)
        for j in range(out.shape[1]):
            p[name, j] = compute_p_of_values(out[:, j], lambda x: x, 64)
    judge_p(p)


def test_neighbouring_streams_are_independent():
    z = []
    for fixed in NEIGHBOURS.values():
        out = draw_first_numbers(N_STREAMS // 4, **fixed)
        for j in range(out.shape[1]):
            # Stream i against stream i + 1: the same number, and the next one (a shifted copy).
            z.append(compute_correlation_z(out[:-1, j], out[1:, j]))
            z.append(compute_correlation_z(out[:-1, j], out[1:, (j + 1) % out.shape[1]]))
        z.append(compute_correlation_z(out[:, 0], out[:, 1]))
    judge_z(z)


def test_neighbouring_streams_are_uniform_in_pairs():
    p = {}
    for name, fixed in NEIGHBOURS.items():
        first = draw_first_numbers(N_STREAMS // 2, width=1, **fixed)[:, 0]
        p[name] = compute_p_of_unit_square(first[::2], first[1::2])
    judge_p(p)


def test_streams_differ_for_all_seeds_ensembles_and_rays():
    # (1, 2, 3), its permutations and tuples of equal sums must all give different states.
    names = [(a, b, c) for a in range(6) for b in range(6) for c in range(6)]
    starts = set()
    for name in names:
        state = np.zeros(1, dtype=np.uint64)
        rng.start_stream(state, *name)
        starts.add(int(state[0]))
    assert len(starts) == len(names)


def test_stream_is_reproducible():
    assert (draw_samples(rng.uniform, 1000, ray=7) == draw_samples(rng.uniform, 1000, ray=7)).all()
    assert (draw_samples(rng.uniform, 1000, ray=7) != draw_samples(rng.uniform, 1000, ray=8)).all()


def invert_xorshift(value, shift):
    """Return x with ``x ^ (x >> shift) == value``."""
    x = value
    for _ in range(64 // shift + 1):
        x = value ^ (x >> shift)
    return x


def invert_generator(word):
    """Return the state from which the next 64 random bits are `word`."""
    z = invert_xorshift(word, 31)
    z = z * pow(0x94D049BB133111EB, -1, 2**64) & MASK
    z = invert_xorshift(z, 27)
    z = z * pow(0xBF58476D1CE4E5B9, -1, 2**64) & MASK
    z = invert_xorshift(z, 30)
    return np.array([(z - 0x9E3779B97F4A7C15) & MASK], dtype=np.uint64)


def test_extreme_numbers_lie_in_the_open_interval():
    # The finaliser is a bijection, so the states before the extreme words can be computed.
    smallest = rng.uniform(invert_generator(0))
    largest = rng.uniform(invert_generator(MASK))
    assert 0.0 < smallest < 1e-15
    assert 1.0 - 1e-15 < largest < 1.0
