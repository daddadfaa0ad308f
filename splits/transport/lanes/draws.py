"""What decides the next grain of every lane: its type, size, shape and roughness."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.jit import HALF, ONE, ZERO, borrower, part
from splits.transport.lanes import rows
from splits.transport.lanes.numbers import below_one, word
from splits.transport.lanes.vectors import look_up, two_at_a_time, widest_vectors
from splits.transport.numerics.arithmetic import root

_33 = np.uint64(33)


@part
def position(u, last_node):
    """Return where the probability u lies in a table of `rng.table_probabilities`, 0 to `last`."""
    below = u < HALF
    x = root(HALF * (u if below else max(ONE - u, ZERO)))
    return (x if below else ONE - x) * last_node


@part
def draws(state, words, first_lane, features, last_node):
    """Draw the numbers that decide the next grain of `STRIDE` lanes from `first` on."""
    widest_vectors()
    first_lane &= rows.LANES - 1
    for j in range(rows.STRIDE):
        i = first_lane + j
        bits = word(words, i, 3)
        state[rows.AT_CURVATURE + i] = position(below_one(bits >> _33), last_node)
        state[rows.AT_FLATTENING + i] = position(below_one(bits), last_node)
        bits = word(words, i, 4)
        if features.faceted is not None:
            state[rows.AT_SIGMA + i] = position(below_one(bits >> _33), last_node)
        if features.mixed is not None:
            state[rows.AT_KIND + i] = below_one(bits)
            picked = ZERO
            if features.layered is not None:
                picked = state[rows.FIRST_KIND + i]
            state[rows.PICKED + i] = picked
    two_at_a_time()


@part
def picks(state, first_lane, type_cdf, features):
    """Choose the type of the next grain of `STRIDE` lanes from `first` on."""
    widest_vectors()
    first_lane &= rows.LANES - 1
    for layer in range(type_cdf.shape[0]):
        here = single(layer)
        for row in range(type_cdf.shape[1] - 1):
            bound = single(type_cdf[layer, row])
            for j in range(rows.STRIDE):
                i = first_lane + j
                more = ONE if state[rows.AT_KIND + i] >= bound else ZERO
                if features.layered is not None:
                    more = more if state[rows.LAYER + i] == here else ZERO
                state[rows.PICKED + i] += more
    for j in range(rows.STRIDE):
        i = first_lane + j
        kind, picked = state[rows.NEW_KIND + i], state[rows.PICKED + i]
        state[rows.NEW_KIND + i] = kind if state[rows.KEEP + i] > ZERO else picked


@borrower
def draw_types(state, words, width, features, tables, type_cdf):
    """Draw type, size, shape and roughness of the next grain in every lane.

    A trial refused for its axial position keeps type and shape, which made that likely.

    Parameters
    ----------
    state, words, width, features
        See `flight`.
    tables : tuple of 3 float32[rows, m]
        Curvature, flattening and half facetness at the probabilities of
        `rng.table_probabilities`.
    share : float64[layers, most]
        See `splits.transport.grains.scene.Layers`.
    """
    widest_vectors()
    curvature, flattening, sigma = tables
    last = single(curvature.shape[1] - 1)
    for first in range(0, width, rows.STRIDE):
        draws(state, words, first, features, last)
        if features.mixed is not None:
            picks(state, first, type_cdf, features)
    for i in range(0, width, rows.VECTOR):
        look_up(curvature, state, rows.NEW_KIND + i, rows.AT_CURVATURE + i, rows.NEW_CURVATURE + i)
        look_up(
            flattening, state, rows.NEW_KIND + i, rows.AT_FLATTENING + i, rows.AT_FLATTENING + i
        )
        if features.faceted is not None:
            look_up(sigma, state, rows.NEW_KIND + i, rows.AT_SIGMA + i, rows.NEW_SIGMA + i)
    for i in range(width):
        old, drawn = state[rows.NEW_FLATTENING + i], state[rows.AT_FLATTENING + i]
        state[rows.NEW_FLATTENING + i] = old if state[rows.KEEP + i] > ZERO else drawn
