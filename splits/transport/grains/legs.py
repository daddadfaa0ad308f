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
def beyond(layers, layer, d):
    """Return the layer behind the face that a ray along d has ahead; −1 or their number outside."""
    return layer - 1 if d.z > 0.0 else layer + 1


@part
def alike(layers, optics, one, other, u):
    """Tell whether the pores of two layers are the same to light."""
    a = index_of(optics, pore_of(layers, one, u))
    b = index_of(optics, pore_of(layers, other, u))
    return a.n == b.n and a.k == b.k


@part
def pass_face(notes, scene, layer, upward, purse, length):
    """Note a ray that passes from a layer into the next one, where somebody listens."""
    if notes is not None and scene.listens:
        note(notes, passage(layer if upward else layer + 1, upward), purse.weight, length)


@part
def settled(flier, beam, scene, optics, length, notes):
    """Return a ray that left a grain, its layer that in which it now is.

    Only a grain that reaches across a face lets a ray out on its other side.  If there are other
    pores, as outside the sample, the ray counts as standing on that face.
    """
    layers = scene.layers
    z = flier.place.z + flier.way.z
    layer = beam.layer
    while z > layers.face[layer] or z < layers.face[layer + 1]:
        step = -1 if z > layers.face[layer] else 1
        face = layers.face[layer] if step < 0 else layers.face[layer + 1]
        other = layer + step
        inside = 0 <= other < layers.attenuation.size
        if not inside or not alike(layers, optics, layer, other, beam.u):
            z = face
            break
        pass_face(notes, scene, layer, step < 0, beam.purse, length)
        layer = other
    way = Vector(flier.way.x, flier.way.y, z - flier.place.z)
    return Flier(flier.place, way, beam.d, flier.last, 0.0), Beam(beam.d, layer, beam.u, beam.purse)


@part
def find(state, flier, beam, scene, optics):
    """Draw the next grain on a ray, or find the face that it reaches first.

    A grain that does not fit is drawn again from where the ray set out, from where the last one
    was left out, or from where the last layer of particles was left.
    """
    layers, usual = scene.layers, fates_of(scene.rules)
    start, layer = beam.layer, beam.layer
    ahead = Flier(flier.place, flier.way, flier.d, flier.last, 0.0)
    tries = 0
    while True:
        space = space_of(layers, layer)
        candidate = candidate_of(state, scene, layer)
        aim = aim_of(state, candidate.size.flattening)
        fates = usual
        if layers.particles[layer] != GRAINS:
            # A particle is a point: it fits everywhere.
            fates = Fates(usual.entry, False, False, False, False)
        meeting = next_grain(ahead, candidate.size, aim, uniform(state), space, fates)
        if meeting.fits:
            return Found(candidate, meeting, layer, False)
        if meeting.outside:
            other = beyond(layers, layer, flier.d)
            inside = 0 <= other < layers.attenuation.size
            if not inside or not alike(layers, optics, layer, other, beam.u):
                return Found(candidate, meeting, layer, False)
            reach = to_boundary(flier, space).leg
            ahead = Flier(flier.place, flier.way, flier.d, flier.last, reach)
            if layers.particles[layer] != GRAINS:
                # Particles let the ray pass, whatever grain beyond them does not fit.
                start, flier = other, ahead
            layer = other
            continue
        if meeting.skipped == meeting.leg:
            start = layer
            flier = Flier(flier.place, flier.way, flier.d, flier.last, meeting.skipped)
        layer = start
        ahead = flier
        tries += 1
        if tries == MAX_REJECTIONS:
            return Found(candidate, meeting, layer, True)


@part
def arrived(flier, found, space):
    """Return a ray at the grain that it meets, or at the face that comes before."""
    leg, height = found.meeting.leg, found.meeting.height
    if found.meeting.outside:
        arrival = to_boundary(flier, space)
        leg, height = arrival.leg, arrival.place.z
    x = flier.place.x + flier.way.x + leg * flier.d.x
    y = flier.place.y + flier.way.y + leg * flier.d.y
    return Flier(Vector(x, y, height), ORIGIN, flier.d, Segment(ORIGIN, flier.d, leg), 0.0)


@part
def travelled(state, beam, goal, leg, scene, optics, length, notes):
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
    layers, d, analog = scene.layers, beam.d, scene.rules.analog
    payment = Paid(beam.purse, True)
    rest, layer = leg.length, beam.layer
    z = leg.end.z - leg.length * d.z
    while layer != goal.layer and payment.alive:
        face = layers.face[layer] if d.z > 0.0 else layers.face[layer + 1]
        piece = min(max((face - z) / d.z, 0.0), rest)
        pore = pore_of(layers, layer, beam.u)
        payment = paid(state, payment.purse, piece, pore, optics, analog, length)
        if payment.alive:
            pass_face(notes, scene, layer, d.z > 0.0, payment.purse, length)
        z, rest, layer = face, rest - piece, beyond(layers, layer, d)
    if payment.alive:
        pore = pore_of(layers, layer, beam.u)
        payment = paid(state, payment.purse, rest, pore, optics, analog, length)
    return payment
