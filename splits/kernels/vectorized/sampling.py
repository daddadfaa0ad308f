"""Sampling of type, size, shape and roughness of the next grain in every lane."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import HALF, ONE, ZERO, entry_point_no_refcount, inline_only
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import (
    gather_interpolate,
    interleave_loops,
    prefer_512_bit_vectors,
)
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_uniform_31

_SHIFT_33 = np.uint64(33)


@inline_only
def compute_quantile_position(u, last_node):
    """Return the position of the probability u in a quantile table, from 0 to `last_node`.

    See `rng.make_table_probabilities`.
    """
    below = u < HALF
    x = sqrt(HALF * (u if below else max(ONE - u, ZERO)))
    return (x if below else ONE - x) * last_node


@inline_only
def draw_variates(state, words, first_lane, features, last_node):
    """Draw the variates of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    first_lane &= lane_state.N_LANES - 1
    for j in range(lane_state.STRIDE):
        i = first_lane + j
        bits = compute_random_bits(words, i, 3)
        state[lane_state.QUANTILE_INVERSE_SEMI_MAJOR + i] = compute_quantile_position(
            to_uniform_31(bits >> _SHIFT_33), last_node
        )
        state[lane_state.QUANTILE_FLATTENING + i] = compute_quantile_position(
            to_uniform_31(bits), last_node
        )
        bits = compute_random_bits(words, i, 4)
        if features.faceted is not None:
            state[lane_state.QUANTILE_ROUGHNESS + i] = compute_quantile_position(
                to_uniform_31(bits >> _SHIFT_33), last_node
            )
        if features.mixed is not None:
            state[lane_state.U_TYPE + i] = to_uniform_31(bits)
            first_type = ZERO
            if features.layered is not None:
                first_type = state[lane_state.FIRST_TYPE + i]
            state[lane_state.CHOSEN_TYPE + i] = first_type
    interleave_loops()


@inline_only
def pick_types(state, first_lane, type_cdf, features):
    """Select the type of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    first_lane &= lane_state.N_LANES - 1
    for layer in range(type_cdf.shape[0]):
        layer_number = single(layer)
        for row in range(type_cdf.shape[1] - 1):
            probability = single(type_cdf[layer, row])
            for j in range(lane_state.STRIDE):
                i = first_lane + j
                step = ONE if state[lane_state.U_TYPE + i] >= probability else ZERO
                if features.layered is not None:
                    step = step if state[lane_state.LAYER + i] == layer_number else ZERO
                state[lane_state.CHOSEN_TYPE + i] += step
    for j in range(lane_state.STRIDE):
        i = first_lane + j
        kept_type, chosen_type = state[lane_state.NEW_TYPE + i], state[lane_state.CHOSEN_TYPE + i]
        state[lane_state.NEW_TYPE + i] = (
            kept_type if state[lane_state.KEEP_SHAPE + i] > ZERO else chosen_type
        )


@entry_point_no_refcount
def draw_grain_properties(state, words, width, features, tables, type_cdf):
    """Draw type, size, shape and roughness of the next grain in every lane.

    After a rejected axial position type and shape are kept, because its probability depends on the
    shape.

    Parameters
    ----------
    state, words, width, features
        See `flight.run_flight_pass`.
    tables : tuple of 3 float32[rows, m]
        Curvature, flattening and half facetness at the probabilities of
        `rng.make_table_probabilities`.
    type_cdf : float64[layers, types]
        See `splits.kernels.grains.scene.Layers`.
    """
    prefer_512_bit_vectors()
    curvature, flattening, roughness = tables
    last_node = single(curvature.shape[1] - 1)
    for first_lane in range(0, width, lane_state.STRIDE):
        draw_variates(state, words, first_lane, features, last_node)
        if features.mixed is not None:
            pick_types(state, first_lane, type_cdf, features)
    for i in range(0, width, lane_state.VECTOR_WIDTH):
        gather_interpolate(
            curvature,
            state,
            lane_state.NEW_TYPE + i,
            lane_state.QUANTILE_INVERSE_SEMI_MAJOR + i,
            lane_state.NEW_INVERSE_SEMI_MAJOR + i,
        )
        gather_interpolate(
            flattening,
            state,
            lane_state.NEW_TYPE + i,
            lane_state.QUANTILE_FLATTENING + i,
            lane_state.QUANTILE_FLATTENING + i,
        )
        if features.faceted is not None:
            gather_interpolate(
                roughness,
                state,
                lane_state.NEW_TYPE + i,
                lane_state.QUANTILE_ROUGHNESS + i,
                lane_state.NEW_ROUGHNESS + i,
            )
    for i in range(width):
        old, drawn = state[lane_state.NEW_FLATTENING + i], state[lane_state.QUANTILE_FLATTENING + i]
        state[lane_state.NEW_FLATTENING + i] = (
            old if state[lane_state.KEEP_SHAPE + i] > ZERO else drawn
        )
