"""Refraction of vertical rays at a given realization of a rough surface."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.fresnel import fresnel, refract
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    compute_normal_from_slope,
    find_first_intersection,
)
from splits.kernels.rough_surface.realization import compute_height_and_slope, make_realization

_X, _Y, _Z = range(3)


class RefractedRays(NamedTuple):
    """Vertical rays after refraction at the surface.

    Attributes
    ----------
    position, direction : float64[rays, 3]
        Point on the surface (m), and direction below it.
    next_hit_distance : float64[rays]
        Distance to the next intersection with the surface (m), or infinity.
    """

    position: np.ndarray
    direction: np.ndarray
    next_hit_distance: np.ndarray


@entry_point
def refract_vertical_rays(waves, refractive_index, x, y):
    """Refract vertical rays at a surface.

    Parameters
    ----------
    waves : float64[4, columns]
        See `splits.kernels.rough_surface.realization`.
    refractive_index : float
        Refractive index below the surface, with 1 above.
    x, y : float64[rays]
        Horizontal positions of the rays (m).

    Returns
    -------
    RefractedRays
    """
    surface = make_realization(waves)
    refracted = RefractedRays(np.empty((x.size, 3)), np.empty((x.size, 3)), np.empty(x.size))
    for ray in range(x.size):
        surface_point = compute_height_and_slope(waves, x[ray], y[ray])
        normal = compute_normal_from_slope(surface_point.slope)
        fresnel_result = fresnel(1.0, refractive_index, 0.0, normal.z)
        d = refract(Vector(0.0, 0.0, -1.0), normal, normal.z, fresnel_result)
        position = Vector(x[ray], y[ray], surface_point.height)
        hit = find_first_intersection(surface, position, d, -1.0)
        for row, vector in ((refracted.position[ray], position), (refracted.direction[ray], d)):
            row[_X], row[_Y], row[_Z] = vector.x, vector.y, vector.z
        refracted.next_hit_distance[ray] = math.inf if hit.distance == NO_HIT else hit.distance
    return refracted
