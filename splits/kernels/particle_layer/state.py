"""State of a ray in a layer of particles, and its distances to the next events."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.math.vectors import UP, Vector, add_scaled
from splits.kernels.rough_surface.intersection import NO_HIT, compute_normal_from_slope


class LayerRay(NamedTuple):
    """State of a ray, in the layer or at its exit.

    Attributes
    ----------
    position, direction : Vector
        Position (m) and direction.
    stokes : Stokes or None
    inside : bool
        Whether it is below the surface.
    weight : float
    path_length : float
        Path length within the layer (m).
    order : int
        Number of scatterings and hits of the bottom or a rough surface.
    n_segments : int
        Number of path segments.
    status : int
        `ALIVE`, or the way it ended: `ABSORBED`, `REFLECTED`, `TRANSMITTED` (through the open lower
        boundary or into the bottom), `LOST`.
    """

    position: Vector
    direction: Vector
    stokes: Any
    inside: bool
    weight: float
    path_length: float
    order: int
    n_segments: int
    status: int


class EventDistances(NamedTuple):
    """Distances to the next particle, to the bottom (inf if not ahead), and the smaller one (m)."""

    collision: float
    bottom: float
    nearest: float


class SurfaceHit(NamedTuple):
    """Intersection of a ray with the surface.

    Attributes
    ----------
    distance : float
        Distance (m); inf without intersection within the distance of interest.
    normal : Vector
        Upward normal.
    """

    distance: float
    normal: Vector


@inline_only
def sample_event_distances(ray, layer, u):
    """Sample the `EventDistances` of a ray with a uniform number u; inf outside the layer."""
    collision, bottom = math.inf, math.inf
    if ray.inside:
        collision = -math.log(u) / layer.extinction
        if ray.direction.z < 0.0:
            bottom = (-layer.depth - ray.position.z) / ray.direction.z
    return EventDistances(collision, bottom, min(collision, bottom))


@inline_only
def intersect_smooth_surface(ray):
    """Return the `SurfaceHit` of a ray at the smooth surface."""
    distance = math.inf
    if ray.inside == (ray.direction.z > 0.0):
        distance = -ray.position.z / ray.direction.z if ray.inside else 0.0
    return SurfaceHit(distance, UP)


@inline_only
def is_near_surface(ray, max_height, max_distance):
    """Return whether a path segment may hit the rough surface; deep inside, most end before it."""
    z = ray.position.z
    return not ray.inside or max(z, z + max_distance * ray.direction.z) > -max_height


@inline_only
def to_surface_hit(hit):
    """Return the `SurfaceHit` of an intersection with the rough surface."""
    if hit.distance == NO_HIT:
        return SurfaceHit(math.inf, UP)
    return SurfaceHit(hit.distance, compute_normal_from_slope(hit.slope))


@inline_only
def advance_ray(ray, length):
    """Return a ray advanced by a distance (m)."""
    return replace(
        ray, position=add_scaled(length, ray.direction, ray.position),
        path_length=ray.path_length + (length if ray.inside else 0.0),
        n_segments=ray.n_segments + 1,
    )  # fmt: skip


@inline_only
def set_height(ray, z):
    """Return a ray placed exactly at the height of a smooth interface."""
    return replace(ray, position=Vector(ray.position.x, ray.position.y, z))
