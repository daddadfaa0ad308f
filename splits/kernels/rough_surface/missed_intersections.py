"""Count of errors of the surface intersection: leaks of rays through a surface, and lost rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.arithmetic import (
    UP,
    Vector,
    add_scaled,
    sample_cosine_lobe,
    scale,
)
from splits.kernels.compiler.jit import entry_point, inline_only
from splits.kernels.interface import ComplexIndex, sample_interface
from splits.kernels.rng import start_stream, uniform
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
from splits.kernels.scene import Source, sample_source_direction

MAX_HITS = 50
INTERSECTIONS, LEAKS, LOST_RAYS, SEGMENTS, EVALUATIONS = range(5)


class LeakCount(NamedTuple):
    """Counts of surface interactions and errors.

    Attributes
    ----------
    counts : int64[5]
        `INTERSECTIONS`; `LEAKS`, points of path segments on the wrong side of the surface;
        `LOST_RAYS`; `SEGMENTS`; `EVALUATIONS` of the surface in the search for intersections.
    rays_by_hits : int64[MAX_HITS + 1]
        Rays by their number of hits.
    """

    counts: np.ndarray
    rays_by_hits: np.ndarray


class SurfaceRay(NamedTuple):
    """Ray above the surface, side 1, or below it, side −1."""

    position: Vector
    direction: Vector
    side: float


@inline_only
def _count_leaks(state, surface, ray, length):
    """Return how many of four points of a path segment are on the wrong side of the surface."""
    n_leaks = 0
    for i in range(4):
        # Three random points, and one where a last step that is too long would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        point = add_scaled(s, ray.direction, ray.position)
        height = compute_height_and_slope(surface.waves, point.x, point.y).height
        if ray.side * (point.z - height) < -4.0 * compute_height_tolerance(surface, point, s):
            n_leaks += 1
    return n_leaks


@inline_only
def _scatter_at_facet(state, ray, hit, refractive_index):
    """Return a ray after reflection or refraction at a facet."""
    upward = compute_normal_from_slope(hit.slope)
    above, below = ComplexIndex(1.0, 0.0), ComplexIndex(refractive_index, 0.0)
    near, far = (above, below) if ray.side > 0.0 else (below, above)
    normal = scale(ray.side, upward)
    sample = sample_interface(ray.direction, normal, near, far, uniform(state))
    side = -ray.side if sample.transmitted else ray.side
    position = add_scaled(hit.distance, ray.direction, ray.position)
    return SurfaceRay(position, nudge_off_surface(sample.direction, scale(side, upward)), side)


@inline_only
def _trace_ray(state, surface, refractive_index, ray, counts):
    """Trace one ray, update the counts, and return its number of hits."""
    hits = 0
    while hits < MAX_HITS:
        hit = find_first_intersection(surface, ray.position, ray.direction, ray.side)
        counts[SEGMENTS] += 1
        counts[EVALUATIONS] += hit.n_evaluations
        if hit.distance == STEP_LIMIT_REACHED:
            counts[LOST_RAYS] += 1
            break
        if hit.distance == NO_HIT:
            vertical_distance = surface.max_height - ray.side * ray.position.z
            if vertical_distance > 0.0 and ray.side * ray.direction.z > 0.0:
                length = vertical_distance / (ray.side * ray.direction.z)
                counts[LEAKS] += _count_leaks(state, surface, ray, length)
            if ray.side > 0.0:
                break
            position = Vector(ray.position.x, ray.position.y, -2.0 * surface.max_height)
            direction = sample_cosine_lobe(UP, uniform(state), uniform(state))
            ray = SurfaceRay(position, direction, ray.side)
            continue
        counts[LEAKS] += _count_leaks(state, surface, ray, hit.distance)
        hits += 1
        ray = _scatter_at_facet(state, ray, hit, refractive_index)
    return hits


@entry_point
def count_leaks(seed, first_ray, n_rays, fields, refractive_index, cos_incidence):
    """Trace rays through realizations of a surface, one for each, and count leaks and lost rays.

    Every ray comes from above, and is reflected or refracted at the facets that it hits until it
    leaves upwards or has `MAX_HITS` hits.  A ray that leaves downwards is replaced by one with a
    Lambertian direction from below.

    Parameters
    ----------
    seed, first_ray, n_rays : int
        Random streams of the rays.
    fields : HeightFields
    refractive_index : float
        Refractive index below the surface, with 1 above.
    cos_incidence : float

    Returns
    -------
    LeakCount
    """
    leaks = LeakCount(np.zeros(5, dtype=np.int64), np.zeros(MAX_HITS + 1, dtype=np.int64))
    state = np.zeros(1, dtype=np.uint64)
    buffer = allocate_realization(fields)
    d = sample_source_direction(Source(cos_incidence, 0.0), 1.0)
    for ray in range(first_ray, first_ray + n_rays):
        start_stream(state, seed, 0, ray)
        surface = sample_realization(state, fields, buffer)
        surface_ray = SurfaceRay(Vector(0.0, 0.0, surface.max_height), d, 1.0)
        hits = _trace_ray(state, surface, refractive_index, surface_ray, leaks.counts)
        leaks.counts[INTERSECTIONS] += hits
        leaks.rays_by_hits[hits] += 1
    return leaks
