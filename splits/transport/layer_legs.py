"""The ray in a layer, and how far it gets: to a particle, the surface or the floor."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.transport.jit import kernel
from splits.transport.march import GONE, first_crossing, normal_of
from splits.transport.march import LOST as ASTRAY
from splits.transport.rng import uniform
from splits.transport.vectors import UP, Vector, along


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
    way: float
    order: int
    legs: int


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

    place: Vector
    d: Vector
    stokes: Any
    inside: bool
    past: Past
    fate: int


PARTICLE, SURFACE, FLOOR, AWAY, NOWHERE = range(5)
"""What a leg ends at: `AWAY` leaves the layer upwards, `NOWHERE` is where no ray should be."""


class Leg(NamedTuple):
    """How long a leg is (m), what it ends at, and the upward normal of the surface there."""

    length: float
    event: int
    normal: Vector


class Ahead(NamedTuple):
    """How far ahead the surface is (m), inf if nowhere or beyond what matters, and its normal.

    The distance is `ASTRAY` where the march found no end.
    """

    distance: float
    normal: Vector


@kernel
def moved(ray, d, stokes, past, fate):
    """Return a ray at the same place, as an encounter leaves it."""
    return Ray(ray.place, d, stokes, ray.inside, past, fate)


@kernel
def ended(ray, fate):
    """Return a ray that has come to its end."""
    return Ray(ray.place, ray.d, ray.stokes, ray.inside, ray.past, fate)


@kernel
def weighing(past, weight):
    """Return the past of a ray that has another weight now."""
    return Past(weight, past.way, past.order, past.legs)


@kernel
def once_more(past):
    """Return the past of a ray after another scattering or meeting."""
    return Past(past.weight, past.way, past.order + 1, past.legs)


@kernel
def _surface_ahead(ray, surface, farthest):
    """Return where the surface is on a ray's way, `Ahead`; beyond `farthest` it does not matter."""
    z, d = ray.place.z, ray.d
    if surface is None:
        if ray.inside:
            return Ahead(-z / d.z if d.z > 0.0 else math.inf, UP)
        return Ahead(0.0 if d.z < 0.0 else math.inf, UP)
    # Deep inside, most legs end before the surface can be met.
    if ray.inside and not max(z, z + farthest * d.z) > -surface.reach:
        return Ahead(math.inf, UP)
    hit = first_crossing(surface, ray.place, d, -1.0 if ray.inside else 1.0, farthest)
    if hit.distance == GONE:
        return Ahead(math.inf, UP)
    return Ahead(hit.distance, normal_of(hit.slope))


@kernel
def next_leg(state, ray, layer, surface):
    """Return the `Leg` that is ahead of a ray."""
    free, floor = math.inf, math.inf
    if ray.inside:
        free = -math.log(uniform(state)) / layer.extinction
        if ray.d.z < 0.0:
            floor = (-layer.depth - ray.place.z) / ray.d.z
    nearest = min(free, floor)
    ahead = _surface_ahead(ray, surface, nearest)
    if ahead.distance == ASTRAY:
        return Leg(0.0, NOWHERE, UP)
    if not ray.inside and ahead.distance == math.inf:
        return Leg(0.0, AWAY if ray.d.z > 0.0 else NOWHERE, UP)
    if ahead.distance <= nearest:
        return Leg(ahead.distance, SURFACE, ahead.normal)
    return Leg(nearest, FLOOR if floor <= free else PARTICLE, UP)


@kernel
def gone_along(ray, leg, layer, surface):
    """Return a ray at the end of a leg; on smooth faces exactly."""
    place = along(leg.length, ray.d, ray.place)
    if leg.event == FLOOR:
        place = Vector(place.x, place.y, -layer.depth)
    if surface is None and leg.event == SURFACE:
        place = Vector(place.x, place.y, 0.0)
    past = ray.past
    way = past.way + (leg.length if ray.inside else 0.0)
    past = Past(past.weight, way, past.order, past.legs + 1)
    return Ray(place, ray.d, ray.stokes, ray.inside, past, ray.fate)
