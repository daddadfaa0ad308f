"""Where rays cross a rough surface.

Rays are marched, by steps that bounds on slope and curvature along the ray prove to be free of
crossings.  On surfaces of many scales it is the finest waves that keep steps short; so waves come
in bands, and at some height above the surface the finer ones count by their reach alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.compiler.jit import entry_point_no_refcount, inline, inline_only
from splits.kernels.math.vectors import Vector, add_scaled, dot, normalize
from splits.kernels.rough_surface.realization import (
    BAND_END,
    BOUND_SIGMA,
    FINER_HEIGHT,
    MAX_CURVATURE,
    MAX_SLOPE,
    HeightAndSlope,
    SurfaceSlope,
)
from splits.kernels.rough_surface.wave_sums import TWO_PI, sum_ray_bounds, sum_waves

NO_HIT = -1.0
"""No crossing: the ray leaves the surface for good."""
STEP_LIMIT_REACHED = -2.0
"""Neither a crossing nor an end after `MAX_STEPS`, as for rays that stay level."""
MAX_STEPS = 100_000_000
MIN_COS_EXIT = 1e-12
"""Least cosine between a direction and the facet that it leaves."""


class Hit(NamedTuple):
    """Where a ray first meets a surface.

    Attributes
    ----------
    distance : float
        Metres; `NO_HIT` or `STEP_LIMIT_REACHED` if there is no crossing, or none that matters.
    slope : Slope
        Of the surface there.
    n_evaluations : int
        How often the surface was looked at.
    """

    distance: float
    slope: SurfaceSlope
    n_evaluations: int


class WaveBand(NamedTuple):
    """A column of `Surface.bands`, and whether it is the finest, of all waves."""

    end: int
    finer_height: float
    max_slope: float
    max_curvature: float
    is_finest: bool


class SurfaceProbe(NamedTuple):
    """What is known of the surface at a point of a ray, by the bands looked at so far.

    Attributes
    ----------
    surface : HeightAndSlope
    free_distance : float
        Way that is free of crossings (m).
    hit, sufficient : bool
        Whether the ray meets the surface there; whether finer bands would not add to the way.
    """

    surface: HeightAndSlope
    free_distance: float
    hit: bool
    sufficient: bool


EMPTY_PROBE = SurfaceProbe(HeightAndSlope(0.0, SurfaceSlope(0.0, 0.0)), 0.0, False, False)


@inline
def compute_normal_from_slope(slope):
    """Return the upward unit normal of a facet with this slope."""
    return normalize(Vector(-slope.x, -slope.y, 1.0))


@inline
def nudge_off_surface(d, n):
    """Return the direction d that leaves a facet to the side of n, turned off it if need be.

    Rounding may leave a grazing direction on the wrong side.  The march takes the same slopes and
    hence sees the ray go off the surface too: the cosine kept is far above their rounding.
    """
    lift = MIN_COS_EXIT - dot(d, n)
    if lift > 0.0:
        return normalize(add_scaled(lift + MIN_COS_EXIT, n, d))
    return d


@inline
def compute_height_tolerance(surface, position, s):
    """Return the height (m) below which a ray that comes down has hit, after s metres to a place.

    Above the rounding of heights, and of positions along steep surfaces far from the origin.  The
    march takes no height for less, which keeps its steps from vanishing.
    """
    far = abs(position.x) + abs(position.y) + s
    return 1e-12 * surface.max_height + 1e-15 * far * (1.0 + surface.max_slope)


@inline
def set_ray_bounds(surface, d):
    """Bound slope and curvature along a direction, for every band."""
    total, total2, curved, curved2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    bands = surface.bands
    for band in range(surface.n_bands - 1, -1, -1):
        end = int(bands[BAND_END, band])
        sums = sum_ray_bounds(surface.waves, begin, end, d.x, d.y)
        total += sums.slope
        total2 += sums.slope2
        curved += sums.curvature
        curved2 += sums.curvature2
        bands[MAX_SLOPE, band] = TWO_PI * min(total, BOUND_SIGMA * math.sqrt(0.5 * total2))
        bands[MAX_CURVATURE, band] = TWO_PI**2 * min(curved, BOUND_SIGMA * math.sqrt(0.5 * curved2))
        begin = end


@inline
def compute_safe_step(gap, rate, slope, curvature, climb):
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


@inline_only
def _load_band(surface, number):
    """Return a `WaveBand`."""
    bands = surface.bands
    return WaveBand(
        int(bands[BAND_END, number]), bands[FINER_HEIGHT, number], bands[MAX_SLOPE, number],
        bands[MAX_CURVATURE, number], number == 0,
    )  # fmt: skip


@inline_only
def refine_probe(probe, sums, band, point, d, side, tolerance):
    """Return what is known of the surface with another band.

    Parameters
    ----------
    probe : SurfaceProbe
        Before.
    sums : WaveSums
        Of the waves that the band has beyond the last one.
    band : Band
    point, d : Vector
        Point of the ray and its direction.
    side : float
        See `find_first_intersection`.
    tolerance : float
        The `compute_height_tolerance`.

    Returns
    -------
    Look
    """
    height = probe.surface.height + sums.height
    slope_x = probe.surface.slope.x - 2.0 * TWO_PI * sums.scaled_slope_x
    slope_y = probe.surface.slope.y - 2.0 * TWO_PI * sums.scaled_slope_y
    gap = side * (point.z - height) - band.finer_height
    rate = side * (d.z - slope_x * d.x - slope_y * d.y)
    met, enough, free = False, False, probe.free_distance
    if band.is_finest:
        met = gap <= tolerance and rate < 0.0
        gap = max(gap, tolerance)
    if gap > 0.0 and not met:
        free = max(
            free, compute_safe_step(gap, rate, band.max_slope, band.max_curvature, side * d.z)
        )
        # Waves without height leave nothing to the finer bands; those that decide are among them.
        enough = gap > max(band.finer_height, tolerance)
    return SurfaceProbe(HeightAndSlope(height, SurfaceSlope(slope_x, slope_y)), free, met, enough)


@inline_only
def _distance_to_max_height(surface, position, d, side):
    """Return after how many metres a ray comes into the reach of the surface, inf if it never does.

    Parameters are those of `find_first_intersection`.
    """
    above = side * position.z - surface.max_height
    climb = side * d.z
    if above <= 0.0:
        return 0.0
    return above / -climb if climb < 0.0 else math.inf


@inline_only
def make_no_hit(distance, n_evaluations):
    """Return a `Hit` that is none: `NO_HIT` or `STEP_LIMIT_REACHED`, after so many looks."""
    return Hit(distance, SurfaceSlope(0.0, 0.0), n_evaluations)


@entry_point_no_refcount
def find_first_intersection(surface, position, d, side, max_distance=math.inf):
    """Return where a ray first meets the surface.

    A ray that is G above the surface, while G changes by G' per metre, cannot meet it within
    `compute_safe_step`; near a crossing these steps converge like Newton's, and from the ray's side.  All
    that is missed are dips below the surface by less than `compute_height_tolerance`, and what lies beyond
    `BOUND_SIGMA`.  A ray that stands on the surface must leave it, see `nudge_off_surface`.

    Parameters
    ----------
    surface : SurfaceRealization
    position, d : Vector
        Beginning of the ray and its direction.
    side : float
        1 above the surface, −1 below.
    max_distance : float
        Distance beyond which crossings do not matter.

    Returns
    -------
    Hit
    """
    s = _distance_to_max_height(surface, position, d, side)
    if s > max_distance or s == math.inf:
        return make_no_hit(NO_HIT, 0)
    set_ray_bounds(surface, d)
    for looks in range(MAX_STEPS):
        at = add_scaled(s, d, position)
        if side * d.z >= 0.0 and side * at.z > surface.max_height:
            return make_no_hit(NO_HIT, looks)
        seen, begin, little = EMPTY_PROBE, 0, compute_height_tolerance(surface, at, s)
        for number in range(surface.n_bands - 1, -1, -1):
            band = _load_band(surface, number)
            sums = sum_waves(surface.waves, begin, band.end, at.x, at.y)
            seen = refine_probe(seen, sums, band, at, d, side, little)
            begin = band.end
            if seen.sufficient:
                break
        if seen.hit:
            return Hit(s, seen.surface.slope, looks + 1)
        s += seen.free_distance
        if s > max_distance or s == math.inf:
            return make_no_hit(NO_HIT, looks + 1)
    return make_no_hit(STEP_LIMIT_REACHED, MAX_STEPS)
