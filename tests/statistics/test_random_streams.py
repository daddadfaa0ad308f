"""Uniform random numbers: distribution, serial independence, independence of streams."""

from __future__ import annotations

import numpy as np
from chi2 import (
    SEED,
    compute_p_of_counts,
    compute_p_of_values,
    draw_samples,
    judge_p,
    judge_z,
    scale_sample_size,
)
from numba import njit

from splits.kernels import rng

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
        pairs = np.histogram2d(u[:-lag:2], u[lag::2], bins=12, range=((0, 1), (0, 1)))[0]
        p[f"pairs at lag {lag}"] = compute_p_of_counts(pairs, np.full(144, 1 / 144))
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
        counts = np.histogram2d(first[::2], first[1::2], bins=12, range=((0, 1), (0, 1)))[0]
        p[name] = compute_p_of_counts(counts, np.full(144, 1 / 144))
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
