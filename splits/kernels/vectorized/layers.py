"""Layer boundaries, segments through several layers, and the ground, between the passes.

See `splits.kernels.transport.flight` and `splits.kernels.transport.events` for the physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.kernels.arithmetic import sample_cosine_lobe, to_single
from splits.kernels.compiler.jit import ZERO, inline_only
from splits.kernels.compiler.structure_of_arrays import initialize
from splits.kernels.grains.grain_path import pore_material, refractive_index_of
from splits.kernels.grains.spheroid import compute_boundary_hit
from splits.kernels.interface import orient_horizontal_normal, sample_interface
from splits.kernels.rays import sample_source_direction
from splits.kernels.records import EXIT_LENGTH
from splits.kernels.rng import compute_stream_start
from splits.kernels.scene import (
    DRY_PORE,
    FIRST_RAY,
    MAX_ORDER,
    NO_GROUND,
    STREAM,
    UP,
    WET_PORE,
    Features,
    Optics,
    Scene,
    Vector,
)
from splits.kernels.tallies.exits import (
    append_crossing,
    copy_into_row,
    encode_crossing,
    record_exit,
    set_current_ray,
)
from splits.kernels.transport.flight import find_adjacent_layer, find_next_material, is_continuous
from splits.kernels.vectorized import lanes
from splits.kernels.vectorized.lanes import (
    N_LANES,
    STATE_SIZE,
    STRIDE,
    Lane,
    attenuate,
    draw_uniform,
    load_ray,
    move_to_boundary,
    set_layer_optics,
)

# --------------------------------------------------------------------------------------------------
# Launch and exit of rays, and the boundaries of a single layer, between the passes.


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
    lane.n_rejected, lane.status = ZERO, lanes.IN_FLIGHT
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
        if lane.status == lanes.IDLE:
            continue
        while Lane(state, free).status != lanes.IDLE:
            free += 1
        for row in range(0, STATE_SIZE, N_LANES):
            state[row + free] = state[row + i]
        copy_into_row(path_lengths[free], 0, path_lengths[i])
        lane.status = lanes.IDLE
    return new_width


# --------------------------------------------------------------------------------------------------
# Layer boundaries, segments through several layers, and the ground, between the passes.


@inline_only
def lane_is_continuous(lane, job, layer, other):
    """Return whether a ray passes from a layer to another one without an interface."""
    n, k, absorption = job.optics
    optics = Optics(n[lane.item], k[lane.item], absorption[lane.item])
    return is_continuous(job.scene.layers, optics, layer, other, lane.pore_variate)


@inline_only
def set_layer(lane, job, layer):
    """Set the layer of a ray, with the pore that its variate selects."""
    lane.layer = layer
    lane.pore_wet = lane.pore_variate < job.scene.layers.wet_fraction[layer]
    set_layer_optics(lane, job)


@inline_only
def start_flight(lane):
    """Start a flight in the current layer of a ray."""
    lane.flight_layer = lane.draw_layer = lane.layer
    lane.start_distance = lane.skip_distance = ZERO
    lane.on_boundary = False


@inline_only
def append_lane_crossing(lane, path_lengths, crossings, code):
    """Record a crossing of a ray, whose path lengths must have been flushed."""
    set_current_ray(crossings, lane.ray)
    append_crossing(crossings, code, np.float64(lane.weight), path_lengths)


@inline_only
def record_crossing(lane, job, path_lengths, crossings, layer, upward):
    """Record the crossing of a ray into the next layer, if the scene records crossings."""
    if job.scene.record_crossings:
        append_lane_crossing(lane, path_lengths, crossings, encode_crossing(layer, upward))


@inline_only
def attenuate_segment(lane, job, path_lengths, crossings):
    """Attenuate a ray along its last segment through the pores of all layers that it crossed."""
    layers, last_layer = job.scene.layers, np.int64(lane.layer)
    d, remaining = np.float64(lane.previous_direction.z), np.float64(lane.previous_length)
    z, layer, depth = np.float64(lane.position.z) - remaining * d, np.int64(lane.flight_layer), 0.0
    while True:
        length = remaining
        if layer != last_layer:
            boundary = layers.boundaries[layer] if d > 0.0 else layers.boundaries[layer + 1]
            length = min(max((boundary - z) / d, 0.0), remaining)
            z = boundary
        pore = pore_material(layers, layer, lane.pore_variate)
        path_lengths[pore] += length
        depth += length * job.optics.absorption[lane.item, pore]
        if layer == last_layer:
            break
        record_crossing(lane, job, path_lengths, crossings, layer, d > 0.0)
        remaining -= length
        layer += -1 if d > 0.0 else 1
    lane.optical_depth += single(depth)
    lane.segment_attenuated = True
    start_flight(lane)


@inline_only
def restart_flight(lane, job):
    """Restart the sampling of a grain at the start of the segment or at the last skipped grain."""
    set_layer(lane, job, lane.draw_layer)
    lane.start_distance = lane.skip_distance
    lane.status = lanes.IN_FLIGHT


@inline_only
def locate_layer(lane, job, path_lengths, crossings):
    """Set the layer of a ray that left a grain on the other side of a boundary.

    If the pores of the layer there have another index, the ray is moved vertically to that
    boundary.  A ray outside the sample keeps its position: its next flight starts on the boundary.
    """
    position, exit_offset, boundaries = lane.position, lane.exit_offset, job.scene.layers.boundaries
    z, layer = position.z + exit_offset.z, np.int64(lane.layer)
    while z > single(boundaries[layer]) or z < single(boundaries[layer + 1]):
        upward = z > single(boundaries[layer])
        next_layer = layer - 1 if upward else layer + 1
        if not lane_is_continuous(lane, job, layer, next_layer):
            if 0 <= next_layer < boundaries.size - 1:
                boundary = single(boundaries[layer if upward else layer + 1])
                lane.exit_offset = Vector(exit_offset.x, exit_offset.y, boundary - position.z)
            break
        record_crossing(lane, job, path_lengths, crossings, layer, upward)
        layer = next_layer
    set_layer(lane, job, layer)
    start_flight(lane)
    lane.on_boundary, lane.status = True, lanes.IN_FLIGHT


@inline_only
def cross_interface(lane, job, path_lengths, crossings):
    """Move a ray to the boundary ahead; return whether it leaves the sample there.

    If the pores on both sides have the same index, the flight continues without an interface.
    """
    layers, layer, ray = job.scene.layers, lane.layer, load_ray(lane)
    boundary_hit = compute_boundary_hit(ray, lane.layer_geometry)
    next_layer = find_adjacent_layer(layer, ray.direction)
    inside = 0 <= next_layer < layers.collision_coefficient.size
    lane.status = lanes.IN_FLIGHT
    if lane_is_continuous(lane, job, layer, next_layer):
        set_layer(lane, job, next_layer)
        lane.start_distance = max(boundary_hit.distance, lane.start_distance)
        return False
    move_to_boundary(lane, ray, boundary_hit)
    attenuate_segment(lane, job, path_lengths, crossings)
    pore = pore_material(layers, layer, lane.pore_variate)
    behind = find_next_material(layers, layer, next_layer, lane.pore_variate)
    near = refractive_index_of(job.optics, (lane.item, pore))
    far = refractive_index_of(job.optics, (lane.item, behind))
    transmitted = True
    if job.scene.rules.boundary_fresnel and (near.n != far.n or near.k != far.k):
        transmitted = refract_at_boundary(lane, ray.direction, near, far)
    lane.n_rejected = ZERO
    if transmitted and inside:
        record_crossing(lane, job, path_lengths, crossings, layer, next_layer < layer)
        set_layer(lane, job, next_layer)
        start_flight(lane)
    return transmitted and not inside


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
    append_lane_crossing(lane, path_lengths, crossings, encode_crossing(bottom_layer, False))
    path_lengths[ground] += 1.0
    lane.optical_depth += single(job.optics.absorption[lane.item, ground])
    direction = sample_cosine_lobe(UP, draw_uniform(lane), draw_uniform(lane))
    entered = enter_layer(lane, job, bottom_layer, direction)
    if job.features.layered is not None:
        set_layer(lane, job, bottom_layer)
        start_flight(lane)
    lane.n_rejected = ZERO
    lane.status = lanes.IN_FLIGHT if entered else lanes.AT_GROUND
    if lane.order >= lane.max_order:
        lane.status = lanes.LANE_ABSORBED
    lane.order += 1
