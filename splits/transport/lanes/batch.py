"""A batch of rays on lanes, for several ensembles at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.alignment import align_stack, aligned
from splits.transport.compiling.jit import ZERO, entry, owner, part
from splits.transport.grains.flight import Space
from splits.transport.grains.scalar import fates_of
from splits.transport.grains.scene import LOBE
from splits.transport.lanes import rows
from splits.transport.lanes.draws import draw_types
from splits.transport.lanes.ends import (
    Lanes,
    Task,
    at_boundary,
    close_ranks,
    dress,
    launch,
    leave,
    put_down,
)
from splits.transport.lanes.flight import flight
from splits.transport.lanes.ground import at_ground, reaches_ground
from splits.transport.lanes.layers import at_interface, begin_again, land, relocate
from splits.transport.lanes.rows import Passing
from splits.transport.lanes.surface import surface
from splits.transport.sums.notes import has_room, no_notes, room_for, taken
from splits.transport.sums.tally import Told


@part
def passing_of(scene):
    """Return what the passes need to know of a scene."""
    layers, rules = scene.layers, scene.rules
    top, bottom = single(layers.boundaries[0]), single(layers.boundaries[layers.boundaries.size - 1])
    space = Space(single(1.0 / layers.attenuation[0]), bottom, top, bottom, top, top)
    mirrored = rules.wrong_side != LOBE
    saturation = single(layers.saturation[0])
    return Passing(
        space, fates_of(rules), saturation, rules.facet_sampling, mirrored, rules.point_grains
    )  # fmt: skip


@owner
def room(n_materials):
    """Return lanes of which none is in use."""
    state = aligned(rows.STATE)
    state[rows.STATUS : rows.STATUS + rows.LANES] = rows.IDLE
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    length = np.zeros((rows.LANES, n_materials))
    ray, item = np.zeros(rows.LANES, dtype=np.int64), np.zeros(rows.LANES, dtype=np.int64)
    return Lanes(state, words, length, ray, item, np.zeros(1, dtype=np.uint64))


@part
def advance(lanes, width, features, tables, job, crossings):
    """Give all lanes between grains their next grain; see `flight` for what it returns."""
    draw_types(lanes.state, lanes.words, width, features, tables, job.scene.layers.type_cdf)
    if features.mixed is not None:
        for lane in range(width):
            if lanes.state[rows.STATUS + lane] == rows.FLYING:
                put_down(lanes, lane, job.scene)
    waiting = flight(lanes.state, lanes.words, width, features, job.constants)
    if features.mixed is not None:
        for lane in range(width):
            met = lanes.state[rows.STATUS + lane] == rows.TRIAL
            if met and lanes.state[rows.SHELL + lane] == ZERO:
                dress(lanes, lane, job)
                if features.layered is not None and lanes.state[rows.LANDED + lane] == ZERO:
                    land(lanes, lane, job, crossings)
    return waiting


class Queue(NamedTuple):
    """Rays that wait to be launched, and how many are on their way.

    Attributes
    ----------
    ray, rays : int
        Next ray of all, and how many there are.
    item, number : int
        Item of the next ray, and its number within that.
    busy : int
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


@part
def next_of(queue, work):
    """Return the queue with the item of the next ray settled."""
    item, number = queue.item, queue.ray_in_item
    while number == work[item, 2]:
        item += 1
        number = 0
    return Queue(queue.next_ray, queue.n_rays, item, number, queue.n_active, False)


@part
def refill(lanes, lane, job, exits, queue):
    """Launch rays in a lane that is free until one enters the slab, or none is left."""
    state = lanes.state
    while queue.next_ray < queue.n_rays:
        queue = next_of(queue, job.work)
        lanes.path_lengths[lane] = 0.0
        lanes.ray[lane] = queue.next_ray
        lanes.item[lane] = queue.item
        entered = launch(lanes, lane, job, queue.ray_in_item)
        busy = queue.n_active + 1 if entered else queue.n_active
        queue = Queue(queue.next_ray + 1, queue.n_rays, queue.item, queue.ray_in_item + 1, busy, False)
        if entered:
            return queue
        leave(lanes, lane, exits)
    state[rows.STATUS + lane] = rows.IDLE
    return queue


@part
def at_face(lanes, lane, job, crossings, status):
    """Serve a ray that meets a face or has to change its layer; return whether it leaves."""
    if status == rows.AT_GROUND:
        return True
    if job.features.layered is None:
        return at_boundary(lanes, lane, job)
    if status == rows.BACK:
        begin_again(lanes, lane, job)
        return False
    if status == rows.ASTRAY:
        relocate(lanes, lane, job, crossings)
        return False
    return at_interface(lanes, lane, job, crossings)


@part
def serve(lanes, width, job, crossings, exits, n_segments, queue):
    """End the rays that are done, bring others through boundaries, and launch new ones."""
    state = lanes.state
    for lane in range(width):
        while state[rows.STATUS + lane] >= rows.AT_FACE:
            status = state[rows.STATUS + lane]
            if status == rows.LOST:
                return Queue(queue.next_ray, queue.n_rays, queue.item, queue.ray_in_item, queue.n_active, True)
            if status == rows.IDLE and queue.next_ray == queue.n_rays:
                break
            leaves = False
            if status <= rows.ASTRAY:
                leaves = at_face(lanes, lane, job, crossings, status)
                if leaves and reaches_ground(lanes, lane, job):
                    at_ground(lanes, lane, job, crossings)
                    leaves = False
                if not leaves:
                    break
            busy = queue.n_active
            if status != rows.IDLE:
                busy -= 1
                n_segments[lanes.item[lane]] += lanes.words[rows.LEGS + lane]
            if leaves:
                put_down(lanes, lane, job.scene)
                leave(lanes, lane, exits)
            queue = Queue(queue.next_ray, queue.n_rays, queue.item, queue.ray_in_item, busy, False)
            queue = refill(lanes, lane, job, exits, queue)
            break
    return queue


@part
def count_flying(state, width):
    """Return how many lanes wait for a grain, or for the next call of `serve`."""
    flying = 0
    for lane in range(width):
        status = state[rows.STATUS + lane]
        if status == rows.FLYING or rows.AT_FACE <= status < rows.IDLE:
            flying += 1
    return flying


@entry
def batch(seed, work, scene, optics, exits, features):
    """Trace rays of several ensembles and record how they leave.

    Rays of all of them share the lanes: only once the last of all has started do lanes stand idle.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same in whatever lane and
        batch, and in whatever company.
    scene : Scene
        See `splits.transport.grains.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item, see `splits.transport.sums.tally`; must come from
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
    task = Task(seed, work, scene, optics, features, passing_of(scene))
    lanes = room(optics.n.shape[1])
    legs = np.zeros(len(work), dtype=np.int64)
    queue = Queue(0, work[:, 2].sum(), 0, 0, 0, False)
    notes = no_notes(optics.n.shape[1])
    width = min(rows.LANES, max(1, -(-queue.n_rays // rows.STRIDE)) * rows.STRIDE)
    flying, ended = 0, width
    # Between two looks at the room, a ray may land once and be served once.
    most = 2 * width * scene.layers.boundaries.size
    while True:
        if not has_room(notes, most):
            notes = room_for(notes, most)
        if ended > 0:
            queue = serve(lanes, width, task, notes, exits, legs, queue)
            if queue.lost or queue.n_active == 0:
                return Told(legs, queue.lost, taken(notes))
            if queue.n_active <= width - rows.STRIDE:
                width = close_ranks(lanes, width, queue.n_active)
            flying = count_flying(lanes.state, width)
        # Whichever pass serves more lanes.
        if 2 * flying >= queue.n_active:
            waiting = advance(lanes, width, features, tables, task, notes)
            flying, ended = waiting.n_in_flight, waiting.n_finished
        else:
            flying = surface(lanes.state, lanes.words, width, features, task.constants)
            ended = 0
