"""The scalar kernel: one ray at a time through layers of grains, in double precision.

It repeats the trials of `flight.py` and `surface.py` until a ray is done.  Between their extended
faces layers reach to infinity sideways.  Above them may be a rough surface, below a ground; what
that keeps of a ray's light is noted as the ray meets it.
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.compiling.jit import entry, part
from splits.transport.grains.flight import FIRST_ROULETTE, Flier, Purse, roulette
from splits.transport.grains.legs import arrived, beyond, find, pass_face, settled, travelled
from splits.transport.grains.roof import aimed, cut_short, facet_ahead, outside, struck
from splits.transport.grains.scalar import (
    NO_LEG,
    Beam,
    Entered,
    Paid,
    Ray,
    deflected,
    ended,
    index_of,
    paid,
    pore_of,
    space_of,
    turned,
)
from splits.transport.grains.scene import GRAINS, NO_GROUND
from splits.transport.grains.spheroid import Segment
from splits.transport.grains.walk import walk
from splits.transport.grains.window import left_window
from splits.transport.numerics.rng import start_stream, uniform
from splits.transport.numerics.vectors import ORIGIN, UP, lobe
from splits.transport.optics.faces import facing, meet
from splits.transport.optics.light import launched
from splits.transport.rough.march import GONE
from splits.transport.rough.waves import realised
from splits.transport.sums.notes import (
    has_room,
    no_notes,
    note,
    of_ray,
    passage,
    room_for,
    taken,
    write,
)
from splits.transport.sums.tally import (
    ABSORBED,
    BELOW,
    EXIT_LENGTH,
    LOST,
    REFLECTED,
    TRANSMITTED,
    TRAVELS,
    Told,
    record,
)


@part
def at_face(state, ray, scene, optics, path_lengths, crossings):
    """Return a ray that passes the face at which it stands, or is sent back there."""
    layers, beam = scene.layers, ray.payload
    other = beyond(layers, beam.layer, beam.direction)
    inside = 0 <= other < layers.attenuation.size
    near = index_of(optics, pore_of(layers, beam.layer, beam.pore_variate))
    far = index_of(optics, layers.pore[beam.layer])
    matrix = layers.particle_row[beam.layer] != GRAINS
    if inside:
        far = index_of(optics, pore_of(layers, other, beam.pore_variate))
        matrix |= layers.particle_row[other] != GRAINS
    # The reading is about wet pores; what particles lie in has a face in any case.
    if not (scene.rules.boundary_fresnel or matrix):
        far = near
    crossing = meet(beam.direction, facing(beam.direction), near, far, uniform(state))
    fate, layer, u = TRAVELS, beam.layer, beam.pore_variate
    if crossing.transmitted and inside:
        layer = other
        pass_face(crossings, scene, beam.layer, layer < beam.layer, beam.roulette, path_lengths)
    elif crossing.transmitted:
        below = TRANSMITTED if scene.ground_column == NO_GROUND else BELOW
        fate = REFLECTED if other < 0 else below
    if layers.particle_row[layer] != GRAINS:
        # Light that comes from there to pores, now or after another reflection, comes to new ones.
        u = uniform(state)
    beam = Beam(crossing.direction, layer, u, beam.roulette)
    return Ray(fate, turned(ray.geometry, beam.direction), beam, ray.n_segments, ray.order, ray.max_order)


@part
def scattered_by_particle(state, payload, scene):
    """Return the beam that a particle scatters, if it is not absorbed there."""
    row = scene.layers.particle_row[payload.layer]
    albedo, purse = scene.particles.albedo[row], payload.roulette
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return Entered(False, payload)
    if not scene.rules.analog:
        # Roulette must hear of it; all wavelengths lose as much.
        purse = Purse(purse.optical_depth - math.log(albedo), purse.next_roulette, purse.weight * albedo)
    d = deflected(state, scene.particles, row, payload.direction)
    # Another leg begins; its pore matters in the next layer, if that has two.
    return Entered(True, Beam(d, payload.layer, uniform(state), purse))


@part
def met(state, ray, event, scene, optics, path_lengths):
    """Return a ray after the particle or the grain that it has met."""
    if ray.order == ray.max_order:
        return ended(ray, ABSORBED)
    if scene.layers.particle_row[ray.payload.layer] != GRAINS:
        after = scattered_by_particle(state, ray.payload, scene)
        fate = TRAVELS if after.continues else ABSORBED
        flier = turned(ray.geometry, after.payload.direction)
        return Ray(fate, flier, after.payload, ray.n_segments, ray.order + 1, ray.max_order)
    walked = walk(state, ray.payload, event, scene, optics, path_lengths)
    fate = TRAVELS if walked.alive else ABSORBED
    way = ORIGIN if scene.rules.point_grains else walked.displacement
    flier = Flier(ray.geometry.position, way, walked.payload.direction, ray.geometry.previous_segment, 0.0)
    return Ray(fate, flier, walked.payload, ray.n_segments, ray.order + 1, ray.max_order)


@part
def played(state, roulette_state):
    """Let a ray play roulette as often as it is due, see `splits.transport.grains.flight`."""
    alive = True
    while alive and roulette_state.optical_depth > roulette_state.next_roulette:
        result = roulette(roulette_state, uniform(state), True)
        roulette_state, alive = result.roulette, not result.terminated
    return Paid(roulette_state, alive)


@part
def follow(state, ray, scene, optics, path_lengths, crossings, window, rough_top):
    """Follow a ray until it leaves the scene or is absorbed, or until its worth wants a decision.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    ray : Ray
    scene, optics
        See `splits.transport.grains.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place.
    notes : Notes or None
        Taken where rays pass faces between layers; None where nobody listens, at no cost.
    window : Window or None
        None asks for no decisions, at no cost.
    roof : Surface or None
        The rough surface on top; None where it is smooth, at no cost.

    Returns
    -------
    Ray
        Its fate `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `BELOW`, `LOST`, or `TRAVELS` where the
        window is left, or where there might not be room for the next leg's notes.
    """
    layers = scene.layers
    while ray.status == TRAVELS:
        if crossings is not None and not has_room(crossings, 2 * layers.boundaries.size):
            break
        payment = played(state, ray.payload.roulette)
        if not payment.alive:
            return ended(ray, ABSORBED)
        beam = Beam(ray.payload.direction, ray.payload.layer, ray.payload.pore_variate, payment.roulette)
        flier, beam = settled(ray.geometry, beam, scene, optics, path_lengths, crossings)
        found = find(state, flier, beam, scene, optics)
        arrival = arrived(flier, found, space_of(layers, found.layer))
        hit = facet_ahead(rough_top, flier, found, arrival.previous_segment.length)
        if hit.distance != GONE:
            arrival, found = cut_short(flier, found, hit, layers.boundaries[1])
        ray = Ray(TRAVELS, arrival, beam, ray.n_segments + 1, ray.order, ray.max_order)
        if found.lost:
            return ended(ray, LOST)
        leg = Segment(arrival.position, beam.direction, arrival.previous_segment.length)
        payment = travelled(state, beam, found, leg, scene, optics, path_lengths, crossings)
        beam = Beam(beam.direction, found.layer, beam.pore_variate, payment.roulette)
        ray = Ray(TRAVELS, arrival, beam, ray.n_segments, ray.order, ray.max_order)
        if not payment.alive:
            return ended(ray, ABSORBED)
        if hit.distance != GONE:
            ray = struck(state, ray, hit.slope, scene, optics, rough_top)
        elif found.collision.leaves_layer:
            ray = at_face(state, ray, scene, optics, path_lengths, crossings)
        else:
            ray = met(state, ray, found, scene, optics, path_lengths)
            if window is not None and ray.status == TRAVELS and left_window(window, ray, layers):
                break
    return ray


@part
def entered(state, direction, layer, roulette_state, scene, optics):
    """Return the beam of a ray that comes from outside to a layer, if that lets it in.

    Its pore there is drawn first: the boundary of a wet one may reflect it at once.
    """
    layers = scene.layers
    u = uniform(state)
    near, far = index_of(optics, layers.pore[layer]), index_of(optics, pore_of(layers, layer, u))
    if not (scene.rules.boundary_fresnel or layers.particle_row[layer] != GRAINS):
        far = near
    crossing = meet(direction, facing(direction), near, far, uniform(state))
    return Entered(crossing.transmitted, Beam(crossing.direction, layer, u, roulette_state))


@part
def launch(state, scene, optics, rough_top, max_order):
    """Start a ray at the top, which may meet so many grains."""
    light = scene.source
    d = launched(light, uniform(state) if light.diffuse_fraction > 0.0 else 1.0)
    purse = Purse(0.0, math.inf if scene.rules.analog else FIRST_ROULETTE, 1.0)
    if rough_top is not None:
        return outside(state, aimed(d, purse, rough_top, max_order), scene, optics, rough_top)
    passed, beam = entered(state, d, 0, purse, scene, optics)
    fate = TRAVELS if passed else REFLECTED
    return Ray(fate, Flier(ORIGIN, ORIGIN, beam.direction, NO_LEG, 0.0), beam, 0, 0, max_order)


@part
def risen(state, ray, scene, optics, path_lengths):
    """Return a ray that comes back from the ground by Lambert's law, or stays there.

    One that the sample's lower face sends down again is still below.  Among the grains that it may
    meet the ground counts as one.
    """
    purse, analog = ray.payload.roulette, scene.rules.analog
    payment = paid(state, purse, 1.0, scene.ground_column, optics, analog, path_lengths)
    if not payment.alive:
        return ended(ray, TRANSMITTED)
    payment = played(state, payment.roulette)
    if not payment.alive or ray.order == ray.max_order:
        return ended(ray, ABSORBED)
    d = lobe(UP, uniform(state), uniform(state))
    lowest = scene.layers.attenuation.size - 1
    passed, beam = entered(state, d, lowest, payment.roulette, scene, optics)
    fate = TRAVELS if passed else BELOW
    return Ray(fate, turned(ray.geometry, beam.direction), beam, ray.n_segments, ray.order + 1, ray.max_order)


@entry
def batch(seed, work, scene, optics, exits, height_fields, surface_buffer):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed : int
    work : int64[4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same whoever traces it.
    scene, optics
        See `splits.transport.grains.scene`.
    exits : float64[rays, columns]
        A row for each ray, see `splits.transport.sums.tally`; must come from `exit_rows`.
    fields, room : Fields, Surface, or None
        The rough surface on top, of which every ray has a realisation, and where that lives, see
        `waves.room_for`; None where it is smooth.

    Returns
    -------
    Told
        Its notes are of rays that reach a ground; with `Rules.analog` there are none.
    """
    legs = 0
    length = np.zeros(optics.n.size)
    state = np.zeros(1, dtype=np.uint64)
    notes = no_notes(optics.n.size)
    most, faces = 2 * scene.layers.boundaries.size, scene.layers.boundaries.size
    for number in range(work[2]):
        start_stream(state, seed, work[0], work[1] + number)
        of_ray(notes, number)
        length[:] = 0.0
        roof = realised(state, height_fields, surface_buffer)
        ray = launch(state, scene, optics, roof, work[3])
        while ray.status == TRAVELS or ray.status == BELOW:
            notes = room_for(notes, most)
            if ray.status == TRAVELS:
                ray = follow(state, ray, scene, optics, length, notes, None, roof)
            else:
                if not scene.rules.analog:
                    note(notes, passage(faces - 1, False), ray.payload.roulette.weight, length)
                ray = risen(state, ray, scene, optics, length)
        legs += ray.n_segments
        if ray.status == LOST:
            return Told(legs, True, taken(notes))
        if ray.status != ABSORBED:
            purse = ray.payload.roulette
            record(
                exits[number], ray.status == REFLECTED, ray.geometry.position, ray.payload.direction, purse.weight,
                ray.order,
            )  # fmt: skip
            write(exits[number], EXIT_LENGTH, length)
    return Told(legs, False, taken(notes))
