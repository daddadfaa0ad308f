"""Roulette, the next grain and the way to it, for every lane between grains.

See `splits.kernels.grains.free_path` for the physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, ZERO, entry_point_no_refcount, inline_only
from splits.kernels.grains.free_path import (
    LayerGeometry,
    RayGeometry,
    RouletteState,
    russian_roulette,
    sample_collision,
)
from splits.kernels.grains.scene import MAX_REJECTIONS
from splits.kernels.grains.spheroid import (
    EntryVariates,
    GrainSize,
    Segment,
    accept_axial_position,
)
from splits.kernels.math.elementary import sample_circle
from splits.kernels.math.vectors import Vector, select
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import interleave_loops, prefer_512_bit_vectors
from splits.kernels.vectorized.lane_rng import (
    compute_random_bits,
    to_three_uniforms,
    to_uniform_46,
)
from splits.kernels.vectorized.lane_state import load_vector, store_vector

_MAX_REJECTIONS = single(MAX_REJECTIONS)
_N_VARIATES = np.uint32(5)


class FlightVariates(NamedTuple):
    """Uniform random numbers of a flight."""

    roulette: float
    distance: float
    entry: EntryVariates


class PassCounts(NamedTuple):
    """Lanes that wait for a grain, and for the loop that ends and launches rays."""

    n_in_flight: int
    n_finished: int


@inline_only
def draw_flight_variates(words, i, active):
    """Draw a lane's random numbers of a flight; lanes that wait keep their place in the stream."""
    roulette_, facing, azimuth = to_three_uniforms(compute_random_bits(words, i, 0))
    turn, axial, area = to_three_uniforms(compute_random_bits(words, i, 1))
    leg = to_uniform_46(compute_random_bits(words, i, 2))
    count = words[lane_state.N_DRAWN + i]
    words[lane_state.N_DRAWN + i] = np.uint32(count + _N_VARIATES) if active else count
    legs = words[lane_state.N_SEGMENTS + i]
    words[lane_state.N_SEGMENTS + i] = np.uint32(legs + np.uint32(1)) if active else legs
    return FlightVariates(
        roulette_,
        leg,
        EntryVariates(facing, sample_circle(azimuth), sample_circle(turn), axial, area),
    )


@inline_only
def load_ray(state, i, layered):
    """Return a lane's ray between grains."""
    last = Segment(
        load_vector(state, lane_state.PREV_DIR_X + i),
        load_vector(state, lane_state.PREV_DIR_X + i),
        state[lane_state.PREV_LENGTH + i],
    )
    place, way = (
        load_vector(state, lane_state.X + i),
        load_vector(state, lane_state.EXIT_OFFSET_X + i),
    )
    skipped = state[lane_state.SKIP_DISTANCE + i]
    if layered is not None:
        skipped = state[lane_state.START_DISTANCE + i]
    return RayGeometry(place, way, load_vector(state, lane_state.DIR_X + i), last, skipped)


@inline_only
def load_layer_geometry(state, i, constants, layered):
    """Return the space that a lane's ray is in."""
    space = constants.layer_geometry
    if layered is None:
        return space
    mean_leg, low, high = (
        state[lane_state.MEAN_FREE_PATH + i], state[lane_state.LAYER_BOTTOM + i], state[lane_state.LAYER_TOP + i]
    )  # fmt: skip
    return LayerGeometry(
        mean_leg, low, high, space.slab_bottom, space.slab_top, space.grain_ceiling
    )


@inline_only
def has_left_layer(state, i, geometry, layer_geometry):
    """Tell whether a lane's ray left a grain on the other side of a face between layers."""
    z = geometry.position.z + geometry.exit_offset.z
    above = (z > layer_geometry.top) & (layer_geometry.top < layer_geometry.slab_top)
    below = (z < layer_geometry.bottom) & (layer_geometry.bottom > layer_geometry.slab_bottom)
    setting_out = (state[lane_state.LAYER + i] == state[lane_state.FLIGHT_LAYER + i]) & (
        state[lane_state.ON_BOUNDARY + i] == ZERO
    )
    return setting_out & (above | below)


@inline_only
def update_restart(state, i, geometry, collision, rejected):
    """Note from where a lane's next grain is drawn; tell whether that is in another layer."""
    left_out = rejected & (collision.start_distance == collision.distance)
    ahead, skip, start = (
        state[lane_state.START_DISTANCE + i],
        state[lane_state.SKIP_DISTANCE + i],
        state[lane_state.DRAW_LAYER + i],
    )
    layer = state[lane_state.LAYER + i]
    back = rejected & (not left_out) & (layer != start)
    again = rejected & (not left_out) & (layer == start)
    state[lane_state.SKIP_DISTANCE + i] = collision.distance if left_out else skip
    state[lane_state.DRAW_LAYER + i] = layer if left_out else start
    ahead = skip if again else ahead
    state[lane_state.START_DISTANCE + i] = collision.distance if left_out else ahead
    return back


@inline_only
def run_flight_step(state, words, i, features, constants):
    """Give a lane its next grain or another fate, and return what it then waits for."""
    status = state[lane_state.STATUS + i]
    active = status == lane_state.IN_FLIGHT
    numbers = draw_flight_variates(words, i, active)
    purse = RouletteState(
        state[lane_state.OPTICAL_DEPTH + i],
        state[lane_state.NEXT_ROULETTE + i],
        state[lane_state.WEIGHT + i],
    )
    played = russian_roulette(purse, numbers.roulette, active)
    state[lane_state.NEXT_ROULETTE + i], state[lane_state.WEIGHT + i] = (
        played.roulette.next_roulette,
        played.roulette.weight,
    )
    ray = load_ray(state, i, features.layered)
    space = load_layer_geometry(state, i, constants, features.layered)
    # The trial of the axial position comes before all else that a draw can lead to, so that its
    # failures leave no trace in distances, shapes and types.
    size = GrainSize(
        ONE / state[lane_state.NEW_CURVATURE + i], state[lane_state.NEW_FLATTENING + i]
    )
    met = sample_collision(
        ray, size, numbers.entry, numbers.distance, space, constants.rejection_rules
    )
    sound = accept_axial_position(numbers.entry, size.flattening)
    going = active & sound & (not played.terminated)
    strays = False
    if features.layered is not None:
        strays = active & (not played.terminated) & has_left_layer(state, i, ray, space)
        going = going & (not strays)
    fits = going & met.accepted
    after = lane_state.AT_SURFACE if fits else lane_state.IN_FLIGHT
    after = lane_state.AT_BOUNDARY if going & met.leaves_layer else after
    if features.layered is not None:
        refused = going & (not met.accepted) & (not met.leaves_layer)
        after = lane_state.RESTART if update_restart(state, i, ray, met, refused) else after
        after = lane_state.RELOCATE if strays else after
        landed = state[lane_state.SEGMENT_ATTENUATED + i]
        state[lane_state.SEGMENT_ATTENUATED + i] = ZERO if fits else landed
    else:
        state[lane_state.SKIP_DISTANCE + i] = met.start_distance if going else ray.start_distance
    state[lane_state.KEEP_SHAPE + i] = ONE if active & (not sound) else ZERO
    tries = state[lane_state.N_REJECTED + i]
    tries = tries + ONE if active & (not fits) else ZERO
    state[lane_state.N_REJECTED + i] = tries
    move_to_grain(state, i, ray, met, fits, features)
    store_grain(state, i, met.entry.grain, fits, features)
    after = lane_state.LOST if tries > _MAX_REJECTIONS else after
    after = lane_state.ABSORBED if played.terminated else after
    order = words[lane_state.ORDER + i]
    over = fits & (order >= words[lane_state.MAX_ORDER + i])
    words[lane_state.ORDER + i] = np.uint32(order + np.uint32(1)) if fits else order
    after = lane_state.ABSORBED if over else after
    after = after if active else status
    state[lane_state.STATUS + i] = after
    return after


@inline_only
def move_to_grain(state, i, geometry, collision, accepted, features):
    """Bring a lane's ray to the grain that it meets, if there is one."""
    place, way, d, leg = (
        geometry.position,
        geometry.exit_offset,
        geometry.direction,
        collision.distance,
    )
    state[lane_state.X + i] = place.x + way.x + leg * d.x if accepted else place.x
    state[lane_state.Y + i] = place.y + way.y + leg * d.y if accepted else place.y
    state[lane_state.Z + i] = collision.height if accepted else place.z
    store_vector(
        state, lane_state.EXIT_OFFSET_X + i, select(accepted, Vector(ZERO, ZERO, ZERO), way)
    )
    store_vector(
        state, lane_state.PREV_DIR_X + i, select(accepted, d, geometry.previous_segment.direction)
    )
    state[lane_state.PREV_LENGTH + i] = leg if accepted else geometry.previous_segment.length
    # Legs through several layers are booked between the passes.
    if features.layered is None:
        attenuate(state, i, leg if accepted else ZERO, features)


@inline_only
def attenuate(state, i, distance, features):
    """Take a lane's leg through its pore."""
    wet = state[lane_state.PORE_WET + i]
    if features.wet is not None:
        path = distance * wet
        state[lane_state.WET_PATH + i] += path
        state[lane_state.OPTICAL_DEPTH + i] += path * state[lane_state.ABSORPTION_WET + i]
    path = distance * (ONE - wet)
    state[lane_state.DRY_PATH + i] += path
    state[lane_state.OPTICAL_DEPTH + i] += path * state[lane_state.ABSORPTION_DRY + i]


@inline_only
def store_grain(state, i, grain, accepted, features):
    """Give a lane the grain that its ray meets, if it does."""
    store_vector(
        state,
        lane_state.UNIT_POINT_X + i,
        select(accepted, grain.q, load_vector(state, lane_state.UNIT_POINT_X + i)),
    )
    store_vector(
        state,
        lane_state.AXIS_X + i,
        select(accepted, grain.w, load_vector(state, lane_state.AXIS_X + i)),
    )
    flattening, minor = state[lane_state.FLATTENING + i], state[lane_state.SEMI_MINOR + i]
    layer, side = state[lane_state.SHELL + i], state[lane_state.SIDE + i]
    state[lane_state.FLATTENING + i] = grain.flattening if accepted else flattening
    state[lane_state.SEMI_MINOR + i] = grain.semi_minor if accepted else minor
    state[lane_state.SHELL + i] = ZERO if accepted else layer
    state[lane_state.SIDE + i] = ONE if accepted else side
    if features.faceted is not None:
        old, new = state[lane_state.ROUGHNESS + i], state[lane_state.NEW_ROUGHNESS + i]
        state[lane_state.ROUGHNESS + i] = new if accepted else old
    if features.mixed is not None:
        old, new = state[lane_state.TYPE + i], state[lane_state.NEW_TYPE + i]
        state[lane_state.TYPE + i] = new if accepted else old


@inline_only
def run_flight_stride(state, words, first_lane, features, constants):
    """Do what `run_flight_pass` does for `STRIDE` lanes from `first_lane` on."""
    flying = np.int32(0)
    ended = np.int32(0)
    prefer_512_bit_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first_lane &= lane_state.N_LANES - 1
    for j in range(lane_state.STRIDE):
        after = run_flight_step(state, words, first_lane + j, features, constants)
        flying = np.int32(flying + 1) if after == lane_state.IN_FLIGHT else flying
        ended = np.int32(ended + 1) if after >= lane_state.AT_BOUNDARY else ended
    interleave_loops()
    return PassCounts(flying, ended)


@entry_point_no_refcount
def run_flight_pass(state, words, width, features, constants):
    """Give all lanes between grains their next grain, or another fate.

    Parameters
    ----------
    state : float32[STATE]
    words : uint32[WORDS]
    width : int
        Lanes in use, from the first on: a multiple of `rows.STRIDE`.
    features, constants : Features, LayerScene
        See `splits.kernels.vectorized.lane_state`.

    Returns
    -------
    Waiting
    """
    prefer_512_bit_vectors()
    flying = np.int32(0)
    ended = np.int32(0)
    for first in range(0, width, lane_state.STRIDE):
        more = run_flight_stride(state, words, first, features, constants)
        flying = np.int32(flying + more.n_in_flight)
        ended = np.int32(ended + more.n_finished)
    return PassCounts(flying, ended)
