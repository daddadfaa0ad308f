"""Where rays cross a rough surface.

Rays are marched, by steps that bounds on slope and curvature along the ray prove to be free of
crossings.  On surfaces of many scales it is the finest waves that keep steps short; so waves come
in bands, and at some height above the surface the finer ones count by their reach alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.transport.compiling.jit import borrower, kernel, part
from splits.transport.numerics.vectors import Vector, along, dot, normalized
from splits.transport.rough.wave_sums import TURN, sums_along, wave_sums
from splits.transport.rough.waves import CURVATURE, END, EXTREME, REST, SLOPE, Relief, Slope

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
    n_evaluations: int


class Band(NamedTuple):
    """A column of `Surface.bands`, and whether it is the finest, of all waves."""

    end: int
    finer_height: float
    max_slope: float
    max_curvature: float
    is_finest: bool


class Look(NamedTuple):
    """What is known of the surface at a point of a ray, by the bands looked at so far.

    Attributes
    ----------
    relief : Relief
    free : float
        Way that is free of crossings (m).
    met, enough : bool
        Whether the ray meets the surface there; whether finer bands would not add to the way.
    """

    surface: Relief
    free_distance: float
    hit: bool
    sufficient: bool


NOTHING_SEEN = Look(Relief(0.0, Slope(0.0, 0.0)), 0.0, False, False)


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
def tolerance(surface, position, s):
    """Return the height (m) below which a ray that comes down has hit, after s metres to a place.

    Above the rounding of heights, and of positions along steep surfaces far from the origin.  The
    march takes no height for less, which keeps its steps from vanishing.
    """
    far = abs(position.x) + abs(position.y) + s
    return 1e-12 * surface.max_height + 1e-15 * far * (1.0 + surface.max_slope)


@kernel
def set_leg(surface, d):
    """Bound slope and curvature along a direction, for every band."""
    total, total2, curved, curved2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    bands = surface.bands
    for band in range(surface.n_bands - 1, -1, -1):
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


@part
def _band(surface, number):
    """Return a `Band`."""
    bands = surface.bands
    return Band(
        int(bands[END, number]), bands[REST, number], bands[SLOPE, number],
        bands[CURVATURE, number], number == 0,
    )  # fmt: skip


@part
def look(probe, sums, band, point, d, side, tolerance):
    """Return what is known of the surface with another band.

    Parameters
    ----------
    seen : Look
        Before.
    sums : WaveSums
        Of the waves that the band has beyond the last one.
    band : Band
    at, d : Vector
        Point of the ray and its direction.
    side : float
        See `first_crossing`.
    little : float
        The `tolerance`.

    Returns
    -------
    Look
    """
    height = probe.surface.height + sums.height
    slope_x = probe.surface.slope.x - 2.0 * TURN * sums.scaled_slope_x
    slope_y = probe.surface.slope.y - 2.0 * TURN * sums.scaled_slope_y
    gap = side * (point.z - height) - band.finer_height
    rate = side * (d.z - slope_x * d.x - slope_y * d.y)
    met, enough, free = False, False, probe.free_distance
    if band.is_finest:
        met = gap <= tolerance and rate < 0.0
        gap = max(gap, tolerance)
    if gap > 0.0 and not met:
        free = max(free, safe_step(gap, rate, band.max_slope, band.max_curvature, side * d.z))
        # Waves without height leave nothing to the finer bands; those that decide are among them.
        enough = gap > max(band.finer_height, tolerance)
    return Look(Relief(height, Slope(slope_x, slope_y)), free, met, enough)


@part
def _within_reach(surface, position, d, side):
    """Return after how many metres a ray comes into the reach of the surface, inf if it never does.

    Parameters are those of `first_crossing`.
    """
    above = side * position.z - surface.max_height
    climb = side * d.z
    if above <= 0.0:
        return 0.0
    return above / -climb if climb < 0.0 else math.inf


@part
def no_hit(distance, n_evaluations):
    """Return a `Hit` that is none: `GONE` or `LOST`, after so many looks."""
    return Hit(distance, Slope(0.0, 0.0), n_evaluations)


@borrower
def first_crossing(surface, position, d, side, max_distance=math.inf):
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
    s = _within_reach(surface, position, d, side)
    if s > max_distance or s == math.inf:
        return no_hit(GONE, 0)
    set_leg(surface, d)
    for looks in range(MOST_STEPS):
        at = along(s, d, position)
        if side * d.z >= 0.0 and side * at.z > surface.max_height:
            return no_hit(GONE, looks)
        seen, begin, little = NOTHING_SEEN, 0, tolerance(surface, at, s)
        for number in range(surface.n_bands - 1, -1, -1):
            band = _band(surface, number)
            sums = wave_sums(surface.waves, begin, band.end, at.x, at.y)
            seen = look(seen, sums, band, at, d, side, little)
            begin = band.end
            if seen.sufficient:
                break
        if seen.hit:
            return Hit(s, seen.surface.slope, looks + 1)
        s += seen.free_distance
        if s > max_distance or s == math.inf:
            return no_hit(GONE, looks + 1)
    return no_hit(LOST, MOST_STEPS)
