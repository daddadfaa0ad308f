"""Rays of lanes at the ground below the sample, between the passes."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import ZERO, inline_only
from splits.kernels.grains.scene import NO_GROUND
from splits.kernels.math.vectors import UP, sample_cosine_lobe
from splits.kernels.tallies.crossings import encode_crossing
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.layers import append_lane_crossing, set_layer, start_flight
from splits.kernels.vectorized.lifecycle import draw_uniform, enter_layer, flush_path_lengths


@inline_only
def reaches_ground(lanes, lane, job):
    """Tell whether a lane's ray that leaves the sample goes down to a ground."""
    return job.scene.ground_column != NO_GROUND and lanes.state[lane_state.DIR_Z + lane] < ZERO


@inline_only
def reflect_from_ground(lanes, lane, job, crossings):
    """Note a lane's ray as it meets the ground, and send it back by Lambert's law.

    One that the sample's lower face sends down again waits for the ground once more.  Among the
    grains met, of which there is a most, the ground counts as one.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ground, lowest = job.scene.ground_column, job.scene.layers.attenuation.size - 1
    flush_path_lengths(lanes, lane, job.scene)
    append_lane_crossing(lanes, lane, crossings, encode_crossing(lowest + 1, False))
    lanes.path_lengths[lane, ground] += 1.0
    state[lane_state.OPTICAL_DEPTH + lane] += single(job.optics.absorption[item, ground])
    d = sample_cosine_lobe(UP, draw_uniform(words, lane), draw_uniform(words, lane))
    passed = enter_layer(lanes, lane, job, lowest, d)
    if job.features.layered is not None:
        set_layer(lanes, lane, job, lowest)
        start_flight(state, lane)
    state[lane_state.N_REJECTED + lane] = ZERO
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT if passed else lane_state.AT_GROUND
    order = words[lane_state.ORDER + lane]
    words[lane_state.ORDER + lane] = np.uint32(order + np.uint32(1))
    if order >= words[lane_state.MAX_ORDER + lane]:
        state[lane_state.STATUS + lane] = lane_state.ABSORBED
