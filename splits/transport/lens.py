"""Parallel light through a given realisation of a rough surface onto a screen below it."""

from __future__ import annotations

import math

import numpy as np

from splits.transport.fresnel import interface, refracted
from splits.transport.jit import entry
from splits.transport.rough_surface import (
    BOUNDS_SHAPE,
    GONE,
    first_crossing,
    height_and_slope,
    normal_of,
    set_bounds,
)


@entry
def refract_ring(waves, index, x, y, landed):
    """Refract vertical rays at a surface.

    Parameters
    ----------
    waves : float64[4, columns]
        See `splits.transport.rough_surface`.
    index : float
        Refractive index below the surface, with 1 above.
    x, y : float64[rays]
        Where the rays come down (m).
    landed : float64[rays, 7]
        Set to the point of the surface, the direction below it, and how far along it the ray
        meets the surface again (m), or infinity.
    """
    bounds = np.empty(BOUNDS_SHAPE)
    low, high = set_bounds(waves, bounds)
    for ray in range(x.size):
        z, slope_x, slope_y = height_and_slope(waves, x[ray], y[ray])
        nx, ny, nz = normal_of(slope_x, slope_y)
        _, ratio, cos_t = interface(1.0, index, 0.0, nz)
        dx, dy, dz = refracted(0.0, 0.0, -1.0, nx, ny, nz, nz, ratio, cos_t)
        again, _, _ = first_crossing(waves, bounds, x[ray], y[ray], z, dx, dy, dz, -1.0, low, high)
        row = landed[ray]
        row[0], row[1], row[2] = x[ray], y[ray], z
        row[3], row[4], row[5] = dx, dy, dz
        row[6] = math.inf if again == GONE else again
