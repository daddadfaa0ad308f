"""The legs of a ray through layers of grains: what it meets next, and what the way there costs.

Between layers nothing optical stands.  A flight spends one exponential distance, layer by layer,
and a grain belongs to the layer in which the ray meets it; the pore of a leg is drawn once, so it
changes at a face between layers only where their saturations differ.  Cutting a medium in two
therefore changes nothing.
"""

from __future__ import annotations

from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.free_path import (
    RayGeometry,
    RejectionRules,
    compute_boundary_hit,
    sample_collision,
)
from splits.kernels.grains.scene import MAX_REJECTIONS, NO_PARTICLES
from splits.kernels.grains.spheroid import Segment
from splits.kernels.grains.state import (
    AttenuationResult,
    NextEvent,
    RayPayload,
    attenuate,
    get_layer_geometry,
    make_rejection_rules,
    pore_material,
    refractive_index_of,
    sample_entry_variates,
    sample_grain,
)
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.tallies.crossings import append_crossing, encode_crossing


@inline_only
def find_adjacent_layer(layers, layer, direction):
    """Return the layer behind the face that a ray along d has ahead; −1 or their number outside."""
    return layer - 1 if direction.z > 0.0 else layer + 1


@inline_only
def has_same_pore_index(layers, optics, layer, other, pore_variate):
    """Tell whether the pores of two layers are the same to light."""
    a = refractive_index_of(optics, pore_material(layers, layer, pore_variate))
    b = refractive_index_of(optics, pore_material(layers, other, pore_variate))
    return a.n == b.n and a.k == b.k


@inline_only
def record_crossing(crossings, scene, layer, upward, roulette_state, path_lengths):
    """Note a ray that passes from a layer into the next one, where somebody listens."""
    if crossings is not None and scene.record_crossings:
        append_crossing(
            crossings,
            encode_crossing(layer if upward else layer + 1, upward),
            roulette_state.weight,
            path_lengths,
        )


@inline_only
def locate_layer(geometry, payload, scene, optics, path_lengths, crossings):
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
        if not inside or not has_same_pore_index(
            layers, optics, layer, other, payload.pore_variate
        ):
            z = face
            break
        record_crossing(crossings, scene, layer, step < 0, payload.roulette, path_lengths)
        layer = other
    way = Vector(geometry.exit_offset.x, geometry.exit_offset.y, z - geometry.position.z)
    return RayGeometry(
        geometry.position, way, payload.direction, geometry.previous_segment, 0.0
    ), RayPayload(payload.direction, layer, payload.pore_variate, payload.roulette)


@inline_only
def sample_next_event(state, geometry, payload, scene, optics):
    """Draw the next grain on a ray, or find the face that it reaches first.

    A grain that does not fit is drawn again from where the ray set out, from where the last one
    was left out, or from where the last layer of particles was left.
    """
    layers, usual = scene.layers, make_rejection_rules(scene.rules)
    start, layer = payload.layer, payload.layer
    ahead = RayGeometry(
        geometry.position, geometry.exit_offset, geometry.direction, geometry.previous_segment, 0.0
    )
    tries = 0
    while True:
        space = get_layer_geometry(layers, layer)
        candidate = sample_grain(state, scene, layer)
        aim = sample_entry_variates(state, candidate.size.flattening)
        fates = usual
        if layers.particle_row[layer] != NO_PARTICLES:
            # A particle is a point: it fits everywhere.
            fates = RejectionRules(usual.entry_sampling, False, False, False, False)
        meeting = sample_collision(ahead, candidate.size, aim, uniform(state), space, fates)
        if meeting.accepted:
            return NextEvent(candidate, meeting, layer, False)
        if meeting.leaves_layer:
            other = find_adjacent_layer(layers, layer, geometry.direction)
            inside = 0 <= other < layers.attenuation.size
            if not inside or not has_same_pore_index(
                layers, optics, layer, other, payload.pore_variate
            ):
                return NextEvent(candidate, meeting, layer, False)
            reach = compute_boundary_hit(geometry, space).distance
            ahead = RayGeometry(
                geometry.position,
                geometry.exit_offset,
                geometry.direction,
                geometry.previous_segment,
                reach,
            )
            if layers.particle_row[layer] != NO_PARTICLES:
                # Particles let the ray pass, whatever grain beyond them does not fit.
                start, geometry = other, ahead
            layer = other
            continue
        if meeting.start_distance == meeting.distance:
            start = layer
            geometry = RayGeometry(
                geometry.position,
                geometry.exit_offset,
                geometry.direction,
                geometry.previous_segment,
                meeting.start_distance,
            )
        layer = start
        ahead = geometry
        tries += 1
        if tries == MAX_REJECTIONS:
            return NextEvent(candidate, meeting, layer, True)


@inline_only
def move_to_event(geometry, event, layer_geometry):
    """Return a ray at the grain that it meets, or at the face that comes before."""
    leg, height = event.collision.distance, event.collision.height
    if event.collision.leaves_layer:
        arrival = compute_boundary_hit(geometry, layer_geometry)
        leg, height = arrival.distance, arrival.position.z
    x = geometry.position.x + geometry.exit_offset.x + leg * geometry.direction.x
    y = geometry.position.y + geometry.exit_offset.y + leg * geometry.direction.y
    return RayGeometry(
        Vector(x, y, height),
        ORIGIN,
        geometry.direction,
        Segment(ORIGIN, geometry.direction, leg),
        0.0,
    )


@inline_only
def attenuate_segment(state, payload, event, segment, scene, optics, path_lengths, crossings):
    """Take a leg through the pores of the layers up to that in which it ends.

    Parameters
    ----------
    payload : RayPayload
        As the leg begins.
    event : Found
        Where it ends.
    segment : Segment
        Its end as a place (m), and its length.
    length, notes
        See `follow`.
    """
    layers, d, analog = scene.layers, payload.direction, scene.rules.analog
    payment = AttenuationResult(payload.roulette, True)
    rest, layer = segment.length, payload.layer
    z = segment.end.z - segment.length * d.z
    while layer != event.layer and payment.alive:
        face = layers.boundaries[layer] if d.z > 0.0 else layers.boundaries[layer + 1]
        piece = min(max((face - z) / d.z, 0.0), rest)
        pore = pore_material(layers, layer, payload.pore_variate)
        payment = attenuate(state, payment.roulette, piece, pore, optics, analog, path_lengths)
        if payment.alive:
            record_crossing(crossings, scene, layer, d.z > 0.0, payment.roulette, path_lengths)
        z, rest, layer = face, rest - piece, find_adjacent_layer(layers, layer, d)
    if payment.alive:
        pore = pore_material(layers, layer, payload.pore_variate)
        payment = attenuate(state, payment.roulette, rest, pore, optics, analog, path_lengths)
    return payment
