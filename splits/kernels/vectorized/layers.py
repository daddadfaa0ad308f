"""Layer boundaries and segments through several layers for the rays of lanes, between the passes.

See `splits.kernels.transport.flight` and `splits.kernels.transport.events` for the physics.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, ZERO, inline_only
from splits.kernels.grains.free_path import compute_boundary_hit
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.tallies.crossings import append_crossing, encode_crossing, set_current_ray
from splits.kernels.transport.flight import find_adjacent_layer
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.lane_motion import load_layer_geometry, load_ray
from splits.kernels.vectorized.lane_optics import refractive_index_of, set_layer_optics
from splits.kernels.vectorized.lane_state import store_vector
from splits.kernels.vectorized.lifecycle import draw_uniform


@inline_only
def pore_material(lanes, lane, layers, layer):
    """Return the material of the pore of a ray in a layer."""
    wet = lanes.state[lane_state.PORE_VARIATE + lane] < single(layers.wet_fraction[layer])
    return layers.first_pore_material[layer] + (1 if wet else 0)


@inline_only
def has_same_refractive_index(lanes, lane, job, layer, other):
    """Return whether the pores of two layers have the same complex refractive index."""
    layers, item = job.scene.layers, lanes.item[lane]
    a = refractive_index_of(job.optics, item, pore_material(lanes, lane, layers, layer))
    b = refractive_index_of(job.optics, item, pore_material(lanes, lane, layers, other))
    return a.n == b.n and a.k == b.k


@inline_only
def set_layer(lanes, lane, job, layer):
    """Set the layer of a ray, with the pore that its variate selects."""
    state, layers = lanes.state, job.scene.layers
    state[lane_state.LAYER + lane] = single(layer)
    wet = lanes.state[lane_state.PORE_VARIATE + lane] < single(layers.wet_fraction[layer])
    state[lane_state.PORE_WET + lane] = ONE if wet else ZERO
    set_layer_optics(state, lane, job.scene, job.optics, lanes.item[lane])


@inline_only
def start_flight(state, lane):
    """Start a flight in the current layer of a ray."""
    layer = state[lane_state.LAYER + lane]
    state[lane_state.FLIGHT_LAYER + lane], state[lane_state.DRAW_LAYER + lane] = layer, layer
    state[lane_state.START_DISTANCE + lane], state[lane_state.SKIP_DISTANCE + lane] = ZERO, ZERO
    state[lane_state.ON_BOUNDARY + lane] = ZERO


@inline_only
def append_lane_crossing(lanes, lane, crossings, event):
    """Record a crossing of a ray, whose path lengths must have been flushed."""
    set_current_ray(crossings, lanes.ray[lane])
    append_crossing(
        crossings,
        event,
        np.float64(lanes.state[lane_state.WEIGHT + lane]),
        lanes.path_lengths[lane],
    )


@inline_only
def record_crossing(lanes, lane, job, crossings, layer, upward):
    """Record the crossing of a ray into the next layer, if the scene records crossings."""
    if job.scene.record_crossings:
        append_lane_crossing(
            lanes, lane, crossings, encode_crossing(layer if upward else layer + 1, upward)
        )


@inline_only
def attenuate_segment(lanes, lane, job, crossings):
    """Attenuate a ray along its last segment through the pores of all layers that it crossed."""
    state, item, layers = lanes.state, lanes.item[lane], job.scene.layers
    d = np.float64(state[lane_state.PREV_DIR_Z + lane])
    remaining = np.float64(state[lane_state.PREV_LENGTH + lane])
    z = np.float64(state[lane_state.Z + lane]) - remaining * d
    layer, last_layer = (
        int(state[lane_state.FLIGHT_LAYER + lane]),
        int(state[lane_state.LAYER + lane]),
    )
    depth = 0.0
    while True:
        length = remaining
        if layer != last_layer:
            boundary = layers.boundaries[layer] if d > 0.0 else layers.boundaries[layer + 1]
            length = min(max((boundary - z) / d, 0.0), remaining)
            z = boundary
        pore = pore_material(lanes, lane, layers, layer)
        lanes.path_lengths[lane, pore] += length
        depth += length * job.optics.absorption[item, pore]
        if layer == last_layer:
            break
        record_crossing(lanes, lane, job, crossings, layer, d > 0.0)
        remaining -= length
        layer += -1 if d > 0.0 else 1
    state[lane_state.OPTICAL_DEPTH + lane] += single(depth)
    state[lane_state.SEGMENT_ATTENUATED + lane] = ONE
    start_flight(state, lane)


@inline_only
def restart_flight(lanes, lane, job):
    """Restart the sampling of a grain at the start of the segment or at the last skipped grain."""
    state = lanes.state
    set_layer(lanes, lane, job, int(state[lane_state.DRAW_LAYER + lane]))
    state[lane_state.START_DISTANCE + lane] = state[lane_state.SKIP_DISTANCE + lane]
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT


@inline_only
def locate_layer(lanes, lane, job, crossings):
    """Set the layer of a ray that left a grain on the other side of a boundary.

    If the pores there have another index, the ray is placed on that boundary.
    """
    state, boundaries = lanes.state, job.scene.layers.boundaries
    z = state[lane_state.Z + lane] + state[lane_state.EXIT_OFFSET_Z + lane]
    layer = int(state[lane_state.LAYER + lane])
    state[lane_state.ON_BOUNDARY + lane] = ONE
    while z > single(boundaries[layer]) or z < single(boundaries[layer + 1]):
        step = -1 if z > single(boundaries[layer]) else 1
        next_layer = layer + step
        if next_layer < 0 or next_layer == boundaries.size - 1:
            break
        if not has_same_refractive_index(lanes, lane, job, layer, next_layer):
            boundary = boundaries[layer] if step < 0 else boundaries[layer + 1]
            state[lane_state.EXIT_OFFSET_Z + lane] = single(boundary) - state[lane_state.Z + lane]
            break
        record_crossing(lanes, lane, job, crossings, layer, step < 0)
        layer = next_layer
    set_layer(lanes, lane, job, layer)
    on_boundary = state[lane_state.ON_BOUNDARY + lane]
    start_flight(state, lane)
    state[lane_state.ON_BOUNDARY + lane] = on_boundary
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT


@inline_only
def cross_interface(lanes, lane, job, crossings):
    """Move a ray to the boundary ahead; return whether it leaves the sample there.

    If the pores on both sides have the same index, the flight continues without an interface.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    ray = load_ray(state, lane, True)
    layer_geometry = load_layer_geometry(state, lane, job.constants, True)
    layer = int(state[lane_state.LAYER + lane])
    boundary_hit = compute_boundary_hit(ray, layer_geometry)
    next_layer = find_adjacent_layer(layer, ray.direction)
    inside = 0 <= next_layer < layers.collision_coefficient.size
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    if inside and has_same_refractive_index(lanes, lane, job, layer, next_layer):
        set_layer(lanes, lane, job, next_layer)
        state[lane_state.START_DISTANCE + lane] = max(
            boundary_hit.distance, state[lane_state.START_DISTANCE + lane]
        )
        return False
    store_vector(state, lane_state.X + lane, boundary_hit.position)
    store_vector(state, lane_state.EXIT_OFFSET_X + lane, Vector(ZERO, ZERO, ZERO))
    store_vector(state, lane_state.PREV_DIR_X + lane, ray.direction)
    state[lane_state.PREV_LENGTH + lane] = boundary_hit.distance
    attenuate_segment(lanes, lane, job, crossings)
    near = refractive_index_of(optics, item, pore_material(lanes, lane, layers, layer))
    far = refractive_index_of(optics, item, layers.first_pore_material[layer])
    if inside:
        far = refractive_index_of(optics, item, pore_material(lanes, lane, layers, next_layer))
    transmitted = True
    if job.scene.rules.boundary_fresnel and (near.n != far.n or near.k != far.k):
        d = Vector(
            np.float64(ray.direction.x),
            np.float64(ray.direction.y),
            np.float64(ray.direction.z),
        )
        transmitted, e = sample_interface(
            d, orient_horizontal_normal(d), near, far, draw_uniform(words, lane)
        )
        store_vector(state, lane_state.DIR_X + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[lane_state.N_REJECTED + lane] = ZERO
    if transmitted and inside:
        record_crossing(lanes, lane, job, crossings, layer, next_layer < layer)
        set_layer(lanes, lane, job, next_layer)
        start_flight(state, lane)
    return transmitted and not inside
