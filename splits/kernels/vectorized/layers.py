"""Rays of lanes among layers, between the passes: faces, legs through several layers, the way back.

See `splits.kernels.grains.history` for what happens there.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, ZERO, inline_only
from splits.kernels.grains.free_path import compute_boundary_hit
from splits.kernels.grains.history import find_adjacent_layer
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.tallies.crossings import append_crossing, encode_crossing, set_current_ray
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.flight import load_layer_geometry, load_ray
from splits.kernels.vectorized.lane_state import store_vector
from splits.kernels.vectorized.lifecycle import (
    draw_uniform,
    refractive_index_of,
    set_layer_optics,
)


@inline_only
def pore_material(lanes, lane, layers, layer):
    """Return the material of the pore space that a lane's ray has, or would have, in a layer."""
    wet = lanes.state[lane_state.PORE_VARIATE + lane] < single(layers.saturation[layer])
    return layers.pore[layer] + (1 if wet else 0)


@inline_only
def has_same_pore_index(lanes, lane, job, layer, other):
    """Tell whether the pores of two layers are the same to a lane's light."""
    layers, item = job.scene.layers, lanes.item[lane]
    a = refractive_index_of(job.optics, item, pore_material(lanes, lane, layers, layer))
    b = refractive_index_of(job.optics, item, pore_material(lanes, lane, layers, other))
    return a.n == b.n and a.k == b.k


@inline_only
def set_layer(lanes, lane, job, layer):
    """Bring a lane's ray into a layer; its pore there is the one that its number decides."""
    state, layers = lanes.state, job.scene.layers
    state[lane_state.LAYER + lane] = single(layer)
    wet = lanes.state[lane_state.PORE_VARIATE + lane] < single(layers.saturation[layer])
    state[lane_state.PORE_WET + lane] = ONE if wet else ZERO
    set_layer_optics(state, lane, job.scene, job.optics, lanes.item[lane])


@inline_only
def start_flight(state, lane):
    """Let a lane's flight set out in the layer in which its ray is."""
    layer = state[lane_state.LAYER + lane]
    state[lane_state.FLIGHT_LAYER + lane], state[lane_state.DRAW_LAYER + lane] = layer, layer
    state[lane_state.START_DISTANCE + lane], state[lane_state.SKIP_DISTANCE + lane] = ZERO, ZERO
    state[lane_state.ON_BOUNDARY + lane] = ZERO


@inline_only
def append_lane_crossing(lanes, lane, crossings, event):
    """Note where a lane's ray is; its lengths must have been put down."""
    set_current_ray(crossings, lanes.ray[lane])
    append_crossing(
        crossings,
        event,
        np.float64(lanes.state[lane_state.WEIGHT + lane]),
        lanes.path_lengths[lane],
    )


@inline_only
def record_crossing(lanes, lane, job, crossings, layer, upward):
    """Note a lane's ray that passes from a layer into the next one, where somebody listens."""
    if job.scene.record_crossings:
        append_lane_crossing(
            lanes, lane, crossings, encode_crossing(layer if upward else layer + 1, upward)
        )


@inline_only
def attenuate_segment(lanes, lane, job, crossings):
    """Take the leg that a lane's ray has just flown through the pores of its layers."""
    state, item, layers = lanes.state, lanes.item[lane], job.scene.layers
    d = np.float64(state[lane_state.PREV_DIR_Z + lane])
    rest = np.float64(state[lane_state.PREV_LENGTH + lane])
    z = np.float64(state[lane_state.Z + lane]) - rest * d
    layer, goal = int(state[lane_state.FLIGHT_LAYER + lane]), int(state[lane_state.LAYER + lane])
    depth = 0.0
    while True:
        piece = rest
        if layer != goal:
            face = layers.boundaries[layer] if d > 0.0 else layers.boundaries[layer + 1]
            piece = min(max((face - z) / d, 0.0), rest)
            z = face
        pore = pore_material(lanes, lane, layers, layer)
        lanes.path_lengths[lane, pore] += piece
        depth += piece * job.optics.absorption[item, pore]
        if layer == goal:
            break
        record_crossing(lanes, lane, job, crossings, layer, d > 0.0)
        rest -= piece
        layer += -1 if d > 0.0 else 1
    state[lane_state.OPTICAL_DEPTH + lane] += single(depth)
    state[lane_state.SEGMENT_ATTENUATED + lane] = ONE
    start_flight(state, lane)


@inline_only
def restart_flight(lanes, lane, job):
    """Let a lane's ray draw its next grain from where it set out, or left the last one out."""
    state = lanes.state
    set_layer(lanes, lane, job, int(state[lane_state.DRAW_LAYER + lane]))
    state[lane_state.START_DISTANCE + lane] = state[lane_state.SKIP_DISTANCE + lane]
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT


@inline_only
def locate_layer(lanes, lane, job, crossings):
    """Find the layer of a lane's ray that left a grain on the other side of a face.

    Where there are other pores the ray counts as standing on that face.
    """
    state, face = lanes.state, job.scene.layers.boundaries
    z = state[lane_state.Z + lane] + state[lane_state.EXIT_OFFSET_Z + lane]
    layer = int(state[lane_state.LAYER + lane])
    state[lane_state.ON_BOUNDARY + lane] = ONE
    while z > single(face[layer]) or z < single(face[layer + 1]):
        step = -1 if z > single(face[layer]) else 1
        other = layer + step
        if other < 0 or other == face.size - 1:
            break
        if not has_same_pore_index(lanes, lane, job, layer, other):
            border = face[layer] if step < 0 else face[layer + 1]
            state[lane_state.EXIT_OFFSET_Z + lane] = single(border) - state[lane_state.Z + lane]
            break
        record_crossing(lanes, lane, job, crossings, layer, step < 0)
        layer = other
    set_layer(lanes, lane, job, layer)
    stands = state[lane_state.ON_BOUNDARY + lane]
    start_flight(state, lane)
    state[lane_state.ON_BOUNDARY + lane] = stands
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT


@inline_only
def cross_interface(lanes, lane, job, crossings):
    """Bring a lane's ray to the face ahead; return whether it leaves the sample there.

    Where the pores on both sides are the same nothing stands between them, and the flight goes on.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    ray = load_ray(state, lane, True)
    space = load_layer_geometry(state, lane, job.constants, True)
    layer = int(state[lane_state.LAYER + lane])
    arrival = compute_boundary_hit(ray, space)
    other = find_adjacent_layer(layers, layer, ray.direction)
    inside = 0 <= other < layers.attenuation.size
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    if inside and has_same_pore_index(lanes, lane, job, layer, other):
        set_layer(lanes, lane, job, other)
        state[lane_state.START_DISTANCE + lane] = max(
            arrival.distance, state[lane_state.START_DISTANCE + lane]
        )
        return False
    store_vector(state, lane_state.X + lane, arrival.position)
    store_vector(state, lane_state.EXIT_OFFSET_X + lane, Vector(ZERO, ZERO, ZERO))
    store_vector(state, lane_state.PREV_DIR_X + lane, ray.direction)
    state[lane_state.PREV_LENGTH + lane] = arrival.distance
    attenuate_segment(lanes, lane, job, crossings)
    near = refractive_index_of(optics, item, pore_material(lanes, lane, layers, layer))
    far = refractive_index_of(optics, item, layers.pore[layer])
    if inside:
        far = refractive_index_of(optics, item, pore_material(lanes, lane, layers, other))
    passed = True
    if job.scene.rules.boundary_fresnel and (near.n != far.n or near.k != far.k):
        d = Vector(
            np.float64(ray.direction.x), np.float64(ray.direction.y), np.float64(ray.direction.z)
        )
        passed, e = sample_interface(
            d, orient_horizontal_normal(d), near, far, draw_uniform(words, lane)
        )
        store_vector(state, lane_state.DIR_X + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[lane_state.N_REJECTED + lane] = ZERO
    if passed and inside:
        record_crossing(lanes, lane, job, crossings, layer, other < layer)
        set_layer(lanes, lane, job, other)
        start_flight(state, lane)
    return passed and not inside
