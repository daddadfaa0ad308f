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
def at_face(state, ray, scene, optics, length, notes):
    """Return a ray that passes the face at which it stands, or is sent back there."""
    layers, beam = scene.layers, ray.beam
    other = beyond(layers, beam.layer, beam.d)
    inside = 0 <= other < layers.attenuation.size
    near = index_of(optics, pore_of(layers, beam.layer, beam.u))
    far = index_of(optics, layers.pore[beam.layer])
    matrix = layers.particles[beam.layer] != GRAINS
    if inside:
        far = index_of(optics, pore_of(layers, other, beam.u))
        matrix |= layers.particles[other] != GRAINS
    # The reading is about wet pores; what particles lie in has a face in any case.
    if not (scene.rules.boundary_fresnel or matrix):
        far = near
    crossing = meet(beam.d, facing(beam.d), near, far, uniform(state))
    fate, layer, u = TRAVELS, beam.layer, beam.u
    if crossing.passed and inside:
        layer = other
        pass_face(notes, scene, beam.layer, layer < beam.layer, beam.purse, length)
    elif crossing.passed:
        below = TRANSMITTED if scene.ground == NO_GROUND else BELOW
        fate = REFLECTED if other < 0 else below
    if layers.particles[layer] != GRAINS:
        # Light that comes from there to pores, now or after another reflection, comes to new ones.
        u = uniform(state)
    beam = Beam(crossing.d, layer, u, beam.purse)
    return Ray(fate, turned(ray.flier, beam.d), beam, ray.legs, ray.order, ray.most)


@part
def scattered_by_particle(state, beam, scene):
    """Return the beam that a particle scatters, if it is not absorbed there."""
    row = scene.layers.particles[beam.layer]
    albedo, purse = scene.particles.albedo[row], beam.purse
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return Entered(False, beam)
    if not scene.rules.analog:
        # Roulette must hear of it; all wavelengths lose as much.
        purse = Purse(purse.depth - math.log(albedo), purse.limit, purse.weight * albedo)
    d = deflected(state, scene.particles, row, beam.d)
    # Another leg begins; its pore matters in the next layer, if that has two.
    return Entered(True, Beam(d, beam.layer, uniform(state), purse))


@part
def met(state, ray, found, scene, optics, length):
    """Return a ray after the particle or the grain that it has met."""
    if ray.order == ray.most:
        return ended(ray, ABSORBED)
    if scene.layers.particles[ray.beam.layer] != GRAINS:
        after = scattered_by_particle(state, ray.beam, scene)
        fate = TRAVELS if after.passed else ABSORBED
        flier = turned(ray.flier, after.beam.d)
        return Ray(fate, flier, after.beam, ray.legs, ray.order + 1, ray.most)
    walked = walk(state, ray.beam, found, scene, optics, length)
    fate = TRAVELS if walked.alive else ABSORBED
    way = ORIGIN if scene.rules.point_grains else walked.way
    flier = Flier(ray.flier.place, way, walked.beam.d, ray.flier.last, 0.0)
    return Ray(fate, flier, walked.beam, ray.legs, ray.order + 1, ray.most)


@part
def played(state, purse):
    """Let a ray play roulette as often as it is due, see `splits.transport.grains.flight`."""
    alive = True
    while alive and purse.depth > purse.limit:
        result = roulette(purse, uniform(state), True)
        purse, alive = result.purse, not result.ended
    return Paid(purse, alive)


@part
def follow(state, ray, scene, optics, length, notes, window, roof):
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
    while ray.fate == TRAVELS:
        if notes is not None and not has_room(notes, 2 * layers.face.size):
            break
        payment = played(state, ray.beam.purse)
        if not payment.alive:
            return ended(ray, ABSORBED)
        beam = Beam(ray.beam.d, ray.beam.layer, ray.beam.u, payment.purse)
        flier, beam = settled(ray.flier, beam, scene, optics, length, notes)
        found = find(state, flier, beam, scene, optics)
        arrival = arrived(flier, found, space_of(layers, found.layer))
        hit = facet_ahead(roof, flier, found, arrival.last.length)
        if hit.distance != GONE:
            arrival, found = cut_short(flier, found, hit, layers.face[1])
        ray = Ray(TRAVELS, arrival, beam, ray.legs + 1, ray.order, ray.most)
        if found.lost:
            return ended(ray, LOST)
        leg = Segment(arrival.place, beam.d, arrival.last.length)
        payment = travelled(state, beam, found, leg, scene, optics, length, notes)
        beam = Beam(beam.d, found.layer, beam.u, payment.purse)
        ray = Ray(TRAVELS, arrival, beam, ray.legs, ray.order, ray.most)
        if not payment.alive:
            return ended(ray, ABSORBED)
        if hit.distance != GONE:
            ray = struck(state, ray, hit.slope, scene, optics, roof)
        elif found.meeting.outside:
            ray = at_face(state, ray, scene, optics, length, notes)
        else:
            ray = met(state, ray, found, scene, optics, length)
            if window is not None and ray.fate == TRAVELS and left_window(window, ray, layers):
                break
    return ray


@part
def entered(state, d, layer, purse, scene, optics):
    """Return the beam of a ray that comes from outside to a layer, if that lets it in.

    Its pore there is drawn first: the boundary of a wet one may reflect it at once.
    """
    layers = scene.layers
    u = uniform(state)
    near, far = index_of(optics, layers.pore[layer]), index_of(optics, pore_of(layers, layer, u))
    if not (scene.rules.boundary_fresnel or layers.particles[layer] != GRAINS):
        far = near
    crossing = meet(d, facing(d), near, far, uniform(state))
    return Entered(crossing.passed, Beam(crossing.d, layer, u, purse))


@part
def launch(state, scene, optics, roof, most):
    """Start a ray at the top, which may meet so many grains."""
    light = scene.light
    d = launched(light, uniform(state) if light.diffuse > 0.0 else 1.0)
    purse = Purse(0.0, math.inf if scene.rules.analog else FIRST_ROULETTE, 1.0)
    if roof is not None:
        return outside(state, aimed(d, purse, roof, most), scene, optics, roof)
    passed, beam = entered(state, d, 0, purse, scene, optics)
    fate = TRAVELS if passed else REFLECTED
    return Ray(fate, Flier(ORIGIN, ORIGIN, beam.d, NO_LEG, 0.0), beam, 0, 0, most)


@part
def risen(state, ray, scene, optics, length):
    """Return a ray that comes back from the ground by Lambert's law, or stays there.

    One that the sample's lower face sends down again is still below.  Among the grains that it may
    meet the ground counts as one.
    """
    purse, analog = ray.beam.purse, scene.rules.analog
    payment = paid(state, purse, 1.0, scene.ground, optics, analog, length)
    if not payment.alive:
        return ended(ray, TRANSMITTED)
    payment = played(state, payment.purse)
    if not payment.alive or ray.order == ray.most:
        return ended(ray, ABSORBED)
    d = lobe(UP, uniform(state), uniform(state))
    lowest = scene.layers.attenuation.size - 1
    passed, beam = entered(state, d, lowest, payment.purse, scene, optics)
    fate = TRAVELS if passed else BELOW
    return Ray(fate, turned(ray.flier, beam.d), beam, ray.legs, ray.order + 1, ray.most)


@entry
def batch(seed, work, scene, optics, exits, fields, room):
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
    most, faces = 2 * scene.layers.face.size, scene.layers.face.size
    for number in range(work[2]):
        start_stream(state, seed, work[0], work[1] + number)
        of_ray(notes, number)
        length[:] = 0.0
        roof = realised(state, fields, room)
        ray = launch(state, scene, optics, roof, work[3])
        while ray.fate == TRAVELS or ray.fate == BELOW:
            notes = room_for(notes, most)
            if ray.fate == TRAVELS:
                ray = follow(state, ray, scene, optics, length, notes, None, roof)
            else:
                if not scene.rules.analog:
                    note(notes, passage(faces - 1, False), ray.beam.purse.weight, length)
                ray = risen(state, ray, scene, optics, length)
        legs += ray.legs
        if ray.fate == LOST:
            return Told(legs, True, taken(notes))
        if ray.fate != ABSORBED:
            purse = ray.beam.purse
            record(
                exits[number], ray.fate == REFLECTED, ray.flier.place, ray.beam.d, purse.weight,
                ray.order,
            )  # fmt: skip
            write(exits[number], EXIT_LENGTH, length)
    return Told(legs, False, taken(notes))
