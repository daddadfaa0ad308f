"""Rays through surfaces of their own, to count what must not be: leaks and losses."""

from __future__ import annotations

import math

import numpy as np

from splits.transport.frames import cosine_lobe, dot, mirrored
from splits.transport.fresnel import interface, refracted
from splits.transport.jit import entry, kernel
from splits.transport.rng import start_stream, uniform
from splits.transport.rough_surface import (
    BOUNDS_SHAPE,
    EVALUATED,
    GONE,
    GRAZING,
    LOST,
    REALISATION,
    cleared,
    columns_for,
    draw_waves,
    first_crossing,
    height_and_slope,
    normal_of,
    tolerance,
)

MOST_HITS = 50
CROSSINGS, LEAKS, LOSSES, LEGS, EVALUATIONS = range(5)


@kernel
def _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, length):
    """Return how many of four points of a leg are on the wrong side of the surface."""
    found = 0
    for i in range(4):
        # Three anywhere, and one where a step too long at the end of the march would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        px, py, pz = x + s * dx, y + s * dy, z + s * dz
        height, _, _ = height_and_slope(waves, px, py)
        if side * (pz - height) < -4.0 * tolerance(bounds, px, py, s):
            found += 1
    return found


@entry
def crossings(seed, first, rays, fields, index, cos_incidence):
    """Send rays through surfaces of their own and count what must not be.

    Every ray comes from above, and is reflected or refracted at the facets that it meets until it
    leaves upwards or has had `MOST_HITS`.  One that leaves downwards comes back from below, as
    diffuse light does.

    Parameters
    ----------
    seed, first, rays : int
        Streams of the rays.
    fields : Fields
    index : float
        Refractive index below the surface, with 1 above.
    cos_incidence : float

    Returns
    -------
    counts : int64[5]
        `CROSSINGS`; `LEAKS`, points of legs that are on the wrong side of the surface; `LOSSES`,
        rays that were lost; `LEGS`; `EVALUATIONS` of the surface in the search for crossings.
    hits : int64[MOST_HITS + 1]
        Rays by the number of their hits.
    """
    counts = np.zeros(5, dtype=np.int64)
    hits = np.zeros(MOST_HITS + 1, dtype=np.int64)
    state = np.zeros(1, dtype=np.uint64)
    waves = np.empty((4, columns_for(fields)))
    bounds = np.empty(BOUNDS_SHAPE)
    for ray in range(first, first + rays):
        start_stream(state, seed, 0, ray)
        low, high = draw_waves(state, fields, waves, bounds)
        side = 1.0
        x, y, z = 0.0, 0.0, high
        dx, dy, dz = math.sqrt(1.0 - cos_incidence * cos_incidence), 0.0, -cos_incidence
        hit = 0
        while hit < MOST_HITS:
            s, slope_x, slope_y = first_crossing(
                waves, bounds, x, y, z, dx, dy, dz, side, low, high
            )
            counts[LEGS] += 1
            if s == LOST:
                counts[LOSSES] += 1
                break
            if s == GONE:
                rest = high - side * z
                if rest > 0.0 and side * dz > 0.0:
                    s = rest / (side * dz)
                    counts[LEAKS] += _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, s)
                if side > 0.0:
                    break
                dx, dy, dz = cosine_lobe(state, 0.0, 0.0, 1.0)
                z = 2.0 * low
                continue
            counts[LEAKS] += _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, s)
            x, y, z = x + s * dx, y + s * dy, z + s * dz
            hit += 1
            nx, ny, nz = normal_of(slope_x, slope_y)
            nx, ny, nz = side * nx, side * ny, side * nz
            cos_i = max(-dot(dx, dy, dz, nx, ny, nz), GRAZING)
            n1, n2 = (1.0, index) if side > 0.0 else (index, 1.0)
            reflectance, ratio, cos_t = interface(n1, n2, 0.0, cos_i)
            if uniform(state) < reflectance:
                dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
                dx, dy, dz = cleared(dx, dy, dz, nx, ny, nz)
            else:
                dx, dy, dz = refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t)
                dx, dy, dz = cleared(dx, dy, dz, -nx, -ny, -nz)
                side = -side
        counts[CROSSINGS] += hit
        hits[hit] += 1
        counts[EVALUATIONS] += int(bounds[REALISATION, EVALUATED])
    return counts, hits
