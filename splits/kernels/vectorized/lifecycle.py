"""Launch and exit of rays, boundaries, and optical constants of lanes, between the passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.features import Features
from splits.kernels.compiler.jit import ONE, ZERO, inline_only
from splits.kernels.grains.free_path import FIRST_ROULETTE_DEPTH, compute_boundary_hit
from splits.kernels.grains.scene import DRY_PORE, WET_PORE, Optics, Scene
from splits.kernels.math.rng import start_stream
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.optics.source import sample_source_direction
from splits.kernels.tallies.crossings import copy_into_row
from splits.kernels.tallies.exits import EXIT_LENGTH, record_exit
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.lane_motion import attenuate, load_ray
from splits.kernels.vectorized.lane_optics import refractive_index_of, set_layer_optics
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_uniform_52
from splits.kernels.vectorized.lane_state import PassConstants, load_vector, store_vector

_LOW_32_BITS = np.uint64(0xFFFFFFFF)


class BatchJob(NamedTuple):
    """Work of a batch, with its scene.

    Attributes
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.kernels.vectorized.batch.trace_batch`.
    scene : Scene
    optics : Optics
        With a row for each item.
    features : Features
    constants : PassConstants
    """

    seed: int
    work: np.ndarray
    scene: Scene
    optics: Optics
    features: Features
    constants: PassConstants


class LaneState(NamedTuple):
    """State of all lanes.

    Attributes
    ----------
    state, words : float32[STATE_SIZE], uint32[WORDS_SIZE]
        See `splits.kernels.vectorized.lane_state`.
    path_lengths : float64[N_LANES, materials]
        Path lengths up to the last flush (m).
    ray, item : int64[N_LANES]
        Row of the exits and work item of the rays in the lanes.
    stream : uint64[1]
        Buffer for the start of a random stream.
    """

    state: np.ndarray
    words: np.ndarray
    path_lengths: np.ndarray
    ray: np.ndarray
    item: np.ndarray
    stream: np.ndarray


@inline_only
def draw_uniform(words, lane):
    """Draw the next random number of a lane in double precision."""
    u = to_uniform_52(compute_random_bits(words, lane, 0))
    words[lane_state.N_DRAWN + lane] = np.uint32(words[lane_state.N_DRAWN + lane] + np.uint32(1))
    return u


@inline_only
def sample_source(lanes, lane, job, ray_in_item):
    """Sample a ray of the light source; return whether it enters the sample."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    source = job.scene.source
    start_stream(lanes.stream, job.seed, job.work[item, 0], job.work[item, 1] + ray_in_item)
    words[lane_state.KEY_HIGH + lane] = np.uint32(lanes.stream[0] >> np.uint64(32))
    words[lane_state.KEY_LOW + lane] = np.uint32(lanes.stream[0] & _LOW_32_BITS)
    words[lane_state.N_DRAWN + lane] = np.uint32(1)
    words[lane_state.N_SEGMENTS + lane] = np.uint32(0)
    words[lane_state.ORDER + lane] = np.uint32(0)
    words[lane_state.MAX_ORDER + lane] = np.uint32(job.work[item, 3])
    direction = sample_source_direction(
        source, draw_uniform(words, lane) if source.diffuse_fraction > 0.0 else 1.0
    )
    entered = enter_layer(lanes, lane, job, 0, direction)
    for row in range(0, lane_state.ZEROED_SIZE, lane_state.N_LANES):
        state[row + lane] = ZERO
    store_vector(state, lane_state.PREV_DIR_X + lane, Vector(ZERO, ZERO, -ONE))
    state[lane_state.PREV_LENGTH + lane] = -ONE
    state[lane_state.NEXT_ROULETTE + lane] = single(FIRST_ROULETTE_DEPTH)
    state[lane_state.WEIGHT + lane] = ONE
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    set_layer_optics(state, lane, job.scene, job.optics, item)
    return entered


@inline_only
def enter_layer(lanes, lane, job, layer, d):
    """Sample the pore of a ray from outside; return whether it is transmitted into the layer."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    wet, pore_variate = False, 0.0
    if job.features.wet is not None:
        pore_variate = draw_uniform(words, lane)
        wet = pore_variate < layers.wet_fraction[layer]
    transmitted = True
    if wet and job.scene.rules.boundary_fresnel:
        dry = layers.first_pore_material[layer]
        near, far = (
            refractive_index_of(optics, item, dry),
            refractive_index_of(optics, item, dry + 1),
        )
        transmitted, d = sample_interface(
            d, orient_horizontal_normal(d), near, far, draw_uniform(words, lane)
        )
    store_vector(state, lane_state.DIR_X + lane, Vector(single(d.x), single(d.y), single(d.z)))
    state[lane_state.PORE_WET + lane] = ONE if wet else ZERO
    state[lane_state.PORE_VARIATE + lane] = single(pore_variate)
    return transmitted


@inline_only
def flush_path_lengths(lanes, lane, scene):
    """Add the path lengths of a lane since the last flush to its double-precision sums."""
    state, path_lengths, types = lanes.state, lanes.path_lengths, scene.types
    grain_type = int(state[lane_state.TYPE + lane])
    path_lengths[lane, DRY_PORE] += state[lane_state.DRY_PATH + lane]
    path_lengths[lane, WET_PORE] += state[lane_state.WET_PATH + lane]
    path_lengths[lane, types.material[grain_type, 0]] += state[lane_state.COATING_PATH + lane]
    path_lengths[lane, types.material[grain_type, types.n_shells[grain_type] - 1]] += state[
        lane_state.CORE_PATH + lane
    ]
    for row in (
        lane_state.DRY_PATH,
        lane_state.WET_PATH,
        lane_state.COATING_PATH,
        lane_state.CORE_PATH,
    ):
        state[row + lane] = ZERO


@inline_only
def cross_boundary(lanes, lane, job):
    """Move a ray to the boundary ahead; return whether it leaves the sample there."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ray = load_ray(state, lane, None)
    boundary_hit = compute_boundary_hit(ray, job.constants.layer_geometry)
    store_vector(state, lane_state.X + lane, boundary_hit.position)
    store_vector(state, lane_state.EXIT_OFFSET_X + lane, Vector(ZERO, ZERO, ZERO))
    attenuate(state, lane, boundary_hit.distance, job.features)
    store_vector(state, lane_state.PREV_DIR_X + lane, ray.direction)
    state[lane_state.PREV_LENGTH + lane] = boundary_hit.distance
    if state[lane_state.PORE_WET + lane] == ZERO:
        return True
    if not job.scene.rules.boundary_fresnel:
        return True
    d = Vector(
        np.float64(ray.direction.x),
        np.float64(ray.direction.y),
        np.float64(ray.direction.z),
    )
    near = refractive_index_of(job.optics, item, WET_PORE)
    sample = sample_interface(
        d,
        orient_horizontal_normal(d),
        near,
        refractive_index_of(job.optics, item, DRY_PORE),
        draw_uniform(words, lane),
    )
    e = sample.direction
    store_vector(state, lane_state.DIR_X + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[lane_state.N_REJECTED + lane] = ZERO
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    return sample.transmitted


@inline_only
def record_lane_exit(lanes, lane, exits):
    """Write the exit of a ray into its row."""
    state, row = lanes.state, exits[lanes.ray[lane]]
    position, direction = (
        load_vector(state, lane_state.X + lane),
        load_vector(state, lane_state.DIR_X + lane),
    )
    position64 = Vector(np.float64(position.x), np.float64(position.y), np.float64(position.z))
    order = np.float64(lanes.words[lane_state.ORDER + lane])
    record_exit(
        row, direction.z > ZERO, position64, direction, state[lane_state.WEIGHT + lane], order
    )
    copy_into_row(row, EXIT_LENGTH, lanes.path_lengths[lane])


@inline_only
def compact_lanes(lanes, width, n_active):
    """Compact the active lanes, and return the new width.

    A ray takes its random stream along, so its path does not depend on the lane.
    """
    state, words = lanes.state, lanes.words
    new_width = -(-n_active // lane_state.STRIDE) * lane_state.STRIDE
    free = 0
    for lane in range(new_width, width):
        if state[lane_state.STATUS + lane] == lane_state.IDLE:
            continue
        while state[lane_state.STATUS + free] != lane_state.IDLE:
            free += 1
        for row in range(0, lane_state.STATE_SIZE, lane_state.N_LANES):
            state[row + free] = state[row + lane]
        for row in range(0, lane_state.WORDS_SIZE, lane_state.N_LANES):
            words[row + free] = words[row + lane]
        copy_into_row(lanes.path_lengths[free], 0, lanes.path_lengths[lane])
        lanes.ray[free] = lanes.ray[lane]
        lanes.item[free] = lanes.item[lane]
        state[lane_state.STATUS + lane] = lane_state.IDLE
    return new_width
