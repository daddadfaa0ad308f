"""Where rays cross a rough surface.

Rays are marched, by steps that bounds on slope and curvature along the ray prove to be free of
crossings.  On surfaces of many scales it is the finest waves that keep steps short; so waves come
in bands, and at some height above the surface the finer ones count by their reach alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.transport.jit import entry, kernel
from splits.transport.vectors import Vector, along, dot, normalized
from splits.transport.wave_sums import TURN, sums_along, wave_sums
from splits.transport.waves import CURVATURE, END, EXTREME, REST, SLOPE, Slope

GONE = -1.0
"""No crossing: the ray leaves the surface for good."""
LOST = -2.0
"""Neither a crossing nor an end after `MOST_STEPS`, as for rays that stay level."""
MOST_STEPS = 100_000_000
GRAZING = 1e-12
"""Least cosine between a direction and the facet that it leaves."""


class Hit(NamedTuple):
    """Where a ray first meets a surface.

    Attributes
    ----------
    distance : float
        Metres; `GONE` or `LOST` if there is no crossing, or none that matters.
    slope : Slope
        Of the surface there.
    looks : int
        How often the surface was looked at.
    """

    distance: float
    slope: Slope
    looks: int


class Look(NamedTuple):
    """What a look at the surface finds: whether it is met, its slope, and the way that is free."""

    met: bool
    slope: Slope
    free: float


@kernel
def normal_of(slope):
    """Return the upward unit normal of a facet with this slope."""
    return normalized(Vector(-slope.x, -slope.y, 1.0))


@kernel
def cleared(d, n):
    """Return the direction d that leaves a facet to the side of n, turned off it if need be.

    Rounding may leave a grazing direction on the wrong side.  The march takes the same slopes and
    hence sees the ray go off the surface too: the cosine kept is far above their rounding.
    """
    lift = GRAZING - dot(d, n)
    if lift > 0.0:
        return normalized(along(lift + GRAZING, n, d))
    return d


@kernel
def tolerance(surface, place, s):
    """Return the height (m) below which a ray that comes down has hit, after s metres to a place.

    Above the rounding of heights, and of positions along steep surfaces far from the origin.  The
    march takes no height for less, which keeps its steps from vanishing.
    """
    far = abs(place.x) + abs(place.y) + s
    return 1e-12 * surface.reach + 1e-15 * far * (1.0 + surface.steepest)


@kernel
def set_leg(surface, d):
    """Bound slope and curvature along a direction, for every band."""
    total, total2, curved, curved2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    bands = surface.bands
    for band in range(surface.count - 1, -1, -1):
        end = int(bands[END, band])
        sums = sums_along(surface.waves, begin, end, d.x, d.y)
        total += sums.slope
        total2 += sums.slope2
        curved += sums.curvature
        curved2 += sums.curvature2
        bands[SLOPE, band] = TURN * min(total, EXTREME * math.sqrt(0.5 * total2))
        bands[CURVATURE, band] = TURN**2 * min(curved, EXTREME * math.sqrt(0.5 * curved2))
        begin = end


@kernel
def safe_step(gap, rate, slope, curvature, climb):
    """Return how far a ray gets without meeting the surface, inf if it never will.

    Parameters
    ----------
    gap, rate : float
        Height above the surface, G > 0, and its change G' per metre.
    slope, curvature : float
        Bounds along the ray.
    climb : float
        Vertical part of the direction, away from the surface.
    """
    fall = slope - climb
    if fall <= 0.0:
        return math.inf
    # G + G's − C s²/2 = 0, without cancellation.
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate > 0.0:
        bent = (rate + root) / max(curvature, 1e-300)
    else:
        bent = 2.0 * gap / max(root - rate, 1e-300)
    return max(bent, gap / fall)


@kernel
def look(surface, at, d, side, s):
    """Look at the surface from a point of a ray, band by band until a way is free.

    Parameters
    ----------
    surface : Surface
        With the bounds of this leg, see `set_leg`.
    at, d : Vector
        The point and the direction.
    side : float
        See `first_crossing`.
    s : float
        Way marched so far (m).

    Returns
    -------
    Look
    """
    height, slope_x, slope_y, free = 0.0, 0.0, 0.0, 0.0
    begin = 0
    bands = surface.bands
    for band in range(surface.count - 1, -1, -1):
        end = int(bands[END, band])
        sums = wave_sums(surface.waves, begin, end, at.x, at.y)
        begin = end
        height += sums.height
        slope_x -= 2.0 * TURN * sums.along_x
        slope_y -= 2.0 * TURN * sums.along_y
        gap = side * (at.z - height) - bands[REST, band]
        rate = side * (d.z - slope_x * d.x - slope_y * d.y)
        if band == 0:
            little = tolerance(surface, at, s)
            if gap <= little and rate < 0.0:
                return Look(True, Slope(slope_x, slope_y), 0.0)
            gap = max(gap, little)
        if gap > 0.0:
            step = safe_step(gap, rate, bands[SLOPE, band], bands[CURVATURE, band], side * d.z)
            free = max(free, step)
            if gap > bands[REST, band]:
                break
    return Look(False, Slope(slope_x, slope_y), free)


@kernel
def _within_reach(surface, place, d, side):
    """Return after how many metres a ray comes into the reach of the surface, inf if it never does.

    Parameters are those of `first_crossing`.
    """
    above = side * place.z - surface.reach
    climb = side * d.z
    if above <= 0.0:
        return 0.0
    return above / -climb if climb < 0.0 else math.inf


@kernel
def _nothing(distance, looks):
    """Return a `Hit` that is none."""
    return Hit(distance, Slope(0.0, 0.0), looks)


@entry
def first_crossing(surface, place, d, side, farthest=math.inf):
    """Return where a ray first meets the surface.

    A ray that is G above the surface, while G changes by G' per metre, cannot meet it within
    `safe_step`; near a crossing these steps converge like Newton's, and from the ray's side.  All
    that is missed are dips below the surface by less than `tolerance`, and what lies beyond
    `EXTREME`.  A ray that stands on the surface must leave it, see `cleared`.

    Parameters
    ----------
    surface : Surface
    place, d : Vector
        Beginning of the ray and its direction.
    side : float
        1 above the surface, −1 below.
    farthest : float
        Distance beyond which crossings do not matter.

    Returns
    -------
    Hit
    """
    s = _within_reach(surface, place, d, side)
    if s > farthest or s == math.inf:
        return _nothing(GONE, 0)
    set_leg(surface, d)
    for looks in range(MOST_STEPS):
        at = along(s, d, place)
        if side * d.z >= 0.0 and side * at.z > surface.reach:
            return _nothing(GONE, looks)
        seen = look(surface, at, d, side, s)
        if seen.met:
            return Hit(s, seen.slope, looks + 1)
        s += seen.free
        if s > farthest or s == math.inf:
            return _nothing(GONE, looks + 1)
    return _nothing(LOST, MOST_STEPS)
