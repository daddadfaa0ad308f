"""History loop of the scalar kernel: single rays through layers of grains and particles.

Layers are horizontal and infinitely extended.  A rough surface may lie on top of them and a ground
below; hits of the ground are recorded as crossings, with the weight of the ray, unless absorption
there is analog.  Features absent from a scene (grains, particles, rough surface,
polarization, detectors) are None and compiled away.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_only
from splits.kernels.rays import make_ray, sample_source_direction
from splits.kernels.records import EXIT_LENGTH, TraceResult
from splits.kernels.rng import start_stream, uniform
from splits.kernels.rough_surface.realization import (
    compute_entry_position,
    sample_realization_if_rough,
)
from splits.kernels.scene import (
    ABSORBED,
    ALIVE,
    FIRST_RAY,
    LOST,
    MAX_ORDER,
    N_RAYS,
    REFLECTED,
    STREAM,
    TO_GROUND,
    Vector,
)
from splits.kernels.stokes import make_unpolarized, rotate_reference_to
from splits.kernels.tallies.exits import (
    allocate_crossings,
    append_crossing,
    copy_into_row,
    count_recorded,
    encode_crossing,
    enlarge_buffer,
    get_recorded,
    has_capacity,
    record_exit,
    set_current_ray,
)
from splits.kernels.transport.events import (
    apply_roulette,
    collide,
    cross_interface,
    enter_layer,
    find_first_roulette,
    interact_at_rough_top,
    intersect_rough_top,
    reflect_from_ground,
    trace_above_surface,
)
from splits.kernels.transport.flight import (
    BOUNDARY,
    ROUGH_TOP,
    attenuate_segment,
    end_segment,
    locate_layer,
    sample_next_event,
)

TOTAL, UNSCATTERED = range(2)
"""Columns of totals: all light, and light that only smooth interfaces reflected or refracted."""


@inline_only
def trace_history(state, ray, scene, optics, path_lengths, crossings, rough_top):
    """Trace the history of a ray until it ends.

    The loop plays roulette, samples the next event (a collision, a layer boundary or a facet of the
    rough top), attenuates the ray on the way there, and lets it interact.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    ray : Ray
    scene, optics
        See `splits.kernels.scene`.
    path_lengths : float64[materials]
        Path lengths (m), accumulated in place.
    crossings : CrossingBuffer or None
        Records of boundary crossings; None compiles them away.
    rough_top : SurfaceRealization or None
        The rough surface on top; None for a smooth one.

    Returns
    -------
    Ray
        With the status `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `TO_GROUND` or `LOST`; `ALIVE` if
        `crossings` may lack capacity for the next segment.
    """
    layers = scene.layers
    while ray.status == ALIVE:
        if crossings is not None and not has_capacity(crossings, 2 * layers.boundaries.size):
            break
        ray = apply_roulette(state, ray, scene.detectors)
        if ray.status != ALIVE:
            break
        ray = locate_layer(ray, scene, optics, path_lengths, crossings)
        event = sample_next_event(state, ray, scene, optics)
        event = intersect_rough_top(rough_top, ray, event, layers.boundaries[1])
        ray = end_segment(ray, event)
        ray = attenuate_segment(state, ray, event.layer, scene, optics, path_lengths, crossings)
        if ray.status == ALIVE:
            ray = interact(state, ray, event, scene, optics, path_lengths, crossings, rough_top)
    return ray


@inline_only
def interact(state, ray, event, scene, optics, path_lengths, crossings, rough_top):
    """Return a ray after its event; parameters are those of `trace_history`."""
    if event.kind == ROUGH_TOP:
        return interact_at_rough_top(state, ray, event.slope, scene, optics, rough_top)
    if event.kind == BOUNDARY:
        return cross_interface(state, ray, scene, optics, path_lengths, crossings)
    return collide(state, ray, event, scene, optics, path_lengths)


@inline_only
def sample_source(state, scene, optics, rough_top, max_order):
    """Sample a ray of the light source, and its entry into the medium at the top."""
    source = scene.source
    direction = sample_source_direction(
        source, uniform(state) if source.diffuse_fraction > 0.0 else 1.0
    )
    stokes = scene.stokes
    if source.diffuse_fraction > 0.0:
        stokes = make_unpolarized(direction, stokes)
    position = compute_entry_position(direction, rough_top)
    ray = make_ray(position, direction, stokes, 0.0, find_first_roulette(scene), max_order)
    if rough_top is None:
        return enter_layer(state, ray, scene, optics)
    return trace_above_surface(state, ray, scene, optics, rough_top)


@inline_only
def trace_ray(state, scene, optics, path_lengths, crossings, rough_top, max_order):
    """Trace a ray from the light source, with reflections from the ground, until it ends.

    Parameters are those of `trace_history` and `sample_source`.

    Returns
    -------
    Ray
        `ALIVE` or `TO_GROUND` if `crossings` lacks capacity.
    """
    n_boundaries = scene.layers.boundaries.size
    path_lengths[:] = 0.0
    ray = sample_source(state, scene, optics, rough_top, max_order)
    while ray.status == ALIVE or ray.status == TO_GROUND:
        if crossings is not None and not has_capacity(crossings, 2 * n_boundaries):
            break
        if ray.status == ALIVE:
            ray = trace_history(state, ray, scene, optics, path_lengths, crossings, rough_top)
            continue
        if crossings is not None and scene.ground_albedo is None and not scene.rules.analog:
            code = encode_crossing(n_boundaries - 2, False)
            append_crossing(crossings, code, ray.weight, path_lengths)
        ray = reflect_from_ground(state, ray, scene, optics, path_lengths)
    return ray


@inline_only
def record_ray(row, ray, path_lengths):
    """Write the exit of a ray into its row: Q, U and V over I follow the path lengths."""
    reflected = ray.status == REFLECTED
    record_exit(row, reflected, ray.position, ray.direction, ray.weight, ray.order)
    copy_into_row(row, EXIT_LENGTH, path_lengths)
    if ray.stokes is None:
        return
    d = ray.direction
    # For a vertical ray the plane of the normal is undefined, and the x axis is taken.
    vertical = d.x == 0.0 and d.y == 0.0
    rotated = rotate_reference_to(ray.stokes, d, Vector(1.0 if vertical else d.x, d.y, 0.0))
    column = EXIT_LENGTH + path_lengths.size
    row[column], row[column + 1], row[column + 2] = rotated.q, rotated.u, ray.stokes.v


@entry_point
def trace_rays(seed, work, scene, optics, exits, surface_buffer):
    """Trace the rays of a work item and record their exits.

    Parameters
    ----------
    seed : int
    work : int64[4]
        See `splits.kernels.scene`.
    scene, optics
        See `splits.kernels.scene`.
    exits : float64[rays, columns]
        A row for each ray, from `splits.kernels.tallies.exits.allocate_exits`; polarized rays have
        three columns more, Q, U, V over I, with Q along the plane of the normal.
    surface_buffer : SurfaceRealization or None
        Buffer of realizations of a rough surface, see `realization.allocate_realization`.

    Returns
    -------
    TraceResult
        With the crossings of boundaries, if the scene records them, and the hits of the ground,
        unless absorption there is analog.
    """
    number, n_recorded = 0, 0
    n_segments = np.zeros(1, dtype=np.int64)
    path_lengths = np.zeros(optics.n.size)
    state = np.zeros(1, dtype=np.uint64)
    crossings = allocate_crossings(optics.n.size)
    while number < work[N_RAYS]:
        while number < work[N_RAYS]:
            start_stream(state, seed, work[STREAM], work[FIRST_RAY] + number)
            n_recorded = count_recorded(crossings)
            set_current_ray(crossings, number)
            rough_top = sample_realization_if_rough(state, scene.height_fields, surface_buffer)
            ray = trace_ray(
                state, scene, optics, path_lengths, crossings, rough_top, work[MAX_ORDER]
            )
            if ray.status == ALIVE or ray.status == TO_GROUND:
                # The buffer is full.  The ray is traced again, with the same random numbers.
                break
            n_segments[0] += ray.n_segments
            if ray.status == LOST:
                return TraceResult(n_segments, True, get_recorded(crossings))
            if ray.status != ABSORBED:
                record_ray(exits[number], ray, path_lengths)
            number += 1
        if number < work[N_RAYS]:
            # References to the buffer are counted here, outside the loop over rays.
            crossings = enlarge_buffer(crossings, n_recorded, 0)
    return TraceResult(n_segments, False, get_recorded(crossings))


@entry_point
def trace_to_detectors(seed, work, scene, optics, totals):
    """Trace rays under a smooth surface, and score them at detectors.

    Parameters
    ----------
    seed, work, optics
        See `trace_rays`.
    scene : Scene
        With detectors, whose sums are accumulated in place; layers of particles only.
    totals : float64[2, 2]
        [reflected, transmitted][`TOTAL`, `UNSCATTERED`], accumulated in place.

    Returns
    -------
    TraceResult
        Without crossings.
    """
    n_segments = np.zeros(1, dtype=np.int64)
    path_lengths = np.zeros(optics.n.size)
    state = np.zeros(1, dtype=np.uint64)
    for number in range(work[N_RAYS]):
        start_stream(state, seed, work[STREAM], work[FIRST_RAY] + number)
        ray = trace_ray(state, scene, optics, path_lengths, None, None, work[MAX_ORDER])
        n_segments[0] += ray.n_segments
        if ray.status == LOST:
            return TraceResult(n_segments, True, None)
        if ray.status != ABSORBED:
            total = totals[0 if ray.status == REFLECTED else 1]
            total[TOTAL] += ray.weight
            if ray.order == 0:
                total[UNSCATTERED] += ray.weight
    return TraceResult(n_segments, False, None)
