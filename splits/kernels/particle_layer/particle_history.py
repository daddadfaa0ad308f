"""History loop of a scattering layer under a smooth or a randomly rough surface.

Budak & Grimailo 2020, section 3.2: free paths, scattering by small particles, reflection and
refraction at the surface, reflection by the diffuse bottom.  The single-scattering albedo reduces
the weight, or absorption is analog.  Features absent from a scene (rough surface, polarization,
detectors) are None and compiled away.
"""

from __future__ import annotations

import math

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_allocating, inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.math.rng import start_stream, uniform
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.source import sample_source_direction
from splits.kernels.optics.stokes import make_unpolarized, rotate_reference_to
from splits.kernels.particle_layer.collisions import (
    ROULETTE_THRESHOLD,
    absorb_at_particle,
    russian_roulette,
    scatter_at_bottom,
    scatter_at_facet,
    scatter_at_particle,
    scatter_at_surface,
)
from splits.kernels.particle_layer.next_event import score_scattering
from splits.kernels.particle_layer.state import (
    LayerRay,
    advance_ray,
    intersect_smooth_surface,
    is_near_surface,
    sample_event_distances,
    to_surface_hit,
)
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    find_first_intersection,
    make_no_hit,
)
from splits.kernels.rough_surface.realization import (
    compute_entry_position,
    sample_realization_if_rough,
)
from splits.kernels.tallies.exits import (
    ABSORBED,
    ALIVE,
    EXIT_LENGTH,
    LOST,
    REFLECTED,
    BatchStats,
    record_exit,
)

WORK_COLUMNS = ENSEMBLE, FIRST_RAY, N_RAYS, MAX_ORDER = tuple(range(4))
"""Entries of a work item, see `splits.kernels.grains.history.trace_batch`."""
TOTAL, UNSCATTERED = range(2)
"""Rows of totals: all light, and light that only smooth interfaces reflected or refracted."""


@inline_allocating
def trace_history(state, scene, surface_buffer, detectors, max_order):
    """Trace one ray from the light source until it leaves the layer or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    scene : LayerScene
    surface_buffer : SurfaceRealization or None
        Buffer for realizations of the rough surface, see `realization.allocate_realization`; None
        if the surface is smooth.
    detectors : Detectors or None
        Detectors of next-event estimation, see `splits.kernels.particle_layer.next_event`.
    max_order : int
        Largest number of scatterings and hits of the bottom or a rough surface; the ray then counts
        as absorbed.

    Returns
    -------
    LayerRay
    """
    layer, phase = scene.layer, scene.phase
    d = sample_source_direction(
        scene.source, uniform(state) if scene.source.diffuse_fraction > 0.0 else 1.0
    )
    surface = sample_realization_if_rough(state, scene.fields, surface_buffer)
    stokes = make_unpolarized(d, scene.stokes)
    position = compute_entry_position(d, surface)
    ray = LayerRay(position, d, stokes, False, 1.0, 0.0, 0, 0, ALIVE)
    while ray.status == ALIVE:
        distances = sample_event_distances(ray, layer, uniform(state) if ray.inside else 1.0)
        if surface_buffer is None:
            surface_hit = intersect_smooth_surface(ray)
        else:
            hit = make_no_hit(NO_HIT, 0)
            if is_near_surface(ray, surface.max_height, distances.nearest):
                side = -1.0 if ray.inside else 1.0
                hit = find_first_intersection(
                    surface, ray.position, ray.direction, side, distances.nearest
                )
            if hit.distance == STEP_LIMIT_REACHED:
                return replace(ray, status=LOST)
            surface_hit = to_surface_hit(hit)
        if surface_hit.distance == math.inf and not ray.inside:
            ray = replace(
                advance_ray(ray, 0.0), status=REFLECTED if ray.direction.z > 0.0 else LOST
            )
            continue
        ray = advance_ray(ray, min(distances.nearest, surface_hit.distance))
        if surface_hit.distance <= distances.nearest:
            if surface_buffer is None:
                ray = scatter_at_surface(state, ray, layer)
            else:
                ray = scatter_at_facet(state, ray, surface_hit.normal, layer, max_order)
        elif distances.bottom <= distances.collision:
            ray = scatter_at_bottom(state, ray, layer, phase, detectors, max_order)
        else:
            ray = absorb_at_particle(ray, layer, uniform(state) if layer.analog else 1.0, max_order)
            if detectors is not None and ray.status == ALIVE:
                score_scattering(state, detectors, layer, phase, ray)
            if ray.weight < ROULETTE_THRESHOLD:
                ray = russian_roulette(ray, uniform(state))
            if ray.status == ALIVE:
                ray = scatter_at_particle(state, ray, phase)
    return ray


@inline_only
def _record_stokes(row, first_column, d, stokes):
    """Write Q, U, V over I into three columns of a row, Q relative to the plane of the normal."""
    if stokes is None:
        return
    # For a vertical ray the plane of the normal is undefined, and the x axis is taken.
    vertical = d.x == 0.0 and d.y == 0.0
    rotated = rotate_reference_to(stokes, d, Vector(1.0 if vertical else d.x, d.y, 0.0))
    row[first_column], row[first_column + 1], row[first_column + 2] = rotated.q, rotated.u, stokes.v


@entry_point
def trace_batch(seed, work, scene, surface_buffer, stokes_column, exits):
    """Trace a batch of rays and record their exits.

    Parameters
    ----------
    seed, work
        See `splits.kernels.grains.history.trace_batch`.
    scene, surface_buffer
        See `trace_history`.
    stokes_column : int
        First of three columns of the exits of polarized rays: Q, U, V over I.
    exits : float64[rays, columns]
        A row for each ray, see `splits.kernels.tallies.exits`.

    Returns
    -------
    BatchStats
    """
    n_segments = 0
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[N_RAYS]):
        start_stream(state, seed, work[ENSEMBLE], work[FIRST_RAY] + number)
        ray = trace_history(state, scene, surface_buffer, None, work[MAX_ORDER])
        n_segments += ray.n_segments
        if ray.status == LOST:
            return BatchStats(n_segments, True)
        if ray.status == ABSORBED:
            continue
        row = exits[number]
        record_exit(
            row,
            ray.status == REFLECTED,
            ray.position,
            ray.direction,
            ray.weight,
            ray.order,
        )
        row[EXIT_LENGTH] = ray.path_length
        _record_stokes(row, stokes_column, ray.direction, ray.stokes)
    return BatchStats(n_segments, False)


@entry_point
def trace_to_detectors(seed, work, scene, detectors, totals):
    """Trace rays under a smooth surface, score them at detectors, and return the segments traced.

    Parameters
    ----------
    seed, work, scene
        See `trace_batch`.
    detectors : Detectors
        Advanced in place.
    totals : float64[2, 2]
        [reflected, transmitted][`TOTAL`, `UNSCATTERED`], accumulated in place.
    """
    n_segments = 0
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[N_RAYS]):
        start_stream(state, seed, work[ENSEMBLE], work[FIRST_RAY] + number)
        ray = trace_history(state, scene, None, detectors, work[MAX_ORDER])
        n_segments += ray.n_segments
        if ray.status != ABSORBED:
            total = totals[0 if ray.status == REFLECTED else 1]
            total[TOTAL] += ray.weight
            if ray.order == 0:
                total[UNSCATTERED] += ray.weight
    return n_segments
