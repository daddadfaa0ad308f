"""A batch of rays on lanes, for several ensembles at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.alignment import align_stack, allocate_aligned
from splits.kernels.compiler.jit import ZERO, entry_point, inline_allocating, inline_only
from splits.kernels.grains.free_path import LayerGeometry
from splits.kernels.grains.scene import WRONG_SIDE_LOBE
from splits.kernels.grains.state import make_rejection_rules
from splits.kernels.tallies.crossings import (
    allocate_bank,
    ensure_capacity,
    get_recorded,
    has_capacity,
)
from splits.kernels.tallies.exits import BatchResult
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.flight import run_flight_pass
from splits.kernels.vectorized.ground import reaches_ground, reflect_from_ground
from splits.kernels.vectorized.interaction import run_surface_pass
from splits.kernels.vectorized.lane_state import PassConstants
from splits.kernels.vectorized.layers import (
    attenuate_segment,
    cross_interface,
    locate_layer,
    restart_flight,
)
from splits.kernels.vectorized.lifecycle import (
    BatchJob,
    LaneState,
    compact_lanes,
    cross_boundary,
    flush_path_lengths,
    record_lane_exit,
    sample_source,
    set_grain_optics,
)
from splits.kernels.vectorized.sampling import draw_grain_properties


@inline_only
def make_pass_constants(scene):
    """Return what the passes need to know of a scene."""
    layers, rules = scene.layers, scene.rules
    top, bottom = (
        single(layers.boundaries[0]),
        single(layers.boundaries[layers.boundaries.size - 1]),
    )
    space = LayerGeometry(single(1.0 / layers.attenuation[0]), bottom, top, bottom, top, top)
    mirrored = rules.wrong_side != WRONG_SIDE_LOBE
    saturation = single(layers.saturation[0])
    return PassConstants(
        space, make_rejection_rules(rules), saturation, rules.facet_sampling, mirrored, rules.point_grains
    )  # fmt: skip


@inline_allocating
def allocate_lanes(n_materials):
    """Return lanes of which none is in use."""
    state = allocate_aligned(lane_state.STATE_SIZE)
    state[lane_state.STATUS : lane_state.STATUS + lane_state.N_LANES] = lane_state.IDLE
    words = np.zeros(lane_state.WORDS_SIZE, dtype=np.uint32)
    length = np.zeros((lane_state.N_LANES, n_materials))
    ray, item = (
        np.zeros(lane_state.N_LANES, dtype=np.int64),
        np.zeros(lane_state.N_LANES, dtype=np.int64),
    )
    return LaneState(state, words, length, ray, item, np.zeros(1, dtype=np.uint64))


@inline_only
def advance_flights(lanes, width, features, tables, job, crossings):
    """Give all lanes between grains their next grain; see `run_flight_pass` for what it returns."""
    draw_grain_properties(
        lanes.state, lanes.words, width, features, tables, job.scene.layers.type_cdf
    )
    if features.mixed is not None:
        for lane in range(width):
            if lanes.state[lane_state.STATUS + lane] == lane_state.IN_FLIGHT:
                flush_path_lengths(lanes, lane, job.scene)
    waiting = run_flight_pass(lanes.state, lanes.words, width, features, job.constants)
    if features.mixed is not None:
        for lane in range(width):
            met = lanes.state[lane_state.STATUS + lane] == lane_state.AT_SURFACE
            if met and lanes.state[lane_state.SHELL + lane] == ZERO:
                set_grain_optics(lanes, lane, job)
                if (
                    features.layered is not None
                    and lanes.state[lane_state.SEGMENT_ATTENUATED + lane] == ZERO
                ):
                    attenuate_segment(lanes, lane, job, crossings)
    return waiting


class SourceQueue(NamedTuple):
    """Rays that wait to be launched, and how many are on their way.

    Attributes
    ----------
    next_ray, n_rays : int
        Next ray of all, and how many there are.
    item, ray_in_item : int
        Item of the next ray, and its number within that.
    n_active : int
        Rays on their way.
    lost : bool
        A ray found no grain that fits.
    """

    next_ray: int
    n_rays: int
    item: int
    ray_in_item: int
    n_active: int
    lost: bool


@inline_only
def skip_finished_items(queue, work):
    """Return the queue with the item of the next ray settled."""
    item, number = queue.item, queue.ray_in_item
    while number == work[item, 2]:
        item += 1
        number = 0
    return SourceQueue(queue.next_ray, queue.n_rays, item, number, queue.n_active, False)


@inline_only
def launch_next_ray(lanes, lane, job, exits, queue):
    """Launch rays in a lane that is free until one enters the slab, or none is left."""
    state = lanes.state
    while queue.next_ray < queue.n_rays:
        queue = skip_finished_items(queue, job.work)
        lanes.path_lengths[lane] = 0.0
        lanes.ray[lane] = queue.next_ray
        lanes.item[lane] = queue.item
        entered = sample_source(lanes, lane, job, queue.ray_in_item)
        busy = queue.n_active + 1 if entered else queue.n_active
        queue = SourceQueue(
            queue.next_ray + 1, queue.n_rays, queue.item, queue.ray_in_item + 1, busy, False
        )
        if entered:
            return queue
        record_lane_exit(lanes, lane, exits)
    state[lane_state.STATUS + lane] = lane_state.IDLE
    return queue


@inline_only
def handle_boundary(lanes, lane, job, crossings, status):
    """Serve a ray that meets a face or has to change its layer; return whether it leaves."""
    if status == lane_state.AT_GROUND:
        return True
    if job.features.layered is None:
        return cross_boundary(lanes, lane, job)
    if status == lane_state.RESTART:
        restart_flight(lanes, lane, job)
        return False
    if status == lane_state.RELOCATE:
        locate_layer(lanes, lane, job, crossings)
        return False
    return cross_interface(lanes, lane, job, crossings)


@inline_only
def service_lanes(lanes, width, job, crossings, exits, n_segments, queue):
    """End the rays that are done, bring others through boundaries, and launch new ones."""
    state = lanes.state
    for lane in range(width):
        while state[lane_state.STATUS + lane] >= lane_state.AT_BOUNDARY:
            status = state[lane_state.STATUS + lane]
            if status == lane_state.LOST:
                return SourceQueue(
                    queue.next_ray,
                    queue.n_rays,
                    queue.item,
                    queue.ray_in_item,
                    queue.n_active,
                    True,
                )
            if status == lane_state.IDLE and queue.next_ray == queue.n_rays:
                break
            leaves = False
            if status <= lane_state.RELOCATE:
                leaves = handle_boundary(lanes, lane, job, crossings, status)
                if leaves and reaches_ground(lanes, lane, job):
                    reflect_from_ground(lanes, lane, job, crossings)
                    leaves = False
                if not leaves:
                    break
            busy = queue.n_active
            if status != lane_state.IDLE:
                busy -= 1
                n_segments[lanes.item[lane]] += lanes.words[lane_state.N_SEGMENTS + lane]
            if leaves:
                flush_path_lengths(lanes, lane, job.scene)
                record_lane_exit(lanes, lane, exits)
            queue = SourceQueue(
                queue.next_ray, queue.n_rays, queue.item, queue.ray_in_item, busy, False
            )
            queue = launch_next_ray(lanes, lane, job, exits, queue)
            break
    return queue


@inline_only
def count_in_flight(state, width):
    """Return how many lanes wait for a grain, or for the next call of `service_lanes`."""
    flying = 0
    for lane in range(width):
        status = state[lane_state.STATUS + lane]
        if status == lane_state.IN_FLIGHT or lane_state.AT_BOUNDARY <= status < lane_state.IDLE:
            flying += 1
    return flying


@entry_point
def trace_batch(seed, work, scene, optics, exits, features):
    """Trace rays of several ensembles and record how they leave.

    Rays of all of them share the lanes: only once the last of all has started do lanes stand idle.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same in whatever lane and
        batch, and in whatever company.
    scene : LayerScene
        See `splits.kernels.grains.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item, see `splits.kernels.tallies.exits`; must come from
        `exit_rows`.
    features : Features

    Returns
    -------
    Told
        Its legs int64[items], the grains drawn: what the rays cost.  Its notes are of rays that
        reach a ground; each ray's are in the order of time.
    """
    align_stack()
    types = scene.types
    tables = (
        types.curvature.astype(np.float32),
        (1.0 - types.sphericity * types.sphericity).astype(np.float32),
        (0.5 * types.facetness).astype(np.float32),
    )
    task = BatchJob(seed, work, scene, optics, features, make_pass_constants(scene))
    lanes = allocate_lanes(optics.n.shape[1])
    legs = np.zeros(len(work), dtype=np.int64)
    queue = SourceQueue(0, work[:, 2].sum(), 0, 0, 0, False)
    notes = allocate_bank(optics.n.shape[1])
    width = min(
        lane_state.N_LANES, max(1, -(-queue.n_rays // lane_state.STRIDE)) * lane_state.STRIDE
    )
    flying, ended = 0, width
    # Between two looks at the room, a ray may land once and be served once.
    most = 2 * width * scene.layers.boundaries.size
    while True:
        if not has_capacity(notes, most):
            notes = ensure_capacity(notes, most)
        if ended > 0:
            queue = service_lanes(lanes, width, task, notes, exits, legs, queue)
            if queue.lost or queue.n_active == 0:
                return BatchResult(legs, queue.lost, get_recorded(notes))
            if queue.n_active <= width - lane_state.STRIDE:
                width = compact_lanes(lanes, width, queue.n_active)
            flying = count_in_flight(lanes.state, width)
        # Whichever pass serves more lanes.
        if 2 * flying >= queue.n_active:
            waiting = advance_flights(lanes, width, features, tables, task, notes)
            flying, ended = waiting.n_in_flight, waiting.n_finished
        else:
            flying = run_surface_pass(lanes.state, lanes.words, width, features, task.constants)
            ended = 0
