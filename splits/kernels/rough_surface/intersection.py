"""Intersection of rays with a rough surface, by ray marching with Lipschitz bounds.

Rays advance in steps that are proven free of intersections by bounds on the slope and curvature of
the surface along the ray.  On surfaces of many scales the finest waves keep the steps short.  Waves
are therefore grouped in bands, and at some height above the surface the finer bands enter with
their maximum height only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.arithmetic import (
    add_scaled,
    dot,
    normalize,
    store_vector,
)
from splits.kernels.compiler.jit import entry_point, entry_point_no_refcount, inline, inline_only
from splits.kernels.interface import fresnel, refract
from splits.kernels.rough_surface.realization import (
    BAND_END,
    BOUND_SIGMA,
    FINER_HEIGHT,
    MAX_CURVATURE,
    MAX_SLOPE,
    TWO_PI,
    HeightAndSlope,
    SurfaceSlope,
    compute_height_and_slope,
    make_realization,
    sum_ray_bounds,
    sum_waves,
)
from splits.kernels.scene import Vector

NO_HIT = -1.0
"""No intersection within the distance that matters."""
STEP_LIMIT_REACHED = -2.0
"""Undecided after `MAX_STEPS`, as for horizontal rays."""
MAX_STEPS = 100_000_000
MIN_COS_EXIT = 1e-12
"""Smallest cosine between a direction that leaves a facet and the normal of the facet."""


class Hit(NamedTuple):
    """First intersection of a ray with a surface.

    Attributes
    ----------
    distance : float
        Distance (m); `NO_HIT` if there is no intersection within the distance of interest, or
        `STEP_LIMIT_REACHED`.
    slope : SurfaceSlope
        Slope of the surface there.
    n_evaluations : int
        Number of evaluations of the surface.
    """

    distance: float
    slope: SurfaceSlope
    n_evaluations: int


class SurfaceProbe(NamedTuple):
    """Surface at a point of a ray, from the bands evaluated so far.

    Attributes
    ----------
    surface : HeightAndSlope
    free_distance : float
        Distance that is free of intersections (m).
    hit, sufficient : bool
        Whether the ray hits the surface there; whether finer bands cannot extend the free distance.
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
    """Return a direction d that leaves a facet on the side of n, tilted off the facet if necessary.

    Rounding may leave a grazing direction on the wrong side.  The intersection search uses the same
    slopes and finds that the ray leaves the surface: the cosine is far above their rounding error.
    """
    lift = MIN_COS_EXIT - dot(d, n)
    if lift > 0.0:
        return normalize(add_scaled(lift + MIN_COS_EXIT, n, d))
    return d


@inline
def compute_height_tolerance(surface, position, s):
    """Return the height (m) below which a descending ray counts as a hit, after a distance s (m).

    It exceeds the rounding errors of heights, and of positions along steep surfaces far from the
    origin.  It is also the lower bound of heights, which keeps steps from vanishing.
    """
    far = abs(position.x) + abs(position.y) + s
    return 1e-12 * surface.max_height + 1e-15 * far * (1.0 + surface.max_slope)


@inline
def set_ray_bounds(surface, d):
    """Set the bounds of slope and curvature along a direction for every band."""
    slope, slope2, curvature, curvature2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    bands = surface.bands
    for band in range(surface.n_bands - 1, -1, -1):
        end = int(bands[BAND_END, band])
        sums = sum_ray_bounds(surface.waves, begin, end, d.x, d.y)
        slope += sums.slope
        slope2 += sums.slope2
        curvature += sums.curvature
        curvature2 += sums.curvature2
        bands[MAX_SLOPE, band] = TWO_PI * min(slope, BOUND_SIGMA * math.sqrt(0.5 * slope2))
        bands[MAX_CURVATURE, band] = TWO_PI**2 * min(
            curvature, BOUND_SIGMA * math.sqrt(0.5 * curvature2)
        )
        begin = end


@inline
def compute_safe_step(gap, rate, slope, curvature, climb):
    """Return the distance (m) that is free of intersections, inf if there is none ahead.

    Parameters
    ----------
    gap, rate : float
        Height above the surface, G > 0, and its change G' per metre.
    slope, curvature : float
        Bounds along the ray.
    climb : float
        Vertical component of the direction, away from the surface.
    """
    max_descent = slope - climb
    if max_descent <= 0.0:
        return math.inf
    # G + G's − C s²/2 = 0, without cancellation.
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate > 0.0:
        curved_distance = (rate + root) / max(curvature, 1e-300)
    else:
        curved_distance = 2.0 * gap / max(root - rate, 1e-300)
    return max(curved_distance, gap / max_descent)


@inline_only
def refine_probe(probe, sums, bands, number, point, d, side, tolerance):
    """Refine a `SurfaceProbe` with another band.

    Parameters
    ----------
    probe : SurfaceProbe
        Result of the bands before.
    sums : WaveSums
        Sums over the waves that the band adds.
    bands : float64 array
        See `SurfaceRealization`.
    number : int
        Of the band: 0 is the finest, with all waves.
    point, d : Vector
        Point of the ray and its direction.
    side : float
        See `find_first_intersection`.
    tolerance : float
        The `compute_height_tolerance`.

    Returns
    -------
    SurfaceProbe
    """
    height = probe.surface.height + sums.height
    slope_x = probe.surface.slope.x - 2.0 * TWO_PI * sums.scaled_slope_x
    slope_y = probe.surface.slope.y - 2.0 * TWO_PI * sums.scaled_slope_y
    finer_height = bands[FINER_HEIGHT, number]
    gap = side * (point.z - height) - finer_height
    rate = side * (d.z - slope_x * d.x - slope_y * d.y)
    hit, sufficient, free_distance = False, False, probe.free_distance
    if number == 0:
        hit = gap <= tolerance and rate < 0.0
        gap = max(gap, tolerance)
    if gap > 0.0 and not hit:
        slope, curvature = bands[MAX_SLOPE, number], bands[MAX_CURVATURE, number]
        step = compute_safe_step(gap, rate, slope, curvature, side * d.z)
        free_distance = max(free_distance, step)
        # If the finer waves have no height, finer bands cannot extend the step but decide hits.
        sufficient = gap > max(finer_height, tolerance)
    return SurfaceProbe(
        HeightAndSlope(height, SurfaceSlope(slope_x, slope_y)), free_distance, hit, sufficient
    )


@inline_only
def make_no_hit(distance, n_evaluations):
    """Return a `Hit` without intersection, with the distance `NO_HIT` or `STEP_LIMIT_REACHED`."""
    return Hit(distance, SurfaceSlope(0.0, 0.0), n_evaluations)


@entry_point_no_refcount
def find_first_intersection(surface, position, d, side, max_distance=math.inf):
    """Find the first intersection of a ray with the surface.

    A ray at a height G above the surface, with the derivative G' along the ray, cannot hit it
    within `compute_safe_step`.  Near an intersection these steps converge like Newton's method,
    from the side of the ray.  Only dips below the surface by less than `compute_height_tolerance`,
    and heights outside `BOUND_SIGMA`, are missed.  A ray that starts on the surface must leave it,
    see `nudge_off_surface`.

    Parameters
    ----------
    surface : SurfaceRealization
    position, d : Vector
        Start of the ray and its direction.
    side : float
        1 above the surface, −1 below.
    max_distance : float
        Largest distance of interest (m).

    Returns
    -------
    Hit
    """
    # Distance to the maximum height of the surface.
    s, above, climb = 0.0, side * position.z - surface.max_height, side * d.z
    if above > 0.0:
        s = above / -climb if climb < 0.0 else math.inf
    if s > max_distance or s == math.inf:
        return make_no_hit(NO_HIT, 0)
    set_ray_bounds(surface, d)
    for n_evaluations in range(MAX_STEPS):
        point = add_scaled(s, d, position)
        if side * d.z >= 0.0 and side * point.z > surface.max_height:
            return make_no_hit(NO_HIT, n_evaluations)
        probe, begin, tolerance = EMPTY_PROBE, 0, compute_height_tolerance(surface, point, s)
        for number in range(surface.n_bands - 1, -1, -1):
            end = int(surface.bands[BAND_END, number])
            sums = sum_waves(surface.waves, begin, end, point.x, point.y)
            probe = refine_probe(probe, sums, surface.bands, number, point, d, side, tolerance)
            begin = end
            if probe.sufficient:
                break
        if probe.hit:
            return Hit(s, probe.surface.slope, n_evaluations + 1)
        s += probe.free_distance
        if s > max_distance or s == math.inf:
            return make_no_hit(NO_HIT, n_evaluations + 1)
    return make_no_hit(STEP_LIMIT_REACHED, MAX_STEPS)


# --------------------------------------------------------------------------------------------------
# Refraction of vertical rays at a given realization of a rough surface.


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
        store_vector(position, refracted.position[ray], 0)
        store_vector(d, refracted.direction[ray], 0)
        refracted.next_hit_distance[ray] = math.inf if hit.distance == NO_HIT else hit.distance
    return refracted
