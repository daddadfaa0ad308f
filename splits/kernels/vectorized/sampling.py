"""Sampling of type, size, shape and roughness of the next grain in every lane."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import HALF, ONE, ZERO, entry_point_no_refcount, inline_only
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.math.vectors import select
from splits.kernels.vectorized.intrinsics import (
    gather_interpolate,
    interleave_loops,
    prefer_512_bit_vectors,
)
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_uniform_31
from splits.kernels.vectorized.lane_state import STRIDE, VECTOR_WIDTH, Lane

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
def draw_variates(state, first_lane, features, last_node):
    """Draw the variates of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    for j in range(STRIDE):
        lane = Lane(state, first_lane + j)
        bits = compute_random_bits(lane, 3)
        u_size, u_shape = to_uniform_31(bits >> _SHIFT_33), to_uniform_31(bits)
        lane.quantile_inverse_semi_major = compute_quantile_position(u_size, last_node)
        lane.quantile_flattening = compute_quantile_position(u_shape, last_node)
        bits = compute_random_bits(lane, 4)
        if features.faceted is not None:
            u_roughness = to_uniform_31(bits >> _SHIFT_33)
            lane.quantile_roughness = compute_quantile_position(u_roughness, last_node)
        if features.mixed is not None:
            lane.u_type = to_uniform_31(bits)
            lane.chosen_type = 0 if features.layered is None else lane.first_type
    interleave_loops()


@inline_only
def pick_types(state, first_lane, type_cdf, features):
    """Select the type of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    for layer in range(type_cdf.shape[0]):
        layer_number = np.int32(layer)
        for row in range(type_cdf.shape[1] - 1):
            probability = single(type_cdf[layer, row])
            for j in range(STRIDE):
                lane = Lane(state, first_lane + j)
                later = lane.u_type >= probability
                if features.layered is not None:
                    later = later & (lane.layer == layer_number)
                lane.chosen_type += later
    for j in range(STRIDE):
        lane = Lane(state, first_lane + j)
        lane.new_type = select(lane.keep_shape, lane.new_type, lane.chosen_type)


@entry_point_no_refcount
def draw_grain_properties(state, width, features, tables, type_cdf):
    """Draw type, size, shape and roughness of the next grain in every lane.

    After a rejected axial position type and shape are kept, because its probability depends on the
    shape.

    Parameters
    ----------
    state, width, features
        See `flight.run_flight_pass`.
    tables : tuple of 3 float32[rows, m]
        Curvature, flattening and half facetness at the probabilities of
        `rng.make_table_probabilities`.
    type_cdf : float64[layers, types]
        See `splits.kernels.base.scene.Layers`.
    """
    prefer_512_bit_vectors()
    curvature, flattening, roughness = tables
    last_node = single(curvature.shape[1] - 1)
    for first_lane in range(0, width, STRIDE):
        draw_variates(state, first_lane, features, last_node)
        if features.mixed is not None:
            pick_types(state, first_lane, type_cdf, features)
    for i in range(0, width, VECTOR_WIDTH):
        lane = Lane(state, i)
        gather_interpolate(
            curvature, lane, "new_type", "quantile_inverse_semi_major", "new_inverse_semi_major"
        )
        gather_interpolate(
            flattening, lane, "new_type", "quantile_flattening", "quantile_flattening"
        )
        if features.faceted is not None:
            gather_interpolate(roughness, lane, "new_type", "quantile_roughness", "new_roughness")
    for i in range(width):
        lane = Lane(state, i)
        lane.new_flattening = select(lane.keep_shape, lane.new_flattening, lane.quantile_flattening)
