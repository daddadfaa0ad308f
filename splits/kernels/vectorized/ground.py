"""Reflection of rays at the ground below the sample, between the passes."""

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
    """Return whether a ray that leaves the sample reaches a reflecting ground."""
    return job.scene.ground_column != NO_GROUND and lanes.state[lane_state.DIR_Z + lane] < ZERO


@inline_only
def reflect_from_ground(lanes, lane, job, crossings):
    """Record the hit of the ground, and reflect the ray of a lane by Lambert's law.

    If the lower boundary of the sample reflects it, the ray is directed to the ground again.  The
    ground counts as one order of scattering.
    """
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ground, bottom_layer = job.scene.ground_column, job.scene.layers.collision_coefficient.size - 1
    flush_path_lengths(lanes, lane, job.scene)
    append_lane_crossing(lanes, lane, crossings, encode_crossing(bottom_layer + 1, False))
    lanes.path_lengths[lane, ground] += 1.0
    state[lane_state.OPTICAL_DEPTH + lane] += single(job.optics.absorption[item, ground])
    direction = sample_cosine_lobe(UP, draw_uniform(words, lane), draw_uniform(words, lane))
    entered = enter_layer(lanes, lane, job, bottom_layer, direction)
    if job.features.layered is not None:
        set_layer(lanes, lane, job, bottom_layer)
        start_flight(state, lane)
    state[lane_state.N_REJECTED + lane] = ZERO
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT if entered else lane_state.AT_GROUND
    order = words[lane_state.ORDER + lane]
    words[lane_state.ORDER + lane] = np.uint32(order + np.uint32(1))
    if order >= words[lane_state.MAX_ORDER + lane]:
        state[lane_state.STATUS + lane] = lane_state.ABSORBED
