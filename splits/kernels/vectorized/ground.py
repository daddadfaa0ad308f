"""Reflection of rays at the ground below the sample, between the passes."""

from __future__ import annotations

from numpy import float32 as single

from splits.kernels.compiler.jit import ZERO, inline_only
from splits.kernels.grains.scene import NO_GROUND
from splits.kernels.math.vectors import UP, sample_cosine_lobe
from splits.kernels.tallies.crossings import encode_crossing
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.lane_rng import draw_uniform
from splits.kernels.vectorized.layers import append_lane_crossing, set_layer, start_flight
from splits.kernels.vectorized.lifecycle import enter_layer, flush_path_lengths


@inline_only
def reaches_ground(lane, job):
    """Return whether a ray that leaves the sample reaches a reflecting ground."""
    return job.scene.ground_column != NO_GROUND and lane.direction.z < ZERO


@inline_only
def reflect_from_ground(lane, job, path_lengths, crossings):
    """Record the hit of the ground, and reflect the ray of a lane by Lambert's law.

    If the lower boundary of the sample reflects it, the ray is directed to the ground again.  The
    ground counts as one order of scattering.
    """
    ground, bottom_layer = job.scene.ground_column, job.scene.layers.collision_coefficient.size - 1
    flush_path_lengths(lane, path_lengths, job.scene)
    append_lane_crossing(lane, path_lengths, crossings, encode_crossing(bottom_layer + 1, False))
    path_lengths[ground] += 1.0
    lane.optical_depth += single(job.optics.absorption[lane.item, ground])
    direction = sample_cosine_lobe(UP, draw_uniform(lane), draw_uniform(lane))
    entered = enter_layer(lane, job, bottom_layer, direction)
    if job.features.layered is not None:
        set_layer(lane, job, bottom_layer)
        start_flight(lane)
    lane.n_rejected = ZERO
    lane.status = lane_state.IN_FLIGHT if entered else lane_state.AT_GROUND
    if lane.order >= lane.max_order:
        lane.status = lane_state.ABSORBED
    lane.order += 1
