"""The scalar kernel: one ray at a time through a slab of grains, in double precision.

It repeats the trials of `splits.transport.flight` and `splits.transport.surface` until a ray is
done.  Between its two extended boundaries the slab reaches to infinity sideways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

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
from splits.transport.rng import from_table, pick, start_stream, uniform
from splits.transport.scene import (
    DRY_PORE,
    KEPT,
    LOBE,
    MAX_REJECTIONS,
    SKIPPED,
    WET_PORE,
)
from splits.transport.spheroid import Aim, Segment, Size, across
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

NO_LEG = Segment(ORIGIN, ORIGIN, -1.0)
"""In place of the leg travelled last, for a ray that has not travelled yet."""


ROUGH = Features(True, True, True, True, True, True, True)
SMOOTH = ROUGH._replace(faceted=None)
"""What surfaces of grains may have: the scalar kernel is compiled for everything."""


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
def aim_of(state):
    """Draw how a ray strikes a grain."""
    facing, azimuth, turn = uniform(state), uniform(state), uniform(state)
    return Aim(facing, azimuth, turn, uniform(state), uniform(state))


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
def find(state, flier, scene):
    """Draw the next grain on a ray, or find that the ray reaches a boundary first."""
    grains, slab = scene.grains, scene.slab
    space = Space(1.0 / grains.attenuation, -slab.depth, 0.0)
    fates = fates_of(scene.rules)
    candidate = candidate_of(state, grains)
    meeting = next_grain(flier, candidate.size, aim_of(state), uniform(state), space, fates, True)
    for _ in range(MAX_REJECTIONS):
        if meeting.placed:
            if meeting.fits or meeting.outside:
                return Found(candidate, meeting, False)
            # A trial refused for its axial position keeps type and shape, which made that likely.
            candidate = candidate_of(state, grains)
        flier = Flier(flier.place, flier.way, flier.d, flier.last, meeting.skipped)
        meeting = next_grain(flier, candidate.size, aim_of(state), uniform(state), space, fates, True)
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
    surface = smooth(d, grain, stand.side)
    choice, u = uniform(state), uniform(state)
    turn = rules.wrong_side != LOBE
    if roughness == 0.0:
        return outcome(d, stand, surface, media, u, turn, SMOOTH)
    lean, spread, azimuth = uniform(state), uniform(state), uniform(state)
    numbers = Numbers(choice, u, 0.0, lean, spread, azimuth)
    facet = rough(d, surface, roughness, numbers, stand.lobe, rules.facets, True)
    return outcome(d, stand, facet, media, u, turn, ROUGH)


@kernel
def walk(state, ray, found, scene, optics, length):
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    state : uint64[1]
    ray : Ray
        As it meets the grain.
    found : Found
    scene, optics
        See `splits.transport.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.

    Returns
    -------
    Ray
    """
    kind, size, roughness = found.candidate
    grain, d, purse, pore = found.meeting.entry.grain, ray.flier.d, ray.purse, ray.pore
    way = ORIGIN
    stand = Stand(0.0, 1.0, False, False)
    while True:
        media = media_of(state, stand, kind, pore, scene, optics)
        after = trial(state, d, stand, grain, roughness, media.contrast, scene.rules)
        if not after.done:
            pore = media.pore if after.to_lobe else pore
            stand = Stand(stand.layer, stand.side, after.to_lobe, after.passed)
            continue
        gone = goings(stand, after, float(scene.grains.layers[kind]), True)
        stand, d, pore = gone.stand, after.d, media.pore
        if gone.out:
            if not after.passed:
                pore = draw_pore(state, scene.slab.saturation)
            flier = Flier(ray.flier.place, way, d, ray.flier.last, 0.0)
            return Ray(TRAVELS, flier, pore, purse, ray.legs, ray.order)
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
            return Ray(ABSORBED, ray.flier, pore, purse, ray.legs, ray.order)


@kernel
def flown(state, ray, found, optics, scene, length):
    """Return a ray at the grain that it has found, or at the boundary that comes before."""
    flier, slab, pore = ray.flier, scene.slab, ray.pore
    if found.lost:
        return Ray(LOST, flier, pore, ray.purse, ray.legs, ray.order)
    leg, height = found.meeting.leg, found.meeting.height
    if found.meeting.outside:
        arrival = to_boundary(flier, Space(0.0, -slab.depth, 0.0))
        leg, height = arrival.leg, arrival.place.z
    payment = paid(state, ray.purse, leg, pore, optics, scene.rules.analog, length)
    fate = TRAVELS if payment.alive else ABSORBED
    last = Segment(ORIGIN, flier.d, leg)
    start = Vector(
        flier.place.x + flier.way.x, flier.place.y + flier.way.y, flier.place.z + flier.way.z
    )
    place = along(leg, flier.d, start)
    flier = Flier(Vector(place.x, place.y, height), ORIGIN, flier.d, last, 0.0)
    return Ray(fate, flier, pore, payment.purse, ray.legs, ray.order)


@kernel
def at_boundary(state, ray, scene, optics):
    """Let a ray leave through the boundary that it stands at, or send it back."""
    flier, pore = ray.flier, ray.pore
    crossing = Crossing(True, flier.d)
    if pore == WET_PORE and scene.rules.boundary_fresnel:
        far = Index(optics.n[DRY_PORE], 0.0)
        near = Index(optics.n[pore], optics.k[pore])
        crossing = meet(flier.d, facing(flier.d), near, far, uniform(state))
    fate = TRAVELS
    if crossing.passed:
        fate = REFLECTED if crossing.d.z > 0.0 else TRANSMITTED
    flier = Flier(flier.place, flier.way, crossing.d, flier.last, 0.0)
    return Ray(fate, flier, pore, ray.purse, ray.legs, ray.order)


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
    while True:
        played = roulette(ray.purse, 0.0, True)
        while ray.purse.depth > ray.purse.limit:
            played = roulette(ray.purse, uniform(state), True)
            ray = Ray(ray.fate, ray.flier, ray.pore, played.purse, ray.legs, ray.order)
            if played.ended:
                return ended(ray, ABSORBED)
        ray = Ray(TRAVELS, ray.flier, ray.pore, ray.purse, ray.legs + 1, ray.order)
        found = find(state, ray.flier, scene)
        ray = flown(state, ray, found, optics, scene, length)
        if ray.fate != TRAVELS:
            return ray
        if found.meeting.outside:
            ray = at_boundary(state, ray, scene, optics)
            if ray.fate != TRAVELS:
                return ray
            continue
        if ray.order == most:
            return ended(ray, ABSORBED)
        ray = Ray(TRAVELS, ray.flier, ray.pore, ray.purse, ray.legs, ray.order + 1)
        ray = walk(state, ray, found, scene, optics, length)
        if ray.fate != TRAVELS:
            return ray
        if window is not None:
            flier = ray.flier
            z = min(max(flier.place.z + flier.way.z, -scene.slab.depth), 0.0)
            if left_window(window, z, scene.slab.depth, ray.purse):
                return ray


@kernel
def ended(ray, fate):
    """Return a ray at its end."""
    return Ray(fate, ray.flier, ray.pore, ray.purse, ray.legs, ray.order)


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
