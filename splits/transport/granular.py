"""The scalar kernel: one ray at a time through layers of grains, in double precision.

It repeats the trials of `splits.transport.flight` and `splits.transport.surface` until a ray is
done.  Between their extended faces layers reach to infinity sideways.  Below them there may be a
ground; what it keeps of a ray's light is noted as the ray meets it.

Between layers nothing optical stands.  A flight spends one exponential distance, layer by layer,
and a grain belongs to the layer in which the ray meets it; the pore of a leg is drawn once, so it
changes at a face between layers only where their saturations differ.  Cutting a medium in two
therefore changes nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.faces import facing, meet
from splits.transport.features import EVERYTHING
from splits.transport.flight import (
    FIRST_ROULETTE,
    Fates,
    Flier,
    Purse,
    next_grain,
    roulette,
    to_boundary,
)
from splits.transport.jit import entry, kernel
from splits.transport.light import launched
from splits.transport.notes import has_room, no_notes, note, of_ray, passage, room_for, taken
from splits.transport.phase import scattered
from splits.transport.rng import start_stream, uniform
from splits.transport.scalar import (
    NO_LEG,
    Beam,
    Entered,
    Found,
    Paid,
    Ray,
    aim_of,
    candidate_of,
    fates_of,
    index_of,
    paid,
    phase_of,
    pore_of,
    space_of,
)
from splits.transport.scene import GRAINS, MAX_REJECTIONS, NO_GROUND
from splits.transport.spheroid import Segment
from splits.transport.tally import (
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
from splits.transport.vectors import ORIGIN, UP, Vector, lobe
from splits.transport.walk import walk


class Window(NamedTuple):
    """Bounds on what a ray is worth, weight · exp(κ·depth) (see `splits.transport.deep`).

    Attributes
    ----------
    weight : float
        Of the ray, absorption not counted.
    kappa : float
        1/m.
    lower, upper : float
    profile : float64[2, slices]
        For equal slices of the depth, number and total weight of the legs that began there,
        advanced in place.
    """

    weight: float
    kappa: float
    lower: float
    upper: float
    profile: np.ndarray


@kernel
def left_window(window, z, bottom, purse):
    """Tell whether a ray's worth lies outside its window, and note where it is."""
    slices = window.profile.shape[1]
    place = min(int(z / bottom * slices), slices - 1)
    window.profile[0, place] += 1.0
    window.profile[1, place] += window.weight * math.exp(-purse.depth)
    worth = window.weight * math.exp(-purse.depth - window.kappa * z)
    return worth < window.lower or worth > window.upper


@kernel
def beyond(layers, layer, d):
    """Return the layer behind the face that a ray along d has ahead; −1 or their number outside."""
    return layer - 1 if d.z > 0.0 else layer + 1


@kernel
def alike(layers, optics, one, other, u):
    """Tell whether the pores of two layers are the same to light."""
    a = index_of(optics, pore_of(layers, one, u))
    b = index_of(optics, pore_of(layers, other, u))
    return a.n == b.n and a.k == b.k


@kernel
def pass_face(notes, scene, layer, upward, purse, length):
    """Note a ray that passes from a layer into the next one, where somebody listens."""
    if notes is not None and scene.listens:
        note(notes, passage(layer if upward else layer + 1, upward), purse.weight, length)


@kernel
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


@kernel
def find(state, flier, beam, scene, optics):
    """Draw the next grain on a ray, or find the face that it reaches first.

    A grain that does not fit is drawn again from where the ray set out, or from where the last one
    was left out.
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
        meeting = next_grain(ahead, candidate.size, aim, uniform(state), space, fates, EVERYTHING)
        if meeting.fits:
            return Found(candidate, meeting, layer, False)
        if meeting.outside:
            other = beyond(layers, layer, flier.d)
            inside = 0 <= other < layers.attenuation.size
            if not inside or not alike(layers, optics, layer, other, beam.u):
                return Found(candidate, meeting, layer, False)
            layer = other
            reach = to_boundary(flier, space).leg
            ahead = Flier(flier.place, flier.way, flier.d, flier.last, reach)
            continue
        if meeting.skipped == meeting.leg:
            start = layer
            flier = Flier(flier.place, flier.way, flier.d, flier.last, meeting.skipped)
        layer = start
        ahead = flier
        tries += 1
        if tries == MAX_REJECTIONS:
            return Found(candidate, meeting, layer, True)


@kernel
def arrived(flier, found, space):
    """Return a ray at the grain that it meets, or at the face that comes before."""
    leg, height = found.meeting.leg, found.meeting.height
    if found.meeting.outside:
        arrival = to_boundary(flier, space)
        leg, height = arrival.leg, arrival.place.z
    x = flier.place.x + flier.way.x + leg * flier.d.x
    y = flier.place.y + flier.way.y + leg * flier.d.y
    return Flier(Vector(x, y, height), ORIGIN, flier.d, Segment(ORIGIN, flier.d, leg), 0.0)


@kernel
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


@kernel
def at_face(state, beam, scene, optics):
    """Let a ray pass the face that it stands at, or send it back; see `faces.Crossing`."""
    layers = scene.layers
    other = beyond(layers, beam.layer, beam.d)
    near = index_of(optics, pore_of(layers, beam.layer, beam.u))
    far = index_of(optics, layers.pore[beam.layer])
    if 0 <= other < layers.attenuation.size:
        far = index_of(optics, pore_of(layers, other, beam.u))
    if not scene.rules.boundary_fresnel:
        far = near
    return meet(beam.d, facing(beam.d), near, far, uniform(state))


@kernel
def scattered_by_particle(state, beam, scene):
    """Return the beam that a particle scatters, if it is not absorbed there."""
    row = scene.layers.particles[beam.layer]
    albedo, purse = scene.particles.albedo[row], beam.purse
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return Entered(False, beam)
    if not scene.rules.analog:
        # Roulette must hear of it; all wavelengths lose as much.
        purse = Purse(purse.depth - math.log(albedo), purse.limit, purse.weight * albedo)
    d = scattered(state, phase_of(scene.particles, row), beam.d)
    return Entered(True, Beam(d, beam.layer, beam.u, purse))


@kernel
def played(state, purse):
    """Let a ray play roulette as often as it is due, see `splits.transport.flight`."""
    alive = True
    while alive and purse.depth > purse.limit:
        result = roulette(purse, uniform(state), True)
        purse, alive = result.purse, not result.ended
    return Paid(purse, alive)


@kernel
def follow(state, ray, scene, optics, length, notes, window, most):
    """Follow a ray until it leaves the scene or is absorbed, or until its worth wants a decision.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    ray : Ray
    scene, optics
        See `splits.transport.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place.
    notes : Notes or None
        Taken where rays pass faces between layers; None where nobody listens, at no cost.
    window : Window or None
        None asks for no decisions, at no cost.
    most : int
        Grains met after which a ray counts as absorbed.

    Returns
    -------
    Ray
        Its fate `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `BELOW`, `LOST`, or `TRAVELS` where the
        window is left, or where there might not be room for the next leg's notes.
    """
    flier, beam, legs, order, fate = ray.flier, ray.beam, ray.legs, ray.order, TRAVELS
    layers = scene.layers
    while fate == TRAVELS:
        if notes is not None and not has_room(notes, 2 * layers.face.size):
            break
        payment = played(state, beam.purse)
        if not payment.alive:
            fate = ABSORBED
            break
        legs += 1
        beam = Beam(beam.d, beam.layer, beam.u, payment.purse)
        flier, beam = settled(flier, beam, scene, optics, length, notes)
        found = find(state, flier, beam, scene, optics)
        if found.lost:
            fate = LOST
            break
        flier = arrived(flier, found, space_of(layers, found.layer))
        leg = Segment(flier.place, beam.d, flier.last.length)
        payment = travelled(state, beam, found, leg, scene, optics, length, notes)
        beam = Beam(beam.d, found.layer, beam.u, payment.purse)
        if not payment.alive:
            fate = ABSORBED
        elif found.meeting.outside:
            crossing = at_face(state, beam, scene, optics)
            other = beyond(layers, beam.layer, beam.d)
            layer = other if crossing.passed else beam.layer
            if layer < 0 or layer == layers.attenuation.size:
                below = TRANSMITTED if scene.ground == NO_GROUND else BELOW
                fate = REFLECTED if layer < 0 else below
                layer = beam.layer
            elif layer != beam.layer:
                pass_face(notes, scene, beam.layer, layer < beam.layer, beam.purse, length)
            beam = Beam(crossing.d, layer, beam.u, beam.purse)
        elif order == most:
            fate = ABSORBED
        elif layers.particles[beam.layer] != GRAINS:
            order += 1
            turned = scattered_by_particle(state, beam, scene)
            beam = turned.beam
            fate = TRAVELS if turned.passed else ABSORBED
        else:
            order += 1
            walked = walk(state, beam, found, scene, optics, length)
            beam = walked.beam
            fate = TRAVELS if walked.alive else ABSORBED
            flier = Flier(flier.place, walked.way, beam.d, flier.last, 0.0)
        flier = Flier(flier.place, flier.way, beam.d, flier.last, 0.0)
        if window is not None and fate == TRAVELS and not found.meeting.outside:
            bottom = layers.face[layers.face.size - 1]
            z = min(max(flier.place.z + flier.way.z, bottom), 0.0)
            if left_window(window, z, bottom, beam.purse):
                break
    return Ray(fate, flier, beam, legs, order)


@kernel
def entered(state, d, layer, purse, scene, optics):
    """Return the beam of a ray that comes from outside to a layer, if that lets it in.

    Its pore there is drawn first: the boundary of a wet one may reflect it at once.
    """
    layers = scene.layers
    u = uniform(state)
    near, far = index_of(optics, layers.pore[layer]), index_of(optics, pore_of(layers, layer, u))
    if not scene.rules.boundary_fresnel:
        far = near
    crossing = meet(d, facing(d), near, far, uniform(state))
    return Entered(crossing.passed, Beam(crossing.d, layer, u, purse))


@kernel
def launch(state, scene, optics):
    """Start a ray at the top."""
    light = scene.light
    d = launched(light, uniform(state) if light.diffuse > 0.0 else 1.0)
    limit = math.inf if scene.rules.analog else FIRST_ROULETTE
    passed, beam = entered(state, d, 0, Purse(0.0, limit, 1.0), scene, optics)
    fate = TRAVELS if passed else REFLECTED
    return Ray(fate, Flier(ORIGIN, ORIGIN, beam.d, NO_LEG, 0.0), beam, 0, 0)


@kernel
def risen(state, ray, scene, optics, length, most):
    """Return a ray that comes back from the ground by Lambert's law, or stays there.

    One that the sample's lower face sends down again is still below.  Among the grains met, of
    which there may be `most`, the ground counts as one.
    """
    purse, analog = ray.beam.purse, scene.rules.analog
    payment = paid(state, purse, 1.0, scene.ground, optics, analog, length)
    if not payment.alive:
        return Ray(TRANSMITTED, ray.flier, ray.beam, ray.legs, ray.order)
    payment = played(state, payment.purse)
    if not payment.alive or ray.order == most:
        return Ray(ABSORBED, ray.flier, ray.beam, ray.legs, ray.order)
    d = lobe(UP, uniform(state), uniform(state))
    lowest = scene.layers.attenuation.size - 1
    passed, beam = entered(state, d, lowest, payment.purse, scene, optics)
    fate = TRAVELS if passed else BELOW
    flier = Flier(ray.flier.place, ray.flier.way, beam.d, ray.flier.last, 0.0)
    return Ray(fate, flier, beam, ray.legs, ray.order + 1)


@entry
def batch(seed, work, scene, optics, exits):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed : int
    work : int64[4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same whoever traces it.
    scene, optics
        See `splits.transport.scene`.
    exits : float64[rays, columns]
        A row for each ray, see `splits.transport.tally`; must come from `exit_rows`.

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
        ray = launch(state, scene, optics)
        while ray.fate == TRAVELS or ray.fate == BELOW:
            notes = room_for(notes, most)
            if ray.fate == TRAVELS:
                ray = follow(state, ray, scene, optics, length, notes, None, work[3])
            else:
                if not scene.rules.analog:
                    note(notes, passage(faces - 1, False), ray.beam.purse.weight, length)
                ray = risen(state, ray, scene, optics, length, work[3])
        legs += ray.legs
        if ray.fate == LOST:
            return Told(legs, True, taken(notes))
        if ray.fate != ABSORBED:
            purse = ray.beam.purse
            record(
                exits[number], ray.fate == REFLECTED, ray.flier.place, ray.beam.d, purse.weight,
                ray.order,
            )  # fmt: skip
            exits[number, EXIT_LENGTH : EXIT_LENGTH + length.size] = length
    return Told(legs, False, taken(notes))
