"""Kernel that traces rays of several work items at once on lanes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.base.work import N_RAYS
from splits.kernels.compiler.alignment import align_stack, allocate_aligned
from splits.kernels.compiler.jit import ZERO, entry_point, inline_allocating, inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.tallies.crossings import (
    allocate_crossings,
    count_recorded,
    enlarge_buffer,
    get_recorded,
    has_capacity,
)
from splits.kernels.tallies.exits import TraceResult
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.flight import run_flight_pass
from splits.kernels.vectorized.interaction import run_surface_pass
from splits.kernels.vectorized.lane_optics import set_grain_optics
from splits.kernels.vectorized.lane_state import N_LANES, STRIDE, Lane
from splits.kernels.vectorized.layers import (
    attenuate_segment,
    cross_interface,
    locate_layer,
    reaches_ground,
    reflect_from_ground,
    restart_flight,
)
from splits.kernels.vectorized.lifecycle import (
    TraceJob,
    compact_lanes,
    cross_boundary,
    flush_path_lengths,
    record_lane_exit,
    sample_source,
)
from splits.kernels.vectorized.sampling import draw_grain_properties


@inline_allocating
def allocate_lanes():
    """Return the state of idle lanes."""
    state = allocate_aligned(lane_state.STATE_SIZE)
    for i in range(N_LANES):
        Lane(state, i).status = lane_state.IDLE
    return state


@inline_only
def advance_flights(state, path_lengths, width, tables, job, crossings):
    """Sample the next grain for all lanes between grains."""
    features = job.features
    draw_grain_properties(state, width, features, tables, job.scene.layers.type_cdf)
    if features.mixed is not None:
        for i in range(width):
            lane = Lane(state, i)
            if lane.status == lane_state.IN_FLIGHT:
                flush_path_lengths(lane, path_lengths[i], job.scene)
    run_flight_pass(state, width, features, job.scene.rules)
    if features.mixed is not None:
        for i in range(width):
            lane = Lane(state, i)
            if lane.status == lane_state.AT_SURFACE and lane.shell == ZERO:
                set_grain_optics(lane, job)
                if features.layered is not None and not lane.segment_attenuated:
                    attenuate_segment(lane, job, path_lengths[i], crossings)


class SourceQueue(NamedTuple):
    """Rays still to be launched, and the number of active rays.

    Attributes
    ----------
    next_ray, n_rays : int
        Next ray, and number of all rays.
    item, ray_in_item : int
        Work item of the next ray, and its number within the item.
    n_active : int
        Rays in the lanes.
    lost : bool
        A ray was lost.
    """

    next_ray: int
    n_rays: int
    item: int
    ray_in_item: int
    n_active: int
    lost: bool


@inline_only
def skip_finished_items(queue, work):
    """Advance the queue to the item of the next ray."""
    item, number = queue.item, queue.ray_in_item
    while number == work[item, N_RAYS]:
        item += 1
        number = 0
    return replace(queue, item=item, ray_in_item=number)


@inline_only
def launch_next_ray(lane, job, path_lengths, exits, queue):
    """Launch rays in a free lane until one enters the sample or none is left."""
    while queue.next_ray < queue.n_rays:
        queue = skip_finished_items(queue, job.work)
        path_lengths[:] = 0.0
        entered = sample_source(lane, job, queue.next_ray, queue.item, queue.ray_in_item)
        n_active = queue.n_active + 1 if entered else queue.n_active
        queue = replace(
            queue, next_ray=queue.next_ray + 1, ray_in_item=queue.ray_in_item + 1, n_active=n_active
        )
        if entered:
            return queue
        record_lane_exit(lane, path_lengths, exits)
    lane.status = lane_state.IDLE
    return queue


@inline_only
def handle_boundary(lane, job, path_lengths, crossings):
    """Handle a ray at a boundary, or one that changes its layer; return whether it leaves."""
    if lane.status == lane_state.AT_GROUND:
        return True
    if job.features.layered is None:
        return cross_boundary(lane, job)
    if lane.status == lane_state.RESTART:
        restart_flight(lane, job)
        return False
    if lane.status == lane_state.RELOCATE:
        locate_layer(lane, job, path_lengths, crossings)
        return False
    return cross_interface(lane, job, path_lengths, crossings)


@inline_only
def handle_waiting_lanes(state, all_path_lengths, width, job, crossings, exits, n_segments, queue):
    """Record finished rays, handle rays at boundaries, and launch new rays."""
    for i in range(width):
        lane, path_lengths = Lane(state, i), all_path_lengths[i]
        status = lane.status
        if status < lane_state.AT_BOUNDARY:
            continue
        if status == lane_state.LANE_LOST:
            return replace(queue, lost=True)
        if status == lane_state.IDLE and queue.next_ray == queue.n_rays:
            continue
        leaves = False
        if status <= lane_state.RELOCATE:
            leaves = handle_boundary(lane, job, path_lengths, crossings)
            if leaves and reaches_ground(lane, job):
                reflect_from_ground(lane, job, path_lengths, crossings)
                leaves = False
            if not leaves:
                continue
        if status != lane_state.IDLE:
            queue = replace(queue, n_active=queue.n_active - 1)
            n_segments[lane.item] += lane.n_segments
        if leaves:
            flush_path_lengths(lane, path_lengths, job.scene)
            record_lane_exit(lane, path_lengths, exits)
        queue = launch_next_ray(lane, job, path_lengths, exits, queue)
    return queue


@inline_only
def count_lanes(state, width):
    """Return the number of lanes in flight, and of those for `handle_waiting_lanes`."""
    n_in_flight, n_waiting = np.int32(0), np.int32(0)
    for i in range(width):
        status = Lane(state, i).status
        n_in_flight = np.int32(n_in_flight + (status == lane_state.IN_FLIGHT))
        n_waiting = np.int32(n_waiting + (status >= lane_state.AT_BOUNDARY))
    return n_in_flight, n_waiting


@entry_point
def trace_rays(seed, work, scene, optics, exits, features):
    """Trace the rays of several work items and record their exits.

    All items use the same lanes, which are idle only after the last ray was launched.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.kernels.base.work`.  Results of a ray do not depend on its lane either.
    scene : Scene
        See `splits.kernels.base.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item; must come from `exits.allocate_exits`.
    features : Features

    Returns
    -------
    TraceResult
        `n_segments` counts sampled grains.  `crossings` has the boundaries, if the scene records
        them, and the hits of the ground.
    """
    align_stack()
    types = scene.types
    tables = (
        types.inverse_semi_major.astype(np.float32),
        (1.0 - types.sphericity * types.sphericity).astype(np.float32),
        (0.5 * types.facetness).astype(np.float32),
    )
    job = TraceJob(seed, work, scene, optics, features)
    state, path_lengths = allocate_lanes(), np.zeros((N_LANES, optics.n.shape[1]))
    n_segments = np.zeros(len(work), dtype=np.int64)
    queue = SourceQueue(0, work[:, N_RAYS].sum(), 0, 0, 0, False)
    crossings = allocate_crossings(optics.n.shape[1])
    width = min(N_LANES, max(1, -(-queue.n_rays // STRIDE)) * STRIDE)
    # Between two checks of the capacity, a ray may hit a grain once and be served once.
    max_new_crossings = 2 * width * scene.layers.boundaries.size
    while True:
        if not has_capacity(crossings, max_new_crossings):
            n_kept = count_recorded(crossings)
            crossings = enlarge_buffer(crossings, n_kept, max_new_crossings)
        n_in_flight, n_waiting = count_lanes(state, width)
        if n_waiting > 0:
            queue = handle_waiting_lanes(
                state, path_lengths, width, job, crossings, exits, n_segments, queue
            )
            if queue.lost or queue.n_active == 0:
                return TraceResult(n_segments, queue.lost, get_recorded(crossings))
            if queue.n_active <= width - STRIDE:
                width = compact_lanes(state, path_lengths, width, queue.n_active)
            n_in_flight, _ = count_lanes(state, width)
        # The pass that serves more lanes is next.
        if 2 * n_in_flight >= queue.n_active:
            advance_flights(state, path_lengths, width, tables, job, crossings)
        else:
            run_surface_pass(state, width, features, scene.rules)
