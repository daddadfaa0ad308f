"""Rays through surfaces of their own, to count what must not be: leaks and losses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_only
from splits.kernels.math.rng import start_stream, uniform
from splits.kernels.math.vectors import UP, Vector, add_scaled, scale
from splits.kernels.optics.source import Source, sample_source_direction
from splits.kernels.particle_layer.scattering import (
    reflect_or_refract_ray,
    sample_lambertian_reflection,
)
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    compute_height_tolerance,
    compute_normal_from_slope,
    find_first_intersection,
    nudge_off_surface,
)
from splits.kernels.rough_surface.realization import (
    allocate_realization,
    compute_height_and_slope,
    sample_realization,
)

MAX_HITS = 50
INTERSECTIONS, LEAKS, LOST_RAYS, SEGMENTS, EVALUATIONS = range(5)


class LeakCount(NamedTuple):
    """What was counted.

    Attributes
    ----------
    counts : int64[5]
        `INTERSECTIONS`; `LEAKS`, points of legs that are on the wrong side of the surface; `LOST_RAYS`,
        rays that were lost; `SEGMENTS`; `EVALUATIONS` of the surface in the search for crossings.
    rays_by_hits : int64[MOST_HITS + 1]
        Rays by the number of their hits.
    """

    counts: np.ndarray
    rays_by_hits: np.ndarray


class SurfaceRay(NamedTuple):
    """A ray above the surface, side 1, or below it, side −1."""

    position: Vector
    direction: Vector
    side: float


@inline_only
def _count_leaks(state, surface, ray, length):
    """Return how many of four points of a leg are on the wrong side of the surface."""
    found = 0
    for i in range(4):
        # Three anywhere, and one where a step too long at the end of the march would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        at = add_scaled(s, ray.direction, ray.position)
        height = compute_height_and_slope(surface.waves, at.x, at.y).height
        if ray.side * (at.z - height) < -4.0 * compute_height_tolerance(surface, at, s):
            found += 1
    return found


@inline_only
def _scatter_at_facet(state, ray, hit, refractive_index):
    """Return a walk after a facet, where it is reflected or refracted."""
    upward = compute_normal_from_slope(hit.slope)
    near, far = (1.0, refractive_index) if ray.side > 0.0 else (refractive_index, 1.0)
    meeting = reflect_or_refract_ray(state, ray.direction, None, scale(ray.side, upward), near, far)
    side = -ray.side if meeting.transmitted else ray.side
    place = add_scaled(hit.distance, ray.direction, ray.position)
    return SurfaceRay(place, nudge_off_surface(meeting.direction, scale(side, upward)), side)


@inline_only
def _trace_ray(state, surface, refractive_index, ray, counts):
    """Count along one ray, and return how many facets it hit."""
    hits = 0
    while hits < MAX_HITS:
        hit = find_first_intersection(surface, ray.position, ray.direction, ray.side)
        counts[SEGMENTS] += 1
        counts[EVALUATIONS] += hit.n_evaluations
        if hit.distance == STEP_LIMIT_REACHED:
            counts[LOST_RAYS] += 1
            break
        if hit.distance == NO_HIT:
            rest = surface.max_height - ray.side * ray.position.z
            if rest > 0.0 and ray.side * ray.direction.z > 0.0:
                length = rest / (ray.side * ray.direction.z)
                counts[LEAKS] += _count_leaks(state, surface, ray, length)
            if ray.side > 0.0:
                break
            place = Vector(ray.position.x, ray.position.y, -2.0 * surface.max_height)
            ray = SurfaceRay(
                place, sample_lambertian_reflection(state, UP, None).direction, ray.side
            )
            continue
        counts[LEAKS] += _count_leaks(state, surface, ray, hit.distance)
        hits += 1
        ray = _scatter_at_facet(state, ray, hit, refractive_index)
    return hits


@entry_point
def count_leaks(seed, first_ray, n_rays, fields, refractive_index, cos_incidence):
    """Send rays through surfaces of their own and count what must not be.

    Every ray comes from above, and is reflected or refracted at the facets that it meets until it
    leaves upwards or has had `MAX_HITS`.  One that leaves downwards comes back from below, as
    diffuse light does.

    Parameters
    ----------
    seed, first_ray, n_rays : int
        Streams of the rays.
    fields : HeightFields
    refractive_index : float
        Refractive index below the surface, with 1 above.
    cos_incidence : float

    Returns
    -------
    Census
    """
    census = LeakCount(np.zeros(5, dtype=np.int64), np.zeros(MAX_HITS + 1, dtype=np.int64))
    state = np.zeros(1, dtype=np.uint64)
    room = allocate_realization(fields)
    d = sample_source_direction(Source(cos_incidence, 0.0), 1.0)
    for ray in range(first_ray, first_ray + n_rays):
        start_stream(state, seed, 0, ray)
        surface = sample_realization(state, fields, room)
        walk = SurfaceRay(Vector(0.0, 0.0, surface.max_height), d, 1.0)
        hits = _trace_ray(state, surface, refractive_index, walk, census.counts)
        census.counts[INTERSECTIONS] += hits
        census.rays_by_hits[hits] += 1
    return census
