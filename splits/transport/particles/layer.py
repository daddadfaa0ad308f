"""A scattering layer under a smooth or a randomly rough Fresnel surface, over a diffuse bottom.

Budak & Grimailo 2020, section 3.2: free paths, scattering by small particles, reflection and
refraction at the surface, reflection by the bottom.  Single-scattering albedo is a weight along
the path, or a coin toss.  What a scene does not have, a rough surface, polarization or detectors,
is None and compiled away.
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.compiling.jit import entry, owner, part
from splits.transport.numerics.rng import start_stream, uniform
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.light import launched
from splits.transport.optics.stokes import rotated_to, unpolarized
from splits.transport.particles.layer_events import (
    ROULETTE_BELOW,
    at_facet,
    at_floor,
    at_surface,
    roulette,
    scattered,
    weakened,
)
from splits.transport.particles.layer_legs import (
    Past,
    Ray,
    ended,
    facet_ahead,
    gone_along,
    near_surface,
    smooth_ahead,
    ways_ahead,
)
from splits.transport.particles.local import listen_particle
from splits.transport.rough.march import GONE, first_crossing, no_hit
from splits.transport.rough.march import LOST as ASTRAY
from splits.transport.rough.waves import entrance, realised
from splits.transport.sums.tally import (
    ABSORBED,
    EXIT_LENGTH,
    LOST,
    REFLECTED,
    TRAVELS,
    Traced,
    record,
)

WORK = ENSEMBLE, FIRST, RAYS, MOST = tuple(range(4))
"""Entries of a piece of work, see `splits.transport.grains.granular.batch`."""
ALL, STRAIGHT = range(2)
"""All light, and light that met nothing but smooth faces."""


@owner
def trace(state, scene, surface_buffer, detectors, max_order):
    """Follow one ray from the light source until it leaves the layer or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    scene : Scene
    room : Surface or None
        Where realisations of the rough surface live, see `waves.room_for`; None if it is smooth.
    detectors : Detectors or None
        What hears of every scattering, see `splits.transport.particles.local`.
    most : int
        Scatterings, meetings with the bottom or with a rough surface, after which the ray counts
        as absorbed.

    Returns
    -------
    Ray
    """
    layer, phase = scene.layer, scene.phase
    d = launched(scene.source, uniform(state) if scene.source.diffuse_fraction > 0.0 else 1.0)
    surface = realised(state, scene.fields, surface_buffer)
    stokes = unpolarized(d, scene.stokes)
    ray = Ray(entrance(d, surface), d, stokes, False, Past(1.0, 0.0, 0, 0), TRAVELS)
    while ray.status == TRAVELS:
        ways = ways_ahead(ray, layer, uniform(state) if ray.inside else 1.0)
        if surface_buffer is None:
            ahead = smooth_ahead(ray)
        else:
            hit = no_hit(GONE, 0)
            if near_surface(ray, surface.max_height, ways.nearest):
                side = -1.0 if ray.inside else 1.0
                hit = first_crossing(surface, ray.position, ray.direction, side, ways.nearest)
            if hit.distance == ASTRAY:
                return ended(ray, LOST)
            ahead = facet_ahead(hit)
        if ahead.distance == math.inf and not ray.inside:
            ray = ended(gone_along(ray, 0.0), REFLECTED if ray.direction.z > 0.0 else LOST)
            continue
        ray = gone_along(ray, min(ways.nearest, ahead.distance))
        if ahead.distance <= ways.nearest:
            if surface_buffer is None:
                ray = at_surface(state, ray, layer)
            else:
                ray = at_facet(state, ray, ahead.normal, layer, max_order)
        elif ways.bottom <= ways.collision:
            ray = at_floor(state, ray, layer, phase, detectors, max_order)
        else:
            ray = weakened(ray, layer, uniform(state) if layer.analog else 1.0, max_order)
            if detectors is not None and ray.status == TRAVELS:
                listen_particle(state, detectors, layer, phase, ray)
            if ray.history.weight < ROULETTE_BELOW:
                ray = roulette(ray, uniform(state))
            if ray.status == TRAVELS:
                ray = scattered(state, ray, phase)
    return ray


@part
def _record_stokes(row, first_column, d, stokes):
    """Write Q, U, V over I into three columns of a row, Q along the plane of the normal."""
    if stokes is None:
        return
    # Straight up or down, every plane holds the normal.
    upright = d.x == 0.0 and d.y == 0.0
    seen = rotated_to(stokes, d, Vector(1.0 if upright else d.x, d.y, 0.0))
    row[first_column], row[first_column + 1], row[first_column + 2] = seen.q, seen.u, stokes.v


@entry
def batch(seed, work, scene, surface_buffer, stokes_column, exits):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed, work
        See `splits.transport.grains.granular.batch`.
    scene, room
        See `trace`.
    first_stokes : int
        First of three columns of exits for polarized rays: Q, U, V over I.
    exits : float64[rays, columns]
        A row for each ray, see `splits.transport.sums.tally`.

    Returns
    -------
    Traced
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[RAYS]):
        start_stream(state, seed, work[ENSEMBLE], work[FIRST] + number)
        ray = trace(state, scene, surface_buffer, None, work[MOST])
        legs += ray.history.n_segments
        if ray.status == LOST:
            return Traced(legs, True)
        if ray.status == ABSORBED:
            continue
        row = exits[number]
        record(row, ray.status == REFLECTED, ray.position, ray.direction, ray.history.weight, ray.history.order)
        row[EXIT_LENGTH] = ray.history.path_length
        _record_stokes(row, stokes_column, ray.direction, ray.stokes)
    return Traced(legs, False)


@entry
def hear(seed, work, scene, detectors, totals):
    """Trace rays under a smooth surface for detectors to hear, and return the legs traced.

    Parameters
    ----------
    seed, work, scene
        See `batch`.
    detectors : Detectors
        Advanced in place.
    totals : float64[2, 2]
        [reflected, transmitted][all light, light that met nothing but smooth faces], advanced in
        place.
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[RAYS]):
        start_stream(state, seed, work[ENSEMBLE], work[FIRST] + number)
        ray = trace(state, scene, None, detectors, work[MOST])
        legs += ray.history.n_segments
        if ray.status != ABSORBED:
            total = totals[0 if ray.status == REFLECTED else 1]
            total[ALL] += ray.history.weight
            if ray.history.order == 0:
                total[STRAIGHT] += ray.history.weight
    return legs
