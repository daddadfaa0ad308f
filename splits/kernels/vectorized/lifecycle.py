"""Launch and exit of rays, and the boundaries of a single layer, between the passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.base.scene import DRY_PORE, WET_PORE, Optics, Scene
from splits.kernels.base.work import FIRST_RAY, MAX_ORDER, STREAM
from splits.kernels.compiler.features import Features
from splits.kernels.compiler.jit import ZERO, inline_only
from splits.kernels.compiler.structure_of_arrays import initialize
from splits.kernels.grains.free_path import compute_boundary_hit
from splits.kernels.grains.state import refractive_index_of
from splits.kernels.math.rng import compute_stream_start
from splits.kernels.math.vectors import Vector, to_single
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.optics.source import sample_source_direction
from splits.kernels.tallies.crossings import copy_into_row
from splits.kernels.tallies.exits import EXIT_LENGTH, record_exit
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.lane_motion import attenuate, load_ray, move_to_boundary
from splits.kernels.vectorized.lane_optics import set_layer_optics
from splits.kernels.vectorized.lane_rng import draw_uniform
from splits.kernels.vectorized.lane_state import N_LANES, STATE_SIZE, STRIDE, Lane


class TraceJob(NamedTuple):
    """Work of a kernel call, with its scene.

    Attributes
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.kernels.vectorized.trace.trace_rays`.
    scene : Scene
    optics : Optics
        With a row for each item.
    features : Features
    """

    seed: int
    work: np.ndarray
    scene: Scene
    optics: Optics
    features: Features


@inline_only
def sample_source(lane, job, ray, item, ray_in_item):
    """Launch a ray of the light source; return whether it enters the sample."""
    source, work = job.scene.source, job.work
    initialize(lane)
    lane.ray, lane.item, lane.max_order = ray, item, work[item, MAX_ORDER]
    key = compute_stream_start(job.seed, work[item, STREAM], work[item, FIRST_RAY] + ray_in_item)
    lane.key_high, lane.key_low = np.uint32(key >> np.uint64(32)), np.uint32(key)
    u = draw_uniform(lane) if source.diffuse_fraction > 0.0 else 1.0
    entered = enter_layer(lane, job, 0, sample_source_direction(source, u))
    set_layer_optics(lane, job)
    return entered


@inline_only
def enter_layer(lane, job, layer, d):
    """Sample the pore of a ray from outside; return whether it is transmitted into the layer."""
    layers, wet, pore_variate = job.scene.layers, False, 0.0
    if job.features.wet is not None:
        pore_variate = draw_uniform(lane)
        wet = pore_variate < layers.wet_fraction[layer]
    lane.pore_wet, lane.pore_variate = wet, pore_variate
    if wet and job.scene.rules.boundary_fresnel:
        dry = layers.first_pore_material[layer]
        near = refractive_index_of(job.optics, (lane.item, dry))
        far = refractive_index_of(job.optics, (lane.item, dry + WET_PORE))
        return refract_at_boundary(lane, d, near, far)
    lane.direction = to_single(d)
    return True


@inline_only
def refract_at_boundary(lane, d, near, far):
    """Refract or reflect a ray at a horizontal interface; return whether it is transmitted."""
    d = Vector(np.float64(d.x), np.float64(d.y), np.float64(d.z))
    sample = sample_interface(d, orient_horizontal_normal(d), near, far, draw_uniform(lane))
    lane.direction = to_single(sample.direction)
    return sample.transmitted


@inline_only
def flush_path_lengths(lane, path_lengths, scene):
    """Add the path lengths of a lane since the last flush to its double-precision sums."""
    types, grain_type = scene.types, lane.grain_type
    path_lengths[DRY_PORE] += lane.dry_path
    path_lengths[WET_PORE] += lane.wet_path
    path_lengths[types.material[grain_type, 0]] += lane.coating_path
    path_lengths[types.material[grain_type, types.n_shells[grain_type] - 1]] += lane.core_path
    lane.dry_path = lane.wet_path = lane.coating_path = lane.core_path = ZERO


@inline_only
def cross_boundary(lane, job):
    """Move a ray to the boundary ahead; return whether it leaves the sample there."""
    ray = load_ray(lane)
    boundary_hit = compute_boundary_hit(ray, lane.layer_geometry)
    move_to_boundary(lane, ray, boundary_hit)
    attenuate(lane, boundary_hit.distance, job.features)
    if not (lane.pore_wet and job.scene.rules.boundary_fresnel):
        return True
    lane.n_rejected, lane.status = ZERO, lane_state.IN_FLIGHT
    near = refractive_index_of(job.optics, (lane.item, WET_PORE))
    far = refractive_index_of(job.optics, (lane.item, DRY_PORE))
    return refract_at_boundary(lane, ray.direction, near, far)


@inline_only
def record_lane_exit(lane, path_lengths, exits):
    """Write the exit of a ray into its row."""
    row, direction = exits[lane.ray], lane.direction
    record_exit(row, direction.z > ZERO, lane.position, direction, lane.weight, lane.order)
    copy_into_row(row, EXIT_LENGTH, path_lengths)


@inline_only
def compact_lanes(state, path_lengths, width, n_active):
    """Compact the active lanes, and return the new width.

    A ray takes its random stream along, so its path does not depend on the lane.
    """
    new_width = -(-n_active // STRIDE) * STRIDE
    free = 0
    for i in range(new_width, width):
        lane = Lane(state, i)
        if lane.status == lane_state.IDLE:
            continue
        while Lane(state, free).status != lane_state.IDLE:
            free += 1
        for row in range(0, STATE_SIZE, N_LANES):
            state[row + free] = state[row + i]
        copy_into_row(path_lengths[free], 0, path_lengths[i])
        lane.status = lane_state.IDLE
    return new_width
