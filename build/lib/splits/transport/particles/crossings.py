"""Rays through surfaces of their own, to count what must not be: leaks and losses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import entry, part
from splits.transport.numerics.rng import start_stream, uniform
from splits.transport.numerics.vectors import UP, Vector, along, scaled
from splits.transport.optics.light import Light, launched
from splits.transport.particles.encounters import meet_face, reflect_diffusely
from splits.transport.rough.march import GONE, LOST, cleared, first_crossing, normal_of, tolerance
from splits.transport.rough.waves import draw_waves, relief_at, room_for

MOST_HITS = 50
CROSSINGS, LEAKS, LOSSES, LEGS, EVALUATIONS = range(5)


class Census(NamedTuple):
    """What was counted.

    Attributes
    ----------
    counts : int64[5]
        `CROSSINGS`; `LEAKS`, points of legs that are on the wrong side of the surface; `LOSSES`,
        rays that were lost; `LEGS`; `EVALUATIONS` of the surface in the search for crossings.
    hits : int64[MOST_HITS + 1]
        Rays by the number of their hits.
    """

    counts: np.ndarray
    hits: np.ndarray


class Walk(NamedTuple):
    """A ray above the surface, side 1, or below it, side −1."""

    place: Vector
    d: Vector
    side: float


@part
def _leaks(state, surface, walk, length):
    """Return how many of four points of a leg are on the wrong side of the surface."""
    found = 0
    for i in range(4):
        # Three anywhere, and one where a step too long at the end of the march would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        at = along(s, walk.d, walk.place)
        height = relief_at(surface.waves, at.x, at.y).height
        if walk.side * (at.z - height) < -4.0 * tolerance(surface, at, s):
            found += 1
    return found


@part
def _beyond_facet(state, walk, hit, index):
    """Return a walk after a facet, where it is reflected or refracted."""
    upward = normal_of(hit.slope)
    near, far = (1.0, index) if walk.side > 0.0 else (index, 1.0)
    meeting = meet_face(state, walk.d, None, scaled(walk.side, upward), near, far)
    side = -walk.side if meeting.passed else walk.side
    place = along(hit.distance, walk.d, walk.place)
    return Walk(place, cleared(meeting.d, scaled(side, upward)), side)


@part
def _count(state, surface, index, walk, counts):
    """Count along one ray, and return how many facets it hit."""
    hits = 0
    while hits < MOST_HITS:
        hit = first_crossing(surface, walk.place, walk.d, walk.side)
        counts[LEGS] += 1
        counts[EVALUATIONS] += hit.looks
        if hit.distance == LOST:
            counts[LOSSES] += 1
            break
        if hit.distance == GONE:
            rest = surface.reach - walk.side * walk.place.z
            if rest > 0.0 and walk.side * walk.d.z > 0.0:
                length = rest / (walk.side * walk.d.z)
                counts[LEAKS] += _leaks(state, surface, walk, length)
            if walk.side > 0.0:
                break
            place = Vector(walk.place.x, walk.place.y, -2.0 * surface.reach)
            walk = Walk(place, reflect_diffusely(state, UP, None).d, walk.side)
            continue
        counts[LEAKS] += _leaks(state, surface, walk, hit.distance)
        hits += 1
        walk = _beyond_facet(state, walk, hit, index)
    return hits


@entry
def crossings(seed, first, rays, fields, index, cos_incidence):
    """Send rays through surfaces of their own and count what must not be.

    Every ray comes from above, and is reflected or refracted at the facets that it meets until it
    leaves upwards or has had `MOST_HITS`.  One that leaves downwards comes back from below, as
    diffuse light does.

    Parameters
    ----------
    seed, first, rays : int
        Streams of the rays.
    fields : Fields
    index : float
        Refractive index below the surface, with 1 above.
    cos_incidence : float

    Returns
    -------
    Census
    """
    census = Census(np.zeros(5, dtype=np.int64), np.zeros(MOST_HITS + 1, dtype=np.int64))
    state = np.zeros(1, dtype=np.uint64)
    room = room_for(fields)
    d = launched(Light(cos_incidence, 0.0), 1.0)
    for ray in range(first, first + rays):
        start_stream(state, seed, 0, ray)
        surface = draw_waves(state, fields, room)
        walk = Walk(Vector(0.0, 0.0, surface.reach), d, 1.0)
        hits = _count(state, surface, index, walk, census.counts)
        census.counts[CROSSINGS] += hits
        census.hits[hits] += 1
    return census
