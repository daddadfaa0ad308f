"""What lanes draw, in single precision, against the laws it must follow: single functions."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from chi2 import (
    CELLS,
    EDGES,
    NEEDS_JIT,
    TAILS,
    draw,
    evenly,
    judge_p,
    p_of_counts,
    p_of_values,
    stream,
)
from events import facet_struck_by_lane, lane_words, singly
from numba import njit
from scipy import stats

from splits.media import grain_statistics
from splits.transport.grains import facets
from splits.transport.lanes import draws, numbers, rows
from splits.transport.lanes.surface import numbers_at
from splits.transport.lanes.vectors import look_up
from splits.transport.numerics import rng
from splits.transport.numerics.elementary import circle, logarithm
from splits.transport.numerics.vectors import UP, Vector

pytestmark = NEEDS_JIT

COUNT = 400_000
single = np.float32


@njit
def bits(state):
    """Return the stream's next 64 random bits."""
    state[0] += rng.GOLDEN
    return rng.mix64(state[0])


# --- streams ----------------------------------------------------------------------------------


@njit
def _words(words, lane, first, out):
    for offset in range(out.size):
        words[rows.COUNT + lane] = np.uint32(first)
        out[offset] = numbers.word(words, lane, offset)


@njit
def _below_one(bits):
    return numbers.below_one(np.uint64(bits))


def test_the_largest_numbers_are_below_one():
    """Rounded to 1, a number would choose a type of grain beyond the last."""
    assert max(_below_one(2**31 - 1 - i) for i in range(200)) == 1.0 - 2.0**-24
    assert _below_one(0) == 2.0**-32
    assert _below_one(2**30) == 0.5


@njit
def _stream_words(state, out):
    for i in range(out.size):
        out[i] = bits(state)


@njit
def _doubles(words, out):
    for i in range(out.size):
        out[i] = numbers.double(words[i])


@njit
def _uniforms(state, out):
    for i in range(out.size):
        out[i] = rng.uniform(state)


def key(words, lane, start):
    words[rows.KEY_HIGH + lane] = start >> 32
    words[rows.KEY_LOW + lane] = start & 0xFFFFFFFF


@pytest.mark.parametrize("lane", [0, 1, rows.LANES - 1])
def test_a_lane_draws_the_stream_of_its_ray(lane):
    words = np.full(rows.WORDS, 0xDEADBEEF, dtype=np.uint32)
    for ray in (0, 1, 12_345, 2**40):
        state = stream(ray)
        key(words, lane, int(state[0]))
        expected, found = (np.empty(1000, dtype=np.uint64) for _ in range(2))
        _stream_words(state, expected)
        # A fresh ray has drawn none: its count starts at 1.
        _words(words, lane, 1, found)
        np.testing.assert_array_equal(found, expected)
        _words(words, lane, 101, found[:900])
        np.testing.assert_array_equal(found[:900], expected[100:])
        doubles, uniforms = np.empty(1000), np.empty(1000)
        _doubles(expected, doubles)
        _uniforms(stream(ray), uniforms)
        np.testing.assert_array_equal(doubles, uniforms)


def test_numbers_continue_past_two_to_the_31():
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    start = stream(5)
    key(words, 3, int(start[0]))
    found, expected = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.uint64)
    for first in (2**31 - 32, 2**32 - 64):
        _words(words, 3, first, found)
        ahead = (int(start[0]) + (first - 1) * int(rng.GOLDEN)) % 2**64
        _stream_words(np.array([ahead], dtype=np.uint64), expected)
        np.testing.assert_array_equal(found, expected)


# --- uniform numbers --------------------------------------------------------------------------


@njit
def _three(state):
    a, b, c = numbers.three(bits(state))
    return float(a), float(b), float(c)


@njit
def _of_bits(word):
    a, b, c = numbers.three(word)
    return float(a), float(b), float(c), float(numbers.fine(word)), numbers.double(word)


def test_three_numbers_are_uniform_and_independent():
    out = draw(_three, COUNT, width=3)
    assert out.min() > 0.0 and out.max() < 1.0
    p = {i: p_of_values(out[:, i], evenly, EDGES) for i in range(3)}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        cells = np.histogram2d(out[:, i], out[:, j], bins=12, range=((0, 1), (0, 1)))[0]
        p[i, j] = p_of_counts(cells, np.full(144, 1 / 144))
    cube = np.histogramdd(out, bins=6, range=[(0, 1)] * 3)[0]
    p["all"] = p_of_counts(cube, np.full(216, 1 / 216))
    # From one draw to the next, and in the lowest of the 21 bits.
    pairs = np.histogram2d(out[:-1, 2], out[1:, 0], bins=12, range=((0, 1), (0, 1)))[0]
    p["successive"] = p_of_counts(pairs, np.full(144, 1 / 144))
    for i in range(3):
        p["low bits", i] = p_of_values(np.modf(out[:, i] * 2.0**15)[0], evenly, 16)
    judge_p(p)


def test_numbers_of_the_extreme_words():
    ends = [np.array(_of_bits(np.uint64(word))) for word in (0, 2**64 - 1)]
    assert ends[0] == pytest.approx([2.0**-22] * 3 + [2.0**-47, 2.0**-53], rel=1e-7)
    assert ends[1][:3] == pytest.approx([1.0 - 2.0**-22] * 3, abs=1e-9)
    assert (ends[1][:3] < 1.0).all() and ends[1][4] < 1.0
    # Rounded to single precision, the largest is 1: its logarithm is 0, and finite.
    assert ends[1][3] <= 1.0


@njit
def _fine(state, zeros):
    """Return a number drawn with so many leading zero bits, times 2^zeros."""
    word = bits(state) >> np.uint64(zeros)
    return float(numbers.fine(word)) * 2.0**zeros


@njit
def _flown(state, zeros):
    """Return −ln u of such a number beyond the part that the zeros stand for."""
    word = bits(state) >> np.uint64(zeros)
    return -float(logarithm(numbers.fine(word))) - zeros * math.log(2.0)


def test_fine_numbers_are_uniform_down_to_their_lower_tail():
    """Among numbers below 2^-k, hardly ever drawn, the law is the same after scaling."""
    p = {}
    for zeros in (0, 1, 10, 22, 23, 24, 30, 36):
        u = draw(_fine, COUNT, zeros, ray=zeros)
        assert u.min() > 0.0 and u.max() <= 1.0
        # Cells of 2^-46: enough of them below 2^-36 to fill 64 cells of equal probability.
        p["uniform", zeros] = p_of_values(np.minimum(u, 1.0 - 1e-12), evenly, 64)
        if zeros <= 30:
            tail = np.concatenate([CELLS, 1.0 - TAILS[::-1]])
            # Less than the smallest number's own cell is not resolved: 6e-8 in the logarithm.
            flown = draw(_flown, COUNT, zeros, ray=100 + zeros)
            p["exponential", zeros] = p_of_values(np.maximum(flown, 0.0), stats.expon.cdf, tail)
    judge_p(p)


@njit
def _circle(state):
    u, _, _ = numbers.three(bits(state))
    x, y = circle(u)
    return float(x), float(y)


def test_azimuths_are_uniform():
    x, y = draw(_circle, COUNT, width=2).T
    assert np.abs(x * x + y * y - 1.0).max() < 2e-6
    judge_p({"azimuth": p_of_values(np.arctan2(y, x) / (2.0 * np.pi) % 1.0, evenly, 101)})


# --- leaning facets ---------------------------------------------------------------------------


@njit
def _half_normal(state, words):
    return float(numbers_at(words, 0, True, True).half_normal)


@njit
def _half_circle(state, words):
    azimuth = numbers_at(words, 0, True, True).azimuth
    return float(azimuth.cos), float(azimuth.sin)


def test_numbers_of_a_trial():
    far = np.concatenate([np.arange(1, 50) / 50, 1.0 - np.array([1e-2, 3e-3, 1e-3, 3e-4])])
    normal = draw(_half_normal, COUNT, lane_words())
    cos, sin = draw(_half_circle, COUNT, lane_words(), width=2).T
    assert np.abs(cos * cos + sin * sin - 1.0).max() < 1e-6 and cos.min() > -1e-6
    p = {
        "normal": p_of_values(normal, stats.halfnorm.cdf, far),
        "azimuth": p_of_values(np.arctan2(sin, cos) / np.pi + 0.5, evenly, 101),
    }
    cells = np.histogram2d(
        stats.halfnorm.cdf(normal), np.arctan2(sin, cos) / np.pi + 0.5, bins=12,
        range=((0, 1), (0, 1)),
    )[0]  # fmt: skip
    p["both"] = p_of_counts(cells, np.full(144, 1 / 144))
    judge_p(p)


@njit
def _leaning(state, words, sigma):
    """Return 1 − n·n' of any facet, whether it faces the ray or not."""
    d = singly(Vector(0.6, 0.0, -0.8))
    facet = facet_struck_by_lane(words, d, singly(UP), sigma, facets.ANY)
    return float(single(1.0) - facet.tilt.cos)


def test_leaning_is_half_normal():
    p = {}
    for facetness in (0.1, 0.3, 1.0):
        sigma = 0.5 * facetness
        x = draw(_leaning, COUNT, lane_words(int(100 * facetness)), single(sigma))
        assert x.min() >= 0.0 and x.max() < 1.0
        law = stats.truncnorm(0.0, 1.0 / sigma, scale=sigma)
        p[facetness] = p_of_values(x, law.cdf, EDGES)
        p[facetness, "far"] = p_of_values(x, law.cdf, 1.0 - 10.0 ** -np.arange(1.0, 4.5, 0.5))
    judge_p(p)


def test_a_smooth_facet_does_not_lean():
    assert (draw(_leaning, 1000, lane_words(), single(0.0)) == 0.0).all()


NORMAL = single(1e-4)
"""Least sine of incidence for which facets are turned exactly (`arithmetic.Precision`)."""


@njit
def _facet(state, words, sigma, cos_i, sin_i, rule):
    """Return lean and azimuth of a facet, and of incidence the cosine on it."""
    zero = single(0.0)
    d = Vector(sin_i, zero, -cos_i)
    facet = facet_struck_by_lane(words, d, singly(UP), sigma, rule)
    cos_facet = -facet.cos_facet if facet.back_side else facet.cos_facet
    lean = single(1.0) - facet.tilt.cos
    sine = facet.tilt.sin * max(sin_i, NORMAL)
    return float(lean), float(sine), float(facet.azimuth.sin), float(facet.azimuth.cos), cos_facet


@pytest.mark.parametrize("rule", ["projected", "unweighted", "any"])
def test_facets_are_chosen_as_the_density_says(rule):
    from test_facets import AZIMUTH_CELLS, RULES, TILT_CELLS, cell_probabilities, tilt

    p = {}
    for number, (facetness, cos_i) in enumerate(product((0.3, 1.0), (0.05, 0.5, 1.0))):
        sin_i = math.sqrt(1.0 - cos_i**2)
        out = draw(
            _facet, COUNT, lane_words(100 * number), single(0.5 * facetness), single(cos_i),
            single(sin_i), RULES[rule], width=5,
        )  # fmt: skip
        x, tilt_sine, sine, cosine, cos_facet = out.T
        # Of the lean itself, 1 − cos has lost the last digits.
        assert np.abs(tilt_sine**2 - x * (2.0 - x)).max() < 1e-6
        expected = (1.0 - x) * cos_i + tilt_sine * max(sin_i, NORMAL) * cosine
        assert np.abs(cos_facet - expected).max() < 1e-6
        assert rule == "any" or cos_facet.min() >= 0.0
        turn = np.arctan2(sine, cosine) / (2.0 * np.pi) % 1.0
        counts = np.histogram2d(
            tilt(facetness).cdf(x), turn, bins=(TILT_CELLS, AZIMUTH_CELLS),
            range=((0, 1), (0, 1)),
        )[0]  # fmt: skip
        assert counts.sum() == COUNT
        p[facetness, cos_i] = p_of_counts(counts, cell_probabilities(facetness, cos_i, rule))
    judge_p(p)


# --- tables -----------------------------------------------------------------------------------


@njit
def _looked_up(table, row, x):
    """Return what a lane reads in a table."""
    state = np.zeros(3 * rows.VECTOR, dtype=single)
    state[0], state[rows.VECTOR] = row, x
    look_up(table, state, 0, rows.VECTOR, 2 * rows.VECTOR)
    return state[2 * rows.VECTOR]


@njit
def _read(state, table):
    """Return a quantile as `draw_types` does: 31 bits, and a position in single precision."""
    u = (single(np.int32(bits(state) >> np.uint64(33))) + single(0.5)) * single(2.0**-31)
    return float(_looked_up(table, 0, draws.position(u, single(table.shape[1] - 1))))


@njit
def _read_at(table, exact, u, out):
    for i in range(u.size):
        x = draws.position(u[i], single(table.shape[1] - 1))
        out[i, 0] = _looked_up(table, 0, x)
        out[i, 1] = rng.from_table(exact, 0, float(u[i]))


TABLES = {
    "sizes": (
        grain_statistics.struck_inverse_sizes(3e-4, 7.5e-4, "attenuation"),
        lambda x: (x - 1 / 7.5e-4) / (1 / 3e-4 - 1 / 7.5e-4),
    ),
    "sizes 1000 : 1": (
        grain_statistics.struck_inverse_sizes(1e-5, 1e-2, "attenuation"),
        lambda x: (x - 1e2) / (1e5 - 1e2),
    ),
    "facetness": (
        grain_statistics.truncated_normal(0.2, 0.4, 0.3, 0.072),
        stats.truncnorm(-0.1 / 0.072, 0.1 / 0.072, loc=0.3, scale=0.072).cdf,
    ),
    "far limits": (
        grain_statistics.truncated_normal(0.1, 1.0, 0.55, 0.05),
        stats.truncnorm(-9.0, 9.0, loc=0.55, scale=0.05).cdf,
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_read_as_their_quantile_function(name):
    values, cdf = TABLES[name]
    table = np.ascontiguousarray(values, dtype=single)[np.newaxis]
    sample = draw(_read, COUNT, table)
    far = 10.0 ** np.arange(-4.0, -1.0, 0.5)
    judge_p(
        {
            "cells": p_of_values(sample, lambda x: np.clip(cdf(x), 0.0, 1.0), EDGES),
            "low": p_of_values(sample, lambda x: np.clip(cdf(x), 0.0, 1.0), far),
            "high": p_of_values(sample, lambda x: np.clip(cdf(x), 0.0, 1.0), 1.0 - far[::-1]),
        }
    )


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_read_as_in_double_precision(name):
    exact = np.ascontiguousarray(TABLES[name][0])[np.newaxis]
    near = np.logspace(-9.3, -0.4, 200_000)
    u = np.concatenate([near, 1.0 - near, np.linspace(0.0, 1.0, 200_001)]).astype(single)
    found = np.empty((u.size, 2))
    _read_at(exact.astype(single), exact, u, found)
    # A position is off by a few of its last digits, near the upper end 1e-4 of a cell.
    steps = np.abs(np.diff(exact[0])).max()
    error = np.abs(found[:, 0] - found[:, 1])
    assert (error <= 3e-7 * np.abs(found[:, 1]) + 4e-4 * steps).all()
    assert found.min() >= exact.min() * (1 - 1e-7) and found.max() <= exact.max() * (1 + 1e-7)


def test_every_type_reads_its_own_row_unless_there_is_only_one():
    table = np.array([[0.0, 1.0, 2.0], [10.0, 12.0, 16.0]], dtype=single)
    assert [_looked_up(table, row, 1.5) for row in (0, 1)] == [1.5, 14.0]
    assert [_looked_up(table[:1].copy(), row, 1.5) for row in (0, 1, 7)] == [1.5] * 3
