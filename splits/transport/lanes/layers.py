"""Rays of lanes among layers, between the passes: faces, legs through several layers, the way back.

See `splits.transport.grains.granular` for what happens there.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.jit import ONE, ZERO, part
from splits.transport.grains.flight import to_boundary
from splits.transport.grains.granular import beyond
from splits.transport.lanes import rows
from splits.transport.lanes.ends import draw, illuminate, index_of
from splits.transport.lanes.flight import flier_at, space_at
from splits.transport.lanes.rows import put
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.faces import facing, meet
from splits.transport.sums.notes import note, of_ray, passage


@part
def pore_of(lanes, lane, layers, layer):
    """Return the material of the pore space that a lane's ray has, or would have, in a layer."""
    wet = lanes.state[rows.PORE + lane] < single(layers.saturation[layer])
    return layers.pore[layer] + (1 if wet else 0)


@part
def alike(lanes, lane, job, layer, other):
    """Tell whether the pores of two layers are the same to a lane's light."""
    layers, item = job.scene.layers, lanes.item[lane]
    a = index_of(job.optics, item, pore_of(lanes, lane, layers, layer))
    b = index_of(job.optics, item, pore_of(lanes, lane, layers, other))
    return a.n == b.n and a.k == b.k


@part
def enter(lanes, lane, job, layer):
    """Bring a lane's ray into a layer; its pore there is the one that its number decides."""
    state, layers = lanes.state, job.scene.layers
    state[rows.LAYER + lane] = single(layer)
    wet = lanes.state[rows.PORE + lane] < single(layers.saturation[layer])
    state[rows.WET + lane] = ONE if wet else ZERO
    illuminate(state, lane, job.scene, job.optics, lanes.item[lane])


@part
def set_out(state, lane):
    """Let a lane's flight set out in the layer in which its ray is."""
    layer = state[rows.LAYER + lane]
    state[rows.START + lane], state[rows.FROM + lane] = layer, layer
    state[rows.AHEAD + lane], state[rows.SKIP_LEG + lane] = ZERO, ZERO
    state[rows.STANDS + lane] = ZERO


@part
def take_note(lanes, lane, crossings, event):
    """Note where a lane's ray is; its lengths must have been put down."""
    of_ray(crossings, lanes.ray[lane])
    note(crossings, event, np.float64(lanes.state[rows.WEIGHT + lane]), lanes.path_lengths[lane])


@part
def pass_face(lanes, lane, job, crossings, layer, upward):
    """Note a lane's ray that passes from a layer into the next one, where somebody listens."""
    if job.scene.record_crossings:
        take_note(lanes, lane, crossings, passage(layer if upward else layer + 1, upward))


@part
def land(lanes, lane, job, crossings):
    """Take the leg that a lane's ray has just flown through the pores of its layers."""
    state, item, layers = lanes.state, lanes.item[lane], job.scene.layers
    d = np.float64(state[rows.LZ + lane])
    rest = np.float64(state[rows.LAST + lane])
    z = np.float64(state[rows.Z + lane]) - rest * d
    layer, goal = int(state[rows.START + lane]), int(state[rows.LAYER + lane])
    depth = 0.0
    while True:
        piece = rest
        if layer != goal:
            face = layers.boundaries[layer] if d > 0.0 else layers.boundaries[layer + 1]
            piece = min(max((face - z) / d, 0.0), rest)
            z = face
        pore = pore_of(lanes, lane, layers, layer)
        lanes.path_lengths[lane, pore] += piece
        depth += piece * job.optics.absorption[item, pore]
        if layer == goal:
            break
        pass_face(lanes, lane, job, crossings, layer, d > 0.0)
        rest -= piece
        layer += -1 if d > 0.0 else 1
    state[rows.DEPTH + lane] += single(depth)
    state[rows.LANDED + lane] = ONE
    set_out(state, lane)


@part
def begin_again(lanes, lane, job):
    """Let a lane's ray draw its next grain from where it set out, or left the last one out."""
    state = lanes.state
    enter(lanes, lane, job, int(state[rows.FROM + lane]))
    state[rows.AHEAD + lane] = state[rows.SKIP_LEG + lane]
    state[rows.STATUS + lane] = rows.FLYING


@part
def relocate(lanes, lane, job, crossings):
    """Find the layer of a lane's ray that left a grain on the other side of a face.

    Where there are other pores the ray counts as standing on that face.
    """
    state, face = lanes.state, job.scene.layers.boundaries
    z = state[rows.Z + lane] + state[rows.GZ + lane]
    layer = int(state[rows.LAYER + lane])
    state[rows.STANDS + lane] = ONE
    while z > single(face[layer]) or z < single(face[layer + 1]):
        step = -1 if z > single(face[layer]) else 1
        other = layer + step
        if other < 0 or other == face.size - 1:
            break
        if not alike(lanes, lane, job, layer, other):
            border = face[layer] if step < 0 else face[layer + 1]
            state[rows.GZ + lane] = single(border) - state[rows.Z + lane]
            break
        pass_face(lanes, lane, job, crossings, layer, step < 0)
        layer = other
    enter(lanes, lane, job, layer)
    stands = state[rows.STANDS + lane]
    set_out(state, lane)
    state[rows.STANDS + lane] = stands
    state[rows.STATUS + lane] = rows.FLYING


@part
def at_interface(lanes, lane, job, crossings):
    """Bring a lane's ray to the face ahead; return whether it leaves the sample there.

    Where the pores on both sides are the same nothing stands between them, and the flight goes on.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    ray = flier_at(state, lane, True)
    space = space_at(state, lane, job.constants, True)
    layer = int(state[rows.LAYER + lane])
    arrival = to_boundary(ray, space)
    other = beyond(layers, layer, ray.direction)
    inside = 0 <= other < layers.attenuation.size
    state[rows.STATUS + lane] = rows.FLYING
    if inside and alike(lanes, lane, job, layer, other):
        enter(lanes, lane, job, other)
        state[rows.AHEAD + lane] = max(arrival.distance, state[rows.AHEAD + lane])
        return False
    put(state, rows.X + lane, arrival.position)
    put(state, rows.GX + lane, Vector(ZERO, ZERO, ZERO))
    put(state, rows.LX + lane, ray.direction)
    state[rows.LAST + lane] = arrival.distance
    land(lanes, lane, job, crossings)
    near = index_of(optics, item, pore_of(lanes, lane, layers, layer))
    far = index_of(optics, item, layers.pore[layer])
    if inside:
        far = index_of(optics, item, pore_of(lanes, lane, layers, other))
    passed = True
    if job.scene.rules.boundary_fresnel and (near.n != far.n or near.k != far.k):
        d = Vector(np.float64(ray.direction.x), np.float64(ray.direction.y), np.float64(ray.direction.z))
        passed, e = meet(d, facing(d), near, far, draw(words, lane))
        put(state, rows.DX + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[rows.TRIES + lane] = ZERO
    if passed and inside:
        pass_face(lanes, lane, job, crossings, layer, other < layer)
        enter(lanes, lane, job, other)
        set_out(state, lane)
    return passed and not inside
