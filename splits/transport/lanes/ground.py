"""Rays of lanes at the ground below the sample, between the passes."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.jit import ZERO, part
from splits.transport.grains.scene import NO_GROUND
from splits.transport.lanes import rows
from splits.transport.lanes.ends import draw, let_in, put_down
from splits.transport.lanes.layers import enter, set_out, take_note
from splits.transport.numerics.vectors import UP, lobe
from splits.transport.sums.notes import passage


@part
def reaches_ground(lanes, lane, job):
    """Tell whether a lane's ray that leaves the sample goes down to a ground."""
    return job.scene.ground_column != NO_GROUND and lanes.state[rows.DZ + lane] < ZERO


@part
def at_ground(lanes, lane, job, crossings):
    """Note a lane's ray as it meets the ground, and send it back by Lambert's law.

    One that the sample's lower face sends down again waits for the ground once more.  Among the
    grains met, of which there is a most, the ground counts as one.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ground, lowest = job.scene.ground_column, job.scene.layers.attenuation.size - 1
    put_down(lanes, lane, job.scene)
    take_note(lanes, lane, crossings, passage(lowest + 1, False))
    lanes.path_lengths[lane, ground] += 1.0
    state[rows.DEPTH + lane] += single(job.optics.absorption[item, ground])
    d = lobe(UP, draw(words, lane), draw(words, lane))
    passed = let_in(lanes, lane, job, lowest, d)
    if job.features.layered is not None:
        enter(lanes, lane, job, lowest)
        set_out(state, lane)
    state[rows.TRIES + lane] = ZERO
    state[rows.STATUS + lane] = rows.FLYING if passed else rows.AT_GROUND
    order = words[rows.ORDER + lane]
    words[rows.ORDER + lane] = np.uint32(order + np.uint32(1))
    if order >= words[rows.MOST + lane]:
        state[rows.STATUS + lane] = rows.ABSORBED
