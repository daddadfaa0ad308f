"""The scalar kernel: one ray at a time through a slab of grains, in double precision.

It repeats the trials of `splits.transport.flight` and `splits.transport.surface` until a ray is
done.  Between its two extended boundaries the slab reaches to infinity sideways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.elementary import Angle
from splits.transport.faces import Crossing, Index, facing, meet
from splits.transport.features import Features
from splits.transport.flight import (
    FIRST_ROULETTE,
    Fates,
    Flier,
    Meeting,
    Purse,
    Space,
    next_grain,
    roulette,
    to_boundary,
)
from splits.transport.jit import entry, kernel
from splits.transport.light import launched
from splits.transport.rng import from_table, half_normal, pick, start_stream, uniform, unit_circle
from splits.transport.scene import (
    DRY_PORE,
    KEPT,
    LOBE,
    MAX_REJECTIONS,
    SKIPPED,
    WET_PORE,
)
from splits.transport.spheroid import Aim, Segment, Size, across, placed
from splits.transport.surface import (
    Contrast,
    Numbers,
    Stand,
    contrast,
    film,
    goings,
    outcome,
    rough,
)
from splits.transport.surface import facing as smooth
from splits.transport.tally import EXIT_LENGTH, Exit, record
from splits.transport.vectors import ORIGIN, Vector, along

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain was found that fits; never expected, counted so that it cannot pass unseen."""
TRAVELS = 4

FORWARD = Angle(1.0, 0.0)

NO_LEG = Segment(ORIGIN, ORIGIN, -1.0)
"""In place of the leg travelled last, for a ray that has not travelled yet."""


EVERYTHING = Features(*[True] * len(Features._fields))
"""What the scalar kernel is compiled for."""


class Ray(NamedTuple):
    """A ray between grains, or at its end.

    Attributes
    ----------
    fate : int
        `TRAVELS`, or how it ended.
    flier : Flier
    pore : int
        Material of its leg.
    purse : Purse
    legs, order : int
        Legs through the pore space, which is what the ray cost, and grains met.
    """

    fate: int
    flier: Flier
    pore: int
    purse: Purse
    legs: int
    order: int


class Candidate(NamedTuple):
    """A grain drawn, but not yet met: its type, size and half its facetness."""

    kind: int
    size: Size
    roughness: float


class Found(NamedTuple):
    """What a ray meets next; `lost` where nothing was found."""

    candidate: Candidate
    meeting: Meeting
    lost: bool


class Paid(NamedTuple):
    """A purse after a leg, and whether the ray survived it."""

    purse: Purse
    alive: bool


class Beam(NamedTuple):
    """What a ray carries: direction, material of its leg, account of the roulette."""

    d: Vector
    pore: int
    purse: Purse


class Walk(NamedTuple):
    """A ray after a grain: whether it survived, its way from entry to exit (m), what it carries."""

    alive: bool
    way: Vector
    beam: Beam


class Sides(NamedTuple):
    """The media on both sides of a surface, and the pore on the outer side."""

    contrast: Contrast
    pore: int


class Spent(NamedTuple):
    """Legs that a batch traced, and whether a ray found no grain that fits and ended it."""

    legs: int
    lost: bool


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
def left_window(window, z, depth, purse):
    """Tell whether a ray's worth lies outside its window, and note where it is."""
    slices = window.profile.shape[1]
    place = min(int(-z / depth * slices), slices - 1)
    window.profile[0, place] += 1.0
    window.profile[1, place] += window.weight * math.exp(-purse.depth)
    worth = window.weight * math.exp(-purse.depth - window.kappa * z)
    return worth < window.lower or worth > window.upper


@kernel
def paid(state, purse, leg, material, optics, analog, length):
    """Take a leg through a material, and tell whether the ray goes on.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability to
    pass.  Weighted rays add the leg to `length` (float64[materials], m), and end only by roulette.
    """
    length[material] += leg
    depth = optics.absorption[material] * leg
    if analog:
        return Paid(purse, depth == 0.0 or uniform(state) < math.exp(-depth))
    return Paid(Purse(purse.depth + depth, purse.limit, purse.weight), True)


@kernel
def draw_pore(state, saturation):
    """Return the material of the pore space for the next leg (SPLITS 4.3.2)."""
    if saturation > 0.0 and uniform(state) < saturation:
        return WET_PORE
    return DRY_PORE


@kernel
def candidate_of(state, grains):
    """Draw type, size, shape and roughness of a grain."""
    kind = pick(grains.share, uniform(state)) if grains.share.size > 1 else 0
    major = 1.0 / from_table(grains.curvature, kind, uniform(state))
    sphericity = from_table(grains.sphericity, kind, uniform(state))
    roughness = 0.5 * from_table(grains.facetness, kind, uniform(state))
    return Candidate(kind, Size(major, 1.0 - sphericity * sphericity), roughness)


@kernel
def aim_of(state, flattening):
    """Draw how a ray strikes a grain."""
    while True:
        aim = Aim(uniform(state), FORWARD, FORWARD, uniform(state), uniform(state))
        if placed(aim, flattening):
            return Aim(aim.facing, unit_circle(state), unit_circle(state), aim.axial, aim.area)


@kernel
def fates_of(rules):
    """Return what becomes of grains that do not fit."""
    return Fates(
        rules.entry,
        rules.on_last_leg != KEPT,
        rules.across_boundary != KEPT,
        rules.on_last_leg == SKIPPED,
        rules.across_boundary == SKIPPED,
    )


@kernel
def find(state, flier, scene, space):
    """Draw the next grain on a ray, or find that the ray reaches a boundary first."""
    grains = scene.grains
    fates = fates_of(scene.rules)
    for _ in range(MAX_REJECTIONS):
        candidate = candidate_of(state, grains)
        aim = aim_of(state, candidate.size.flattening)
        meeting = next_grain(flier, candidate.size, aim, uniform(state), space, fates, True)
        if meeting.fits or meeting.outside:
            return Found(candidate, meeting, False)
        flier = Flier(flier.place, flier.way, flier.d, flier.last, meeting.skipped)
    return Found(candidate, meeting, True)


@kernel
def media_of(state, stand, kind, pore, scene, optics):
    """Return the media that a ray at a grain has on both sides, and the pore behind the surface."""
    layer, beyond = int(stand.layer), int(stand.layer + stand.side)
    materials = scene.grains.material
    drawn = pore
    # On its way into a lobe a ray keeps the pore that let it through.
    if beyond == 0 and not stand.lobe:
        drawn = draw_pore(state, scene.slab.saturation)
    here = pore if layer == 0 else materials[kind, layer - 1]
    there = drawn if beyond == 0 else materials[kind, beyond - 1]
    near, far = Index(optics.n[here], optics.k[here]), Index(optics.n[there], optics.k[there])
    return Sides(contrast(near, far), drawn)


@kernel
def trial(state, d, stand, grain, roughness, media, rules):
    """Return what one trial at a grain's surface leads to."""
    facet = smooth(d, grain, stand.side)
    u = uniform(state)
    while roughness > 0.0:
        azimuth = unit_circle(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        numbers = Numbers(uniform(state), u, 0.0, half_normal(state), azimuth)
        found = rough(d, facet, roughness, numbers, stand.lobe, rules.facets, True)
        if found.accepted or stand.lobe:
            facet = found
            break
    return outcome(d, stand, facet, media, u, rules.wrong_side != LOBE, EVERYTHING)


@kernel
def walk(state, ray, found, scene, optics, length):
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    state : uint64[1]
    ray : Beam
        As it meets the grain.
    found : Found
    scene, optics
        See `splits.transport.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.

    Returns
    -------
    Walk
    """
    kind, size, roughness = found.candidate
    grain, d, pore, purse = found.meeting.entry.grain, ray.d, ray.pore, ray.purse
    way = ORIGIN
    stand = Stand(0.0, 1.0, False, False)
    while True:
        media = media_of(state, stand, kind, pore, scene, optics)
        after = trial(state, d, stand, grain, roughness, media.contrast, scene.rules)
        if not after.done:
            pore = media.pore
            stand = Stand(stand.layer, stand.side, after.to_lobe, after.passed)
            continue
        gone = goings(stand, after, float(scene.grains.layers[kind]), True)
        stand, d, pore = gone.stand, after.d, media.pore
        if gone.out:
            if not after.passed:
                pore = draw_pore(state, scene.slab.saturation)
            return Walk(True, way, Beam(d, pore, purse))
        layer = int(stand.layer) - 1
        if gone.core:
            leg, grain = across(grain, d)
            way = along(leg, d, way)
        else:
            leg = film(2.0 * size.major * scene.grains.thickness[kind, layer], after, True)
        material = scene.grains.material[kind, layer]
        payment = paid(state, purse, leg, material, optics, scene.rules.analog, length)
        purse = payment.purse
        if not payment.alive:
            return Walk(False, way, Beam(d, pore, purse))


@kernel
def arrived(flier, meeting, space):
    """Return a ray at the grain that it meets, or at the boundary that comes before."""
    leg, height = meeting.leg, meeting.height
    if meeting.outside:
        arrival = to_boundary(flier, space)
        leg, height = arrival.leg, arrival.place.z
    x = flier.place.x + flier.way.x + leg * flier.d.x
    y = flier.place.y + flier.way.y + leg * flier.d.y
    return Flier(Vector(x, y, height), ORIGIN, flier.d, Segment(ORIGIN, flier.d, leg), 0.0)


@kernel
def through_face(state, beam, scene, optics):
    """Let a ray pass the boundary that it stands at, or send it back."""
    if beam.pore != WET_PORE or not scene.rules.boundary_fresnel:
        return Crossing(True, beam.d)
    near, far = Index(optics.n[beam.pore], optics.k[beam.pore]), Index(optics.n[DRY_PORE], 0.0)
    return meet(beam.d, facing(beam.d), near, far, uniform(state))


@kernel
def follow(state, ray, scene, optics, length, window, most):
    """Follow a ray until it leaves the slab or is absorbed, or until its worth wants a decision.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    ray : Ray
    scene, optics
        See `splits.transport.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place.
    window : Window or None
        None asks for no decisions, at no cost.
    most : int
        Grains met after which a ray counts as absorbed.

    Returns
    -------
    Ray
        Its fate `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `LOST`, or `TRAVELS` where the window is
        left.
    """
    flier, beam = ray.flier, Beam(ray.flier.d, ray.pore, ray.purse)
    legs, order, fate = ray.legs, ray.order, TRAVELS
    space = Space(1.0 / scene.grains.attenuation, -scene.slab.depth, 0.0)
    while fate == TRAVELS:
        purse = beam.purse
        while purse.depth > purse.limit and fate == TRAVELS:
            played = roulette(purse, uniform(state), True)
            purse = played.purse
            fate = ABSORBED if played.ended else TRAVELS
        if fate == ABSORBED:
            break
        legs += 1
        found = find(state, flier, scene, space)
        if found.lost:
            fate = LOST
            break
        flier = arrived(flier, found.meeting, space)
        payment = paid(
            state, purse, flier.last.length, beam.pore, optics, scene.rules.analog, length
        )
        beam = Beam(beam.d, beam.pore, payment.purse)
        if not payment.alive:
            fate = ABSORBED
        elif found.meeting.outside:
            crossing = through_face(state, beam, scene, optics)
            beam = Beam(crossing.d, beam.pore, beam.purse)
            if crossing.passed:
                fate = REFLECTED if crossing.d.z > 0.0 else TRANSMITTED
        elif order == most:
            fate = ABSORBED
        else:
            order += 1
            walked = walk(state, beam, found, scene, optics, length)
            beam = walked.beam
            fate = TRAVELS if walked.alive else ABSORBED
            flier = Flier(flier.place, walked.way, beam.d, flier.last, 0.0)
        flier = Flier(flier.place, flier.way, beam.d, flier.last, 0.0)
        if window is not None and fate == TRAVELS and not found.meeting.outside:
            z = min(max(flier.place.z + flier.way.z, space.low), space.high)
            if left_window(window, z, scene.slab.depth, beam.purse):
                break
    return Ray(fate, flier, beam.pore, beam.purse, legs, order)


@kernel
def launch(state, scene, optics):
    """Start a ray at the slab's top; the boundary of a wet pore may reflect it at once."""
    rules, light = scene.rules, scene.light
    d = launched(light, uniform(state) if light.diffuse > 0.0 else 1.0)
    pore = draw_pore(state, scene.slab.saturation)
    fate = TRAVELS
    if pore == WET_PORE and rules.boundary_fresnel:
        near, far = Index(optics.n[DRY_PORE], 0.0), Index(optics.n[pore], optics.k[pore])
        crossing = meet(d, facing(d), near, far, uniform(state))
        d = crossing.d
        fate = TRAVELS if crossing.passed else REFLECTED
    flier = Flier(ORIGIN, ORIGIN, d, NO_LEG, 0.0)
    limit = math.inf if rules.analog else FIRST_ROULETTE
    return Ray(fate, flier, pore, Purse(0.0, limit, 1.0), 0, 0)


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
    Spent
    """
    legs = 0
    length = np.zeros(optics.n.size)
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[2]):
        start_stream(state, seed, work[0], work[1] + number)
        length[:] = 0.0
        ray = launch(state, scene, optics)
        if ray.fate == TRAVELS:
            ray = follow(state, ray, scene, optics, length, None, work[3])
        legs += ray.legs
        if ray.fate == LOST:
            return Spent(legs, True)
        if ray.fate != ABSORBED:
            flier = ray.flier
            left = Exit(ray.fate == REFLECTED, flier.place, flier.d, ray.purse.weight, ray.order)
            record(exits[number], left)
            exits[number, EXIT_LENGTH : EXIT_LENGTH + length.size] = length
    return Spent(legs, False)
