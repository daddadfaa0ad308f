"""A batch of rays on lanes, for several ensembles at a time."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.flight import Space
from splits.transport.granular import Spent, fates_of
from splits.transport.jit import ZERO, entry, kernel
from splits.transport.lanes import rows
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
from splits.transport.lanes.flight import draw_types, flight
from splits.transport.lanes.rows import Passing
from splits.transport.lanes.surface import surface


@kernel
def passing_of(scene):
    """Return what the passes need to know of a scene."""
    grains, slab, rules = scene.grains, scene.slab, scene.rules
    space = Space(single(1.0 / grains.attenuation), -single(slab.depth), ZERO)
    mirrored = rules.wrong_side != 0
    return Passing(space, fates_of(rules), single(slab.saturation), rules.facets, mirrored)


@kernel
def room(materials):
    """Return lanes of which none is in use."""
    state = np.zeros(rows.STATE, dtype=np.float32)
    state[rows.STATUS : rows.STATUS + rows.LANES] = rows.IDLE
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    length = np.zeros((rows.LANES, materials))
    ray, item = np.zeros(rows.LANES, dtype=np.int64), np.zeros(rows.LANES, dtype=np.int64)
    return Lanes(state, words, length, ray, item, np.zeros(1, dtype=np.uint64))


@kernel
def advance(lanes, width, features, tables, task):
    """Let the pass go over the lanes that serves more of them; see `flight` for what it returns."""
    draw_types(lanes.state, lanes.words, width, features, tables, task.scene.grains.share)
    if features.mixed is not None:
        for lane in range(width):
            if lanes.state[rows.STATUS + lane] == rows.FLYING:
                put_down(lanes, lane, task.scene.grains)
    waiting = flight(lanes.state, lanes.words, width, features, task.passing)
    if features.mixed is not None:
        for lane in range(width):
            met = lanes.state[rows.STATUS + lane] == rows.TRIAL
            if met and lanes.state[rows.LAYER + lane] == ZERO:
                dress(lanes, lane, task)
    return waiting


@entry
def batch(seed, work, scene, optics, exits, features):
    """Trace rays of several ensembles and record how they leave.

    Rays of all of them share the lanes: only once the last of all has started do lanes stand idle.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed,
        which takes ``features.orders``.  Seed, ensemble and number name a ray's random stream: it
        is the same in whatever lane and batch, and in whatever company.
    scene : Scene
        See `splits.transport.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item, see `splits.transport.tally`; must come from
        `exit_rows`.
    features : Features

    Returns
    -------
    legs : int64[items]
        Grains drawn: what the rays cost.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    grains = scene.grains
    tables = (
        grains.curvature.astype(np.float32),
        (1.0 - grains.sphericity * grains.sphericity).astype(np.float32),
        (0.5 * grains.facetness).astype(np.float32),
    )
    task = Task(seed, work, scene, optics, features, passing_of(scene))
    lanes = room(optics.n.shape[1])
    state = lanes.state
    legs = np.zeros(len(work), dtype=np.int64)
    rays = work[:, 2].sum()
    next_ray, item, number, busy = 0, 0, 0, 0
    width = min(rows.LANES, max(1, -(-rays // rows.STRIDE)) * rows.STRIDE)
    flying, ended = 0, width
    while True:
        if ended > 0:
            for lane in range(width):
                while state[rows.STATUS + lane] >= rows.AT_BOUNDARY:
                    status = state[rows.STATUS + lane]
                    if status == rows.LOST:
                        return Spent(legs, True)
                    leaves = False
                    if status == rows.AT_BOUNDARY:
                        leaves = at_boundary(lanes, lane, task)
                        if not leaves:
                            break
                    if status != rows.IDLE:
                        busy -= 1
                        legs[lanes.item[lane]] += lanes.words[rows.LEGS + lane]
                    if leaves:
                        put_down(lanes, lane, grains)
                        leave(lanes, lane, exits, features)
                    if next_ray == rays:
                        state[rows.STATUS + lane] = rows.IDLE
                        break
                    while number == work[item, 2]:
                        item += 1
                        number = 0
                    lanes.length[lane] = 0.0
                    lanes.ray[lane] = next_ray
                    lanes.item[lane] = item
                    entered = launch(lanes, lane, task, number)
                    next_ray += 1
                    number += 1
                    busy += 1
                    if not entered:
                        busy -= 1
                        leave(lanes, lane, exits, features)
                        state[rows.STATUS + lane] = rows.IDLE
            if busy == 0:
                return Spent(legs, False)
            if busy <= width - rows.STRIDE:
                width = close_ranks(lanes, width, busy)
            flying = 0
            for lane in range(width):
                if state[rows.STATUS + lane] == rows.FLYING:
                    flying += 1
        # Whichever pass serves more lanes.
        if 2 * flying >= busy:
            waiting = advance(lanes, width, features, tables, task)
            flying, ended = waiting.flying, waiting.ended
        else:
            flying = surface(state, lanes.words, width, features, task.passing)
            ended = 0
