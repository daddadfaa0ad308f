"""Flight pass: roulette and sampling of the next grain, for every lane between grains.

See `splits.kernels.grains.free_path` for the physics.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, ZERO, entry_point_no_refcount, inline_only
from splits.kernels.grains.free_path import MAX_REJECTIONS, russian_roulette, sample_collision
from splits.kernels.grains.spheroid import EntryVariates, GrainSize, accept_axial_position
from splits.kernels.grains.state import make_rejection_rules
from splits.kernels.math.elementary import sample_circle
from splits.kernels.math.vectors import select
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import interleave_loops, prefer_512_bit_vectors
from splits.kernels.vectorized.lane_motion import (
    has_left_layer,
    load_ray,
    move_to_grain,
    store_grain,
)
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_three_uniforms, to_uniform_46
from splits.kernels.vectorized.lane_state import STRIDE, Lane

_MAX_REJECTIONS = single(MAX_REJECTIONS)
_N_VARIATES = np.uint32(5)


@inline_only
def draw_flight_variates(lane, active):
    """Draw the random numbers of a flight; only active lanes advance in their streams."""
    roulette, cos_incidence, normal_azimuth = to_three_uniforms(compute_random_bits(lane, 0))
    axis_azimuth, axial, accept = to_three_uniforms(compute_random_bits(lane, 1))
    distance = to_uniform_46(compute_random_bits(lane, 2))
    lane.n_drawn = select(active, np.uint32(lane.n_drawn + _N_VARIATES), lane.n_drawn)
    lane.n_segments += active
    azimuths = sample_circle(normal_azimuth), sample_circle(axis_azimuth)
    return roulette, distance, EntryVariates(cos_incidence, *azimuths, axial, accept)


@inline_only
def update_restart(lane, collision, rejected):
    """Set the start of the next sampling attempt; return whether it is in another layer."""
    skipped = rejected & (collision.start_distance == collision.distance)
    other_layer = lane.layer != lane.draw_layer
    repeats = rejected & (not skipped) & (not other_layer)
    start_distance = select(repeats, lane.skip_distance, lane.start_distance)
    lane.skip_distance = select(skipped, collision.distance, lane.skip_distance)
    lane.draw_layer = select(skipped, lane.layer, lane.draw_layer)
    lane.start_distance = select(skipped, collision.distance, start_distance)
    return rejected & (not skipped) & other_layer


@inline_only
def run_flight_step(lane, features, rejection_rules):
    """Sample the next grain of a lane."""
    status = lane.status
    active = status == lane_state.IN_FLIGHT
    u_roulette, u_distance, variates = draw_flight_variates(lane, active)
    ray = load_ray(lane)
    result = russian_roulette(ray, u_roulette, active)
    lane.next_roulette, lane.weight = result.next_roulette, result.weight
    layer_geometry = lane.layer_geometry
    # A rejected axial position has precedence over all other results of a sample, so that it does
    # not bias distances, shapes and types.
    size = GrainSize(ONE / lane.new_inverse_semi_major, lane.new_flattening)
    collision = sample_collision(ray, size, variates, u_distance, layer_geometry, rejection_rules)
    axial_ok = accept_axial_position(variates, size.flattening)
    in_flight = active & axial_ok & (not result.terminated)
    relocates = False
    if features.layered is not None:
        relocates = active & (not result.terminated) & has_left_layer(lane, ray, layer_geometry)
        in_flight = in_flight & (not relocates)
    accepted = in_flight & collision.accepted
    next_status = lane_state.AT_SURFACE if accepted else lane_state.IN_FLIGHT
    next_status = lane_state.AT_BOUNDARY if in_flight & collision.leaves_layer else next_status
    if features.layered is not None:
        rejected = in_flight & (not collision.accepted) & (not collision.leaves_layer)
        restarts = update_restart(lane, collision, rejected)
        next_status = lane_state.RESTART if restarts else next_status
        next_status = lane_state.RELOCATE if relocates else next_status
        lane.segment_attenuated = lane.segment_attenuated & (not accepted)
    else:
        lane.start_distance = select(in_flight, collision.start_distance, ray.start_distance)
    lane.keep_shape = active & (not axial_ok)
    lane.n_rejected = select(active & (not accepted), lane.n_rejected + ONE, ZERO)
    move_to_grain(lane, ray, collision, accepted, features)
    store_grain(lane, collision.entry.grain, accepted, features)
    next_status = lane_state.LANE_LOST if lane.n_rejected > _MAX_REJECTIONS else next_status
    absorbed = result.terminated | (accepted & (lane.order >= lane.max_order))
    lane.order += accepted
    next_status = lane_state.LANE_ABSORBED if absorbed else next_status
    lane.status = next_status if active else status


@inline_only
def run_flight_stride(state, first_lane, features, rules):
    """Run the flight pass for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    rejection_rules = make_rejection_rules(rules)
    for j in range(STRIDE):
        run_flight_step(Lane(state, first_lane + j), features, rejection_rules)
    interleave_loops()


@entry_point_no_refcount
def run_flight_pass(state, width, features, rules):
    """Sample the next grain for all lanes between grains.

    Parameters
    ----------
    state : uint32[STATE_SIZE]
        Array of `lane_state.Lane`.
    width : int
        Lanes in use, from the first on: a multiple of `STRIDE`.
    features, rules : Features, SamplingRules
        See `splits.kernels.compiler.features` and `splits.kernels.base.scene`.
    """
    prefer_512_bit_vectors()
    for first_lane in range(0, width, STRIDE):
        run_flight_stride(state, first_lane, features, rules)
