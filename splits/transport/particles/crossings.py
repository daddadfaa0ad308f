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
    rays_by_hits: np.ndarray


class Walk(NamedTuple):
    """A ray above the surface, side 1, or below it, side −1."""

    position: Vector
    direction: Vector
    side: float


@part
def _leaks(state, surface, ray, length):
    """Return how many of four points of a leg are on the wrong side of the surface."""
    found = 0
    for i in range(4):
        # Three anywhere, and one where a step too long at the end of the march would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        at = along(s, ray.direction, ray.position)
        height = relief_at(surface.waves, at.x, at.y).height
        if ray.side * (at.z - height) < -4.0 * tolerance(surface, at, s):
            found += 1
    return found


@part
def _beyond_facet(state, ray, hit, refractive_index):
    """Return a walk after a facet, where it is reflected or refracted."""
    upward = normal_of(hit.slope)
    near, far = (1.0, refractive_index) if ray.side > 0.0 else (refractive_index, 1.0)
    meeting = meet_face(state, ray.direction, None, scaled(ray.side, upward), near, far)
    side = -ray.side if meeting.transmitted else ray.side
    place = along(hit.distance, ray.direction, ray.position)
    return Walk(place, cleared(meeting.direction, scaled(side, upward)), side)


@part
def _count(state, surface, refractive_index, ray, counts):
    """Count along one ray, and return how many facets it hit."""
    hits = 0
    while hits < MOST_HITS:
        hit = first_crossing(surface, ray.position, ray.direction, ray.side)
        counts[LEGS] += 1
        counts[EVALUATIONS] += hit.n_evaluations
        if hit.distance == LOST:
            counts[LOSSES] += 1
            break
        if hit.distance == GONE:
            rest = surface.max_height - ray.side * ray.position.z
            if rest > 0.0 and ray.side * ray.direction.z > 0.0:
                length = rest / (ray.side * ray.direction.z)
                counts[LEAKS] += _leaks(state, surface, ray, length)
            if ray.side > 0.0:
                break
            place = Vector(ray.position.x, ray.position.y, -2.0 * surface.max_height)
            ray = Walk(place, reflect_diffusely(state, UP, None).direction, ray.side)
            continue
        counts[LEAKS] += _leaks(state, surface, ray, hit.distance)
        hits += 1
        ray = _beyond_facet(state, ray, hit, refractive_index)
    return hits


@entry
def crossings(seed, first_ray, n_rays, fields, refractive_index, cos_incidence):
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
    for ray in range(first_ray, first_ray + n_rays):
        start_stream(state, seed, 0, ray)
        surface = draw_waves(state, fields, room)
        walk = Walk(Vector(0.0, 0.0, surface.max_height), d, 1.0)
        hits = _count(state, surface, refractive_index, walk, census.counts)
        census.counts[CROSSINGS] += hits
        census.rays_by_hits[hits] += 1
    return census
