"""The ray in a layer, and how far it is to the next particle, the floor and the surface."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import UP, Vector, add_scaled
from splits.kernels.rough_surface.intersection import NO_HIT, compute_normal_from_slope


class RayHistory(NamedTuple):
    """What has become of a ray so far.

    Attributes
    ----------
    weight : float
    path_length : float
        Path within the layer (m).
    order : int
        Scatterings, and meetings with the bottom or with a rough surface.
    n_segments : int
    """

    weight: float
    path_length: float
    order: int
    n_segments: int


class LayerRay(NamedTuple):
    """A ray on its way, or where it left.

    Attributes
    ----------
    position, direction : Vector
        Point (m) and direction.
    stokes : Stokes or None
    inside : bool
        Whether it is below the surface.
    history : RayHistory
    status : int
        `TRAVELS`, or how it ended: `ABSORBED`, `REFLECTED`, `TRANSMITTED` (through the open face or
        into the bottom), `LOST`.
    """

    position: Vector
    direction: Vector
    stokes: Any
    inside: bool
    history: RayHistory
    status: int


class EventDistances(NamedTuple):
    """How far it is to the next particle, to the floor, inf if there is none, and to either (m)."""

    collision: float
    bottom: float
    nearest: float


class SurfaceHit(NamedTuple):
    """The surface ahead of a ray.

    Attributes
    ----------
    distance : float
        Metres; inf if it is nowhere, or beyond what matters.
    normal : Vector
        Upwards.
    """

    distance: float
    normal: Vector


@inline_only
def update_ray(ray, d, stokes, history, status):
    """Return a ray at the same place, as an encounter leaves it."""
    return LayerRay(ray.position, d, stokes, ray.inside, history, status)


@inline_only
def set_status(ray, status):
    """Return a ray that has come to its end."""
    return LayerRay(ray.position, ray.direction, ray.stokes, ray.inside, ray.history, status)


@inline_only
def with_weight(history, weight):
    """Return the past of a ray that has another weight now."""
    return RayHistory(weight, history.path_length, history.order, history.n_segments)


@inline_only
def increment_order(history):
    """Return the past of a ray after another scattering or meeting."""
    return RayHistory(history.weight, history.path_length, history.order + 1, history.n_segments)


@inline_only
def sample_event_distances(ray, layer, u):
    """Return the `EventDistances` ahead of a ray, with a uniform random number u; outside there are none."""
    free, floor = math.inf, math.inf
    if ray.inside:
        free = -math.log(u) / layer.extinction
        if ray.direction.z < 0.0:
            floor = (-layer.depth - ray.position.z) / ray.direction.z
    return EventDistances(free, floor, min(free, floor))


@inline_only
def intersect_smooth_surface(ray):
    """Return the smooth surface `SurfaceHit` of a ray."""
    distance = math.inf
    if ray.inside == (ray.direction.z > 0.0):
        distance = -ray.position.z / ray.direction.z if ray.inside else 0.0
    return SurfaceHit(distance, UP)


@inline_only
def is_near_surface(ray, max_height, max_distance):
    """Tell whether a leg may meet a rough surface: deep inside, most end before that."""
    z = ray.position.z
    return not ray.inside or max(z, z + max_distance * ray.direction.z) > -max_height


@inline_only
def to_surface_hit(hit):
    """Return the facet `SurfaceHit` of a ray that a march has found."""
    if hit.distance == NO_HIT:
        return SurfaceHit(math.inf, UP)
    return SurfaceHit(hit.distance, compute_normal_from_slope(hit.slope))


@inline_only
def advance_ray(ray, length):
    """Return a ray after a leg of so many metres."""
    past = ray.history
    way = past.path_length + (length if ray.inside else 0.0)
    past = RayHistory(past.weight, way, past.order, past.n_segments + 1)
    place = add_scaled(length, ray.direction, ray.position)
    return LayerRay(place, ray.direction, ray.stokes, ray.inside, past, ray.status)


@inline_only
def snap_to_plane(ray, z):
    """Return a ray that has come to a smooth face: at its height exactly."""
    place = Vector(ray.position.x, ray.position.y, z)
    return LayerRay(place, ray.direction, ray.stokes, ray.inside, ray.history, ray.status)
