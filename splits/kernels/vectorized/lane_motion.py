"""Geometry and motion of the rays of lanes between grains."""

from __future__ import annotations

from splits.kernels.compiler.jit import ONE, ZERO, inline_only
from splits.kernels.grains.free_path import LayerGeometry
from splits.kernels.grains.ray import Ray
from splits.kernels.grains.spheroid import Segment
from splits.kernels.math.vectors import Vector, select
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.lane_state import load_vector, store_vector


@inline_only
def load_ray(state, i, layered):
    """Return the `Ray` of a lane, with None for the fields that a flight does not need."""
    previous_segment = Segment(
        load_vector(state, lane_state.PREV_DIR_X + i),
        load_vector(state, lane_state.PREV_DIR_X + i),
        state[lane_state.PREV_LENGTH + i],
    )
    position, exit_offset = (
        load_vector(state, lane_state.X + i),
        load_vector(state, lane_state.EXIT_OFFSET_X + i),
    )
    start_distance = state[lane_state.SKIP_DISTANCE + i]
    if layered is not None:
        start_distance = state[lane_state.START_DISTANCE + i]
    return Ray(
        None, position, exit_offset, load_vector(state, lane_state.DIR_X + i), previous_segment,
        start_distance, None, None, state[lane_state.WEIGHT + i],
        state[lane_state.OPTICAL_DEPTH + i], state[lane_state.NEXT_ROULETTE + i], None, None, None,
        None,
    )  # fmt: skip


@inline_only
def load_layer_geometry(state, i, constants, layered):
    """Return the `LayerGeometry` of a lane."""
    slab_geometry = constants.layer_geometry
    if layered is None:
        return slab_geometry
    mean_free_path, bottom, top = (
        state[lane_state.MEAN_FREE_PATH + i], state[lane_state.LAYER_BOTTOM + i],
        state[lane_state.LAYER_TOP + i]
    )  # fmt: skip
    return LayerGeometry(
        mean_free_path,
        bottom,
        top,
        slab_geometry.slab_bottom,
        slab_geometry.slab_top,
        slab_geometry.grain_ceiling,
    )


@inline_only
def has_left_layer(state, i, ray, layer_geometry):
    """Return whether a ray left a grain on the other side of a boundary between layers."""
    z = ray.position.z + ray.exit_offset.z
    above = (z > layer_geometry.top) & (layer_geometry.top < layer_geometry.slab_top)
    below = (z < layer_geometry.bottom) & (layer_geometry.bottom > layer_geometry.slab_bottom)
    starts = (state[lane_state.LAYER + i] == state[lane_state.FLIGHT_LAYER + i]) & (
        state[lane_state.ON_BOUNDARY + i] == ZERO
    )
    return starts & (above | below)


@inline_only
def move_to_grain(state, i, ray, collision, accepted, features):
    """Move the ray of a lane to the accepted grain, if there is one."""
    position, exit_offset, direction, distance = (
        ray.position,
        ray.exit_offset,
        ray.direction,
        collision.distance,
    )
    state[lane_state.X + i] = (
        position.x + exit_offset.x + distance * direction.x if accepted else position.x
    )
    state[lane_state.Y + i] = (
        position.y + exit_offset.y + distance * direction.y if accepted else position.y
    )
    state[lane_state.Z + i] = collision.height if accepted else position.z
    store_vector(
        state, lane_state.EXIT_OFFSET_X + i, select(accepted, Vector(ZERO, ZERO, ZERO), exit_offset)
    )
    store_vector(
        state,
        lane_state.PREV_DIR_X + i,
        select(accepted, direction, ray.previous_segment.direction),
    )
    state[lane_state.PREV_LENGTH + i] = distance if accepted else ray.previous_segment.length
    # In layered scenes the segment is attenuated between the passes.
    if features.layered is None:
        attenuate(state, i, distance if accepted else ZERO, features)


@inline_only
def attenuate(state, i, distance, features):
    """Attenuate the ray of a lane along a distance in its pore."""
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
    """Store the accepted grain of a lane, if there is one."""
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
    flattening, semi_minor = state[lane_state.FLATTENING + i], state[lane_state.SEMI_MINOR + i]
    shell, side = state[lane_state.SHELL + i], state[lane_state.SIDE + i]
    state[lane_state.FLATTENING + i] = grain.flattening if accepted else flattening
    state[lane_state.SEMI_MINOR + i] = grain.semi_minor if accepted else semi_minor
    state[lane_state.SHELL + i] = ZERO if accepted else shell
    state[lane_state.SIDE + i] = ONE if accepted else side
    if features.faceted is not None:
        old, new = state[lane_state.ROUGHNESS + i], state[lane_state.NEW_ROUGHNESS + i]
        state[lane_state.ROUGHNESS + i] = new if accepted else old
    if features.mixed is not None:
        old, new = state[lane_state.TYPE + i], state[lane_state.NEW_TYPE + i]
        state[lane_state.TYPE + i] = new if accepted else old
