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
    top, bottom = single(layers.face[0]), single(layers.face[layers.face.size - 1])
    space = Space(single(1.0 / layers.attenuation[0]), bottom, top, bottom, top, top)
    mirrored = rules.wrong_side != LOBE
    saturation = single(layers.saturation[0])
    return Passing(
        space, fates_of(rules), saturation, rules.facets, mirrored, rules.point_grains
    )  # fmt: skip


@owner
def room(materials):
    """Return lanes of which none is in use."""
    state = aligned(rows.STATE)
    state[rows.STATUS : rows.STATUS + rows.LANES] = rows.IDLE
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    length = np.zeros((rows.LANES, materials))
    ray, item = np.zeros(rows.LANES, dtype=np.int64), np.zeros(rows.LANES, dtype=np.int64)
    return Lanes(state, words, length, ray, item, np.zeros(1, dtype=np.uint64))


@part
def advance(lanes, width, features, tables, task, notes):
    """Give all lanes between grains their next grain; see `flight` for what it returns."""
    draw_types(lanes.state, lanes.words, width, features, tables, task.scene.layers.share)
    if features.mixed is not None:
        for lane in range(width):
            if lanes.state[rows.STATUS + lane] == rows.FLYING:
                put_down(lanes, lane, task.scene)
    waiting = flight(lanes.state, lanes.words, width, features, task.passing)
    if features.mixed is not None:
        for lane in range(width):
            met = lanes.state[rows.STATUS + lane] == rows.TRIAL
            if met and lanes.state[rows.SHELL + lane] == ZERO:
                dress(lanes, lane, task)
                if features.layered is not None and lanes.state[rows.LANDED + lane] == ZERO:
                    land(lanes, lane, task, notes)
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

    ray: int
    rays: int
    item: int
    number: int
    busy: int
    lost: bool


@part
def next_of(queue, work):
    """Return the queue with the item of the next ray settled."""
    item, number = queue.item, queue.number
    while number == work[item, 2]:
        item += 1
        number = 0
    return Queue(queue.ray, queue.rays, item, number, queue.busy, False)


@part
def refill(lanes, lane, task, exits, queue):
    """Launch rays in a lane that is free until one enters the slab, or none is left."""
    state = lanes.state
    while queue.ray < queue.rays:
        queue = next_of(queue, task.work)
        lanes.length[lane] = 0.0
        lanes.ray[lane] = queue.ray
        lanes.item[lane] = queue.item
        entered = launch(lanes, lane, task, queue.number)
        busy = queue.busy + 1 if entered else queue.busy
        queue = Queue(queue.ray + 1, queue.rays, queue.item, queue.number + 1, busy, False)
        if entered:
            return queue
        leave(lanes, lane, exits)
    state[rows.STATUS + lane] = rows.IDLE
    return queue


@part
def at_face(lanes, lane, task, notes, status):
    """Serve a ray that meets a face or has to change its layer; return whether it leaves."""
    if status == rows.AT_GROUND:
        return True
    if task.features.layered is None:
        return at_boundary(lanes, lane, task)
    if status == rows.BACK:
        begin_again(lanes, lane, task)
        return False
    if status == rows.ASTRAY:
        relocate(lanes, lane, task, notes)
        return False
    return at_interface(lanes, lane, task, notes)


@part
def serve(lanes, width, task, notes, exits, legs, queue):
    """End the rays that are done, bring others through boundaries, and launch new ones."""
    state = lanes.state
    for lane in range(width):
        while state[rows.STATUS + lane] >= rows.AT_FACE:
            status = state[rows.STATUS + lane]
            if status == rows.LOST:
                return Queue(queue.ray, queue.rays, queue.item, queue.number, queue.busy, True)
            if status == rows.IDLE and queue.ray == queue.rays:
                break
            leaves = False
            if status <= rows.ASTRAY:
                leaves = at_face(lanes, lane, task, notes, status)
                if leaves and reaches_ground(lanes, lane, task):
                    at_ground(lanes, lane, task, notes)
                    leaves = False
                if not leaves:
                    break
            busy = queue.busy
            if status != rows.IDLE:
                busy -= 1
                legs[lanes.item[lane]] += lanes.words[rows.LEGS + lane]
            if leaves:
                put_down(lanes, lane, task.scene)
                leave(lanes, lane, exits)
            queue = Queue(queue.ray, queue.rays, queue.item, queue.number, busy, False)
            queue = refill(lanes, lane, task, exits, queue)
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
    width = min(rows.LANES, max(1, -(-queue.rays // rows.STRIDE)) * rows.STRIDE)
    flying, ended = 0, width
    # Between two looks at the room, a ray may land once and be served once.
    most = 2 * width * scene.layers.face.size
    while True:
        if not has_room(notes, most):
            notes = room_for(notes, most)
        if ended > 0:
            queue = serve(lanes, width, task, notes, exits, legs, queue)
            if queue.lost or queue.busy == 0:
                return Told(legs, queue.lost, taken(notes))
            if queue.busy <= width - rows.STRIDE:
                width = close_ranks(lanes, width, queue.busy)
            flying = count_flying(lanes.state, width)
        # Whichever pass serves more lanes.
        if 2 * flying >= queue.busy:
            waiting = advance(lanes, width, features, tables, task, notes)
            flying, ended = waiting.flying, waiting.ended
        else:
            flying = surface(lanes.state, lanes.words, width, features, task.passing)
            ended = 0
