"""Flight pass: roulette and sampling of the next grain, for every lane between grains.

See `splits.kernels.grains.free_path` for the physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, ZERO, entry_point_no_refcount, inline_only
from splits.kernels.grains.free_path import russian_roulette, sample_collision
from splits.kernels.grains.scene import MAX_REJECTIONS
from splits.kernels.grains.spheroid import EntryVariates, GrainSize, accept_axial_position
from splits.kernels.math.elementary import sample_circle
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import interleave_loops, prefer_512_bit_vectors
from splits.kernels.vectorized.lane_motion import (
    has_left_layer,
    load_layer_geometry,
    load_ray,
    move_to_grain,
    store_grain,
)
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_three_uniforms, to_uniform_46

_MAX_REJECTIONS = single(MAX_REJECTIONS)
_N_VARIATES = np.uint32(5)


class FlightVariates(NamedTuple):
    """Uniform random numbers of a flight."""

    roulette: float
    distance: float
    entry: EntryVariates


class PassCounts(NamedTuple):
    """Number of lanes in flight, and of lanes that wait for `batch.handle_waiting_lanes`."""

    n_in_flight: int
    n_finished: int


@inline_only
def draw_flight_variates(words, i, active):
    """Draw the random numbers of a flight; only active lanes advance in their streams."""
    roulette, cos_incidence, normal_azimuth = to_three_uniforms(compute_random_bits(words, i, 0))
    axis_azimuth, axial, accept = to_three_uniforms(compute_random_bits(words, i, 1))
    distance = to_uniform_46(compute_random_bits(words, i, 2))
    n_drawn = words[lane_state.N_DRAWN + i]
    words[lane_state.N_DRAWN + i] = np.uint32(n_drawn + _N_VARIATES) if active else n_drawn
    n_segments = words[lane_state.N_SEGMENTS + i]
    words[lane_state.N_SEGMENTS + i] = (
        np.uint32(n_segments + np.uint32(1)) if active else n_segments
    )
    return FlightVariates(
        roulette,
        distance,
        EntryVariates(
            cos_incidence, sample_circle(normal_azimuth), sample_circle(axis_azimuth), axial, accept
        ),
    )


@inline_only
def update_restart(state, i, collision, rejected):
    """Set the start of the next sampling attempt; return whether it is in another layer."""
    skipped = rejected & (collision.start_distance == collision.distance)
    start_distance, skip_distance, draw_layer = (
        state[lane_state.START_DISTANCE + i],
        state[lane_state.SKIP_DISTANCE + i],
        state[lane_state.DRAW_LAYER + i],
    )
    layer = state[lane_state.LAYER + i]
    restarts = rejected & (not skipped) & (layer != draw_layer)
    repeats = rejected & (not skipped) & (layer == draw_layer)
    state[lane_state.SKIP_DISTANCE + i] = collision.distance if skipped else skip_distance
    state[lane_state.DRAW_LAYER + i] = layer if skipped else draw_layer
    start_distance = skip_distance if repeats else start_distance
    state[lane_state.START_DISTANCE + i] = collision.distance if skipped else start_distance
    return restarts


@inline_only
def run_flight_step(state, words, i, features, constants):
    """Sample the next grain of a lane, and return its new status."""
    status = state[lane_state.STATUS + i]
    active = status == lane_state.IN_FLIGHT
    variates = draw_flight_variates(words, i, active)
    ray = load_ray(state, i, features.layered)
    result = russian_roulette(ray, variates.roulette, active)
    state[lane_state.NEXT_ROULETTE + i] = result.next_roulette
    state[lane_state.WEIGHT + i] = result.weight
    layer_geometry = load_layer_geometry(state, i, constants, features.layered)
    # A rejected axial position has precedence over all other results of a sample, so that it does
    # not bias distances, shapes and types.
    size = GrainSize(
        ONE / state[lane_state.NEW_INVERSE_SEMI_MAJOR + i], state[lane_state.NEW_FLATTENING + i]
    )
    collision = sample_collision(
        ray, size, variates.entry, variates.distance, layer_geometry, constants.rejection_rules
    )
    axial_ok = accept_axial_position(variates.entry, size.flattening)
    in_flight = active & axial_ok & (not result.terminated)
    relocates = False
    if features.layered is not None:
        relocates = active & (not result.terminated) & has_left_layer(state, i, ray, layer_geometry)
        in_flight = in_flight & (not relocates)
    accepted = in_flight & collision.accepted
    next_status = lane_state.AT_SURFACE if accepted else lane_state.IN_FLIGHT
    next_status = lane_state.AT_BOUNDARY if in_flight & collision.leaves_layer else next_status
    if features.layered is not None:
        rejected = in_flight & (not collision.accepted) & (not collision.leaves_layer)
        next_status = (
            lane_state.RESTART if update_restart(state, i, collision, rejected) else next_status
        )
        next_status = lane_state.RELOCATE if relocates else next_status
        attenuated = state[lane_state.SEGMENT_ATTENUATED + i]
        state[lane_state.SEGMENT_ATTENUATED + i] = ZERO if accepted else attenuated
    else:
        state[lane_state.SKIP_DISTANCE + i] = (
            collision.start_distance if in_flight else ray.start_distance
        )
    state[lane_state.KEEP_SHAPE + i] = ONE if active & (not axial_ok) else ZERO
    n_rejected = state[lane_state.N_REJECTED + i]
    n_rejected = n_rejected + ONE if active & (not accepted) else ZERO
    state[lane_state.N_REJECTED + i] = n_rejected
    move_to_grain(state, i, ray, collision, accepted, features)
    store_grain(state, i, collision.entry.grain, accepted, features)
    next_status = lane_state.LOST if n_rejected > _MAX_REJECTIONS else next_status
    next_status = lane_state.ABSORBED if result.terminated else next_status
    order = words[lane_state.ORDER + i]
    terminated = accepted & (order >= words[lane_state.MAX_ORDER + i])
    words[lane_state.ORDER + i] = np.uint32(order + np.uint32(1)) if accepted else order
    next_status = lane_state.ABSORBED if terminated else next_status
    next_status = next_status if active else status
    state[lane_state.STATUS + i] = next_status
    return next_status


@inline_only
def run_flight_stride(state, words, first_lane, features, constants):
    """Run the flight pass for `STRIDE` lanes from `first_lane` on."""
    n_in_flight = np.int32(0)
    n_finished = np.int32(0)
    prefer_512_bit_vectors()
    # The mask shows that the index is not negative and needs no wraparound test.
    first_lane &= lane_state.N_LANES - 1
    for j in range(lane_state.STRIDE):
        status = run_flight_step(state, words, first_lane + j, features, constants)
        n_in_flight = np.int32(n_in_flight + 1) if status == lane_state.IN_FLIGHT else n_in_flight
        n_finished = np.int32(n_finished + 1) if status >= lane_state.AT_BOUNDARY else n_finished
    interleave_loops()
    return PassCounts(n_in_flight, n_finished)


@entry_point_no_refcount
def run_flight_pass(state, words, width, features, constants):
    """Sample the next grain for all lanes between grains.

    Parameters
    ----------
    state : float32[STATE_SIZE]
    words : uint32[WORDS_SIZE]
    width : int
        Lanes in use, from the first on: a multiple of `lane_state.STRIDE`.
    features, constants : Features, PassConstants
        See `splits.kernels.vectorized.lane_state`.

    Returns
    -------
    PassCounts
    """
    prefer_512_bit_vectors()
    n_in_flight = np.int32(0)
    n_finished = np.int32(0)
    for first_lane in range(0, width, lane_state.STRIDE):
        counts = run_flight_stride(state, words, first_lane, features, constants)
        n_in_flight = np.int32(n_in_flight + counts.n_in_flight)
        n_finished = np.int32(n_finished + counts.n_finished)
    return PassCounts(n_in_flight, n_finished)
