"""Parallel light through a given realisation of a rough surface onto a screen below it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import entry
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.fresnel import interface, refracted
from splits.transport.rough.march import GONE, first_crossing, normal_of
from splits.transport.rough.waves import relief_at, surface_of

_X, _Y, _Z = range(3)


class Landed(NamedTuple):
    """Where rays came down, and where they go from there.

    Attributes
    ----------
    point, direction : float64[rays, 3]
        Of the surface (m), and below it.
    again : float64[rays]
        How far along it the ray meets the surface again (m), or infinity.
    """

    position: np.ndarray
    direction: np.ndarray
    next_hit_distance: np.ndarray


@entry
def refract_ring(waves, refractive_index, x, y):
    """Refract vertical rays at a surface.

    Parameters
    ----------
    waves : float64[4, columns]
        See `splits.transport.rough.waves`.
    index : float
        Refractive index below the surface, with 1 above.
    x, y : float64[rays]
        Where the rays come down (m).

    Returns
    -------
    Landed
    """
    surface = surface_of(waves)
    landed = Landed(np.empty((x.size, 3)), np.empty((x.size, 3)), np.empty(x.size))
    for ray in range(x.size):
        relief = relief_at(waves, x[ray], y[ray])
        normal = normal_of(relief.slope)
        passage = interface(1.0, refractive_index, 0.0, normal.z)
        d = refracted(Vector(0.0, 0.0, -1.0), normal, normal.z, passage)
        place = Vector(x[ray], y[ray], relief.height)
        hit = first_crossing(surface, place, d, -1.0)
        for row, vector in ((landed.position[ray], place), (landed.direction[ray], d)):
            row[_X], row[_Y], row[_Z] = vector.x, vector.y, vector.z
        landed.next_hit_distance[ray] = math.inf if hit.distance == GONE else hit.distance
    return landed
