"""The ray in a layer, and how far it is to the next particle, the floor and the surface."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.transport.compiling.jit import part
from splits.transport.numerics.vectors import UP, Vector, along
from splits.transport.rough.march import GONE, normal_of


class Past(NamedTuple):
    """What has become of a ray so far.

    Attributes
    ----------
    weight : float
    way : float
        Path within the layer (m).
    order : int
        Scatterings, and meetings with the bottom or with a rough surface.
    legs : int
    """

    weight: float
    path_length: float
    order: int
    n_segments: int


class Ray(NamedTuple):
    """A ray on its way, or where it left.

    Attributes
    ----------
    place, d : Vector
        Point (m) and direction.
    stokes : Stokes or None
    inside : bool
        Whether it is below the surface.
    past : Past
    fate : int
        `TRAVELS`, or how it ended: `ABSORBED`, `REFLECTED`, `TRANSMITTED` (through the open face or
        into the bottom), `LOST`.
    """

    position: Vector
    direction: Vector
    stokes: Any
    inside: bool
    history: Past
    status: int


class Ways(NamedTuple):
    """How far it is to the next particle, to the floor, inf if there is none, and to either (m)."""

    collision: float
    bottom: float
    nearest: float


class Ahead(NamedTuple):
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


@part
def moved(ray, d, stokes, history, status):
    """Return a ray at the same place, as an encounter leaves it."""
    return Ray(ray.position, d, stokes, ray.inside, history, status)


@part
def ended(ray, status):
    """Return a ray that has come to its end."""
    return Ray(ray.position, ray.direction, ray.stokes, ray.inside, ray.history, status)


@part
def weighing(history, weight):
    """Return the past of a ray that has another weight now."""
    return Past(weight, history.path_length, history.order, history.n_segments)


@part
def once_more(history):
    """Return the past of a ray after another scattering or meeting."""
    return Past(history.weight, history.path_length, history.order + 1, history.n_segments)


@part
def ways_ahead(ray, layer, u):
    """Return the `Ways` ahead of a ray, with a uniform random number u; outside there are none."""
    free, floor = math.inf, math.inf
    if ray.inside:
        free = -math.log(u) / layer.extinction
        if ray.direction.z < 0.0:
            floor = (-layer.depth - ray.position.z) / ray.direction.z
    return Ways(free, floor, min(free, floor))


@part
def smooth_ahead(ray):
    """Return the smooth surface `Ahead` of a ray."""
    distance = math.inf
    if ray.inside == (ray.direction.z > 0.0):
        distance = -ray.position.z / ray.direction.z if ray.inside else 0.0
    return Ahead(distance, UP)


@part
def near_surface(ray, max_height, max_distance):
    """Tell whether a leg may meet a rough surface: deep inside, most end before that."""
    z = ray.position.z
    return not ray.inside or max(z, z + max_distance * ray.direction.z) > -max_height


@part
def facet_ahead(hit):
    """Return the facet `Ahead` of a ray that a march has found."""
    if hit.distance == GONE:
        return Ahead(math.inf, UP)
    return Ahead(hit.distance, normal_of(hit.slope))


@part
def gone_along(ray, length):
    """Return a ray after a leg of so many metres."""
    past = ray.history
    way = past.path_length + (length if ray.inside else 0.0)
    past = Past(past.weight, way, past.order, past.n_segments + 1)
    place = along(length, ray.direction, ray.position)
    return Ray(place, ray.direction, ray.stokes, ray.inside, past, ray.status)


@part
def levelled(ray, z):
    """Return a ray that has come to a smooth face: at its height exactly."""
    place = Vector(ray.position.x, ray.position.y, z)
    return Ray(place, ray.direction, ray.stokes, ray.inside, ray.history, ray.status)
