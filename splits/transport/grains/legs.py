"""The legs of a ray through layers of grains: what it meets next, and what the way there costs.

Between layers nothing optical stands.  A flight spends one exponential distance, layer by layer,
and a grain belongs to the layer in which the ray meets it; the pore of a leg is drawn once, so it
changes at a face between layers only where their saturations differ.  Cutting a medium in two
therefore changes nothing.
"""

from __future__ import annotations

from splits.transport.compiling.jit import part
from splits.transport.grains.flight import Fates, Flier, next_grain, to_boundary
from splits.transport.grains.scalar import (
    Beam,
    Found,
    Paid,
    aim_of,
    candidate_of,
    fates_of,
    index_of,
    paid,
    pore_of,
    space_of,
)
from splits.transport.grains.scene import GRAINS, MAX_REJECTIONS
from splits.transport.grains.spheroid import Segment
from splits.transport.numerics.rng import uniform
from splits.transport.numerics.vectors import ORIGIN, Vector
from splits.transport.sums.notes import note, passage


@part
def beyond(layers, layer, direction):
    """Return the layer behind the face that a ray along d has ahead; −1 or their number outside."""
    return layer - 1 if direction.z > 0.0 else layer + 1


@part
def alike(layers, optics, layer, other, pore_variate):
    """Tell whether the pores of two layers are the same to light."""
    a = index_of(optics, pore_of(layers, layer, pore_variate))
    b = index_of(optics, pore_of(layers, other, pore_variate))
    return a.n == b.n and a.k == b.k


@part
def pass_face(crossings, scene, layer, upward, roulette_state, path_lengths):
    """Note a ray that passes from a layer into the next one, where somebody listens."""
    if crossings is not None and scene.record_crossings:
        note(crossings, passage(layer if upward else layer + 1, upward), roulette_state.weight, path_lengths)


@part
def settled(geometry, payload, scene, optics, path_lengths, crossings):
    """Return a ray that left a grain, its layer that in which it now is.

    Only a grain that reaches across a face lets a ray out on its other side.  If there are other
    pores, as outside the sample, the ray counts as standing on that face.
    """
    layers = scene.layers
    z = geometry.position.z + geometry.exit_offset.z
    layer = payload.layer
    while z > layers.boundaries[layer] or z < layers.boundaries[layer + 1]:
        step = -1 if z > layers.boundaries[layer] else 1
        face = layers.boundaries[layer] if step < 0 else layers.boundaries[layer + 1]
        other = layer + step
        inside = 0 <= other < layers.attenuation.size
        if not inside or not alike(layers, optics, layer, other, payload.pore_variate):
            z = face
            break
        pass_face(crossings, scene, layer, step < 0, payload.roulette, path_lengths)
        layer = other
    way = Vector(geometry.exit_offset.x, geometry.exit_offset.y, z - geometry.position.z)
    return Flier(geometry.position, way, payload.direction, geometry.previous_segment, 0.0), Beam(payload.direction, layer, payload.pore_variate, payload.roulette)


@part
def find(state, geometry, payload, scene, optics):
    """Draw the next grain on a ray, or find the face that it reaches first.

    A grain that does not fit is drawn again from where the ray set out, from where the last one
    was left out, or from where the last layer of particles was left.
    """
    layers, usual = scene.layers, fates_of(scene.rules)
    start, layer = payload.layer, payload.layer
    ahead = Flier(geometry.position, geometry.exit_offset, geometry.direction, geometry.previous_segment, 0.0)
    tries = 0
    while True:
        space = space_of(layers, layer)
        candidate = candidate_of(state, scene, layer)
        aim = aim_of(state, candidate.size.flattening)
        fates = usual
        if layers.particle_row[layer] != GRAINS:
            # A particle is a point: it fits everywhere.
            fates = Fates(usual.entry_sampling, False, False, False, False)
        meeting = next_grain(ahead, candidate.size, aim, uniform(state), space, fates)
        if meeting.accepted:
            return Found(candidate, meeting, layer, False)
        if meeting.leaves_layer:
            other = beyond(layers, layer, geometry.direction)
            inside = 0 <= other < layers.attenuation.size
            if not inside or not alike(layers, optics, layer, other, payload.pore_variate):
                return Found(candidate, meeting, layer, False)
            reach = to_boundary(geometry, space).distance
            ahead = Flier(geometry.position, geometry.exit_offset, geometry.direction, geometry.previous_segment, reach)
            if layers.particle_row[layer] != GRAINS:
                # Particles let the ray pass, whatever grain beyond them does not fit.
                start, geometry = other, ahead
            layer = other
            continue
        if meeting.start_distance == meeting.distance:
            start = layer
            geometry = Flier(geometry.position, geometry.exit_offset, geometry.direction, geometry.previous_segment, meeting.start_distance)
        layer = start
        ahead = geometry
        tries += 1
        if tries == MAX_REJECTIONS:
            return Found(candidate, meeting, layer, True)


@part
def arrived(geometry, event, layer_geometry):
    """Return a ray at the grain that it meets, or at the face that comes before."""
    leg, height = event.collision.distance, event.collision.height
    if event.collision.leaves_layer:
        arrival = to_boundary(geometry, layer_geometry)
        leg, height = arrival.distance, arrival.position.z
    x = geometry.position.x + geometry.exit_offset.x + leg * geometry.direction.x
    y = geometry.position.y + geometry.exit_offset.y + leg * geometry.direction.y
    return Flier(Vector(x, y, height), ORIGIN, geometry.direction, Segment(ORIGIN, geometry.direction, leg), 0.0)


@part
def travelled(state, payload, event, segment, scene, optics, path_lengths, crossings):
    """Take a leg through the pores of the layers up to that in which it ends.

    Parameters
    ----------
    beam : Beam
        As the leg begins.
    goal : Found
        Where it ends.
    leg : Segment
        Its end as a place (m), and its length.
    length, notes
        See `follow`.
    """
    layers, d, analog = scene.layers, payload.direction, scene.rules.analog
    payment = Paid(payload.roulette, True)
    rest, layer = segment.length, payload.layer
    z = segment.end.z - segment.length * d.z
    while layer != event.layer and payment.alive:
        face = layers.boundaries[layer] if d.z > 0.0 else layers.boundaries[layer + 1]
        piece = min(max((face - z) / d.z, 0.0), rest)
        pore = pore_of(layers, layer, payload.pore_variate)
        payment = paid(state, payment.roulette, piece, pore, optics, analog, path_lengths)
        if payment.alive:
            pass_face(crossings, scene, layer, d.z > 0.0, payment.roulette, path_lengths)
        z, rest, layer = face, rest - piece, beyond(layers, layer, d)
    if payment.alive:
        pore = pore_of(layers, layer, payload.pore_variate)
        payment = paid(state, payment.roulette, rest, pore, optics, analog, path_lengths)
    return payment
