"""State of a ray in a layer of particles, and its distances to the next events."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import UP, Vector, add_scaled
from splits.kernels.rough_surface.intersection import NO_HIT, compute_normal_from_slope


class RayHistory(NamedTuple):
    """Weight, path length and counters of a ray.

    Attributes
    ----------
    weight : float
    path_length : float
        Path length within the layer (m).
    order : int
        Number of scatterings and hits of the bottom or a rough surface.
    n_segments : int
        Number of path segments.
    """

    weight: float
    path_length: float
    order: int
    n_segments: int


class LayerRay(NamedTuple):
    """State of a ray, in the layer or at its exit.

    Attributes
    ----------
    position, direction : Vector
        Position (m) and direction.
    stokes : Stokes or None
    inside : bool
        Whether it is below the surface.
    history : RayHistory
    status : int
        `ALIVE`, or the way it ended: `ABSORBED`, `REFLECTED`, `TRANSMITTED` (through the open lower
        boundary or into the bottom), `LOST`.
    """

    position: Vector
    direction: Vector
    stokes: Any
    inside: bool
    history: RayHistory
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
def update_ray(ray, d, stokes, history, status):
    """Return a ray at the same position with a new direction, polarization, history and status."""
    return LayerRay(ray.position, d, stokes, ray.inside, history, status)


@inline_only
def set_status(ray, status):
    """Return a ray with another status."""
    return LayerRay(ray.position, ray.direction, ray.stokes, ray.inside, ray.history, status)


@inline_only
def with_weight(history, weight):
    """Return a history with another weight."""
    return RayHistory(weight, history.path_length, history.order, history.n_segments)


@inline_only
def increment_order(history):
    """Return a history with the order of scattering increased by 1."""
    return RayHistory(history.weight, history.path_length, history.order + 1, history.n_segments)


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
    history = ray.history
    path_length = history.path_length + (length if ray.inside else 0.0)
    history = RayHistory(history.weight, path_length, history.order, history.n_segments + 1)
    position = add_scaled(length, ray.direction, ray.position)
    return LayerRay(position, ray.direction, ray.stokes, ray.inside, history, ray.status)


@inline_only
def snap_to_plane(ray, z):
    """Return a ray placed exactly at the height of a smooth interface."""
    position = Vector(ray.position.x, ray.position.y, z)
    return LayerRay(position, ray.direction, ray.stokes, ray.inside, ray.history, ray.status)
