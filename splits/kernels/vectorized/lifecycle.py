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
from splits.kernels.optics.interface import (
    ComplexIndex,
    orient_horizontal_normal,
    sample_interface,
)
from splits.kernels.optics.source import sample_source_direction
from splits.kernels.tallies.crossings import copy_into_row
from splits.kernels.tallies.exits import EXIT_LENGTH, record_exit
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.flight import attenuate, load_ray
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
def refractive_index_of(optics, item, material):
    """Return the complex refractive index of a material for a work item."""
    return ComplexIndex(optics.n[item, material], optics.k[item, material])


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
        wet = pore_variate < layers.saturation[layer]
    transmitted = True
    if wet and job.scene.rules.boundary_fresnel:
        dry = layers.pore[layer]
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
def set_layer_optics(state, lane, scene, optics, item):
    """Set the optical constants of a lane in its layer.

    The core is that of the first grain type; in mixed scenes `set_grain_optics` replaces it.
    """
    layers, types = scene.layers, scene.types
    layer = int(state[lane_state.LAYER + lane])
    state[lane_state.LAYER_TOP + lane], state[lane_state.LAYER_BOTTOM + lane] = (
        layers.boundaries[layer],
        layers.boundaries[layer + 1],
    )
    state[lane_state.MEAN_FREE_PATH + lane] = 1.0 / layers.attenuation[layer]
    state[lane_state.SATURATION + lane] = layers.saturation[layer]
    state[lane_state.FIRST_TYPE + lane] = layers.first_type[layer]
    grain_type, pore = layers.first_type[layer], layers.pore[layer]
    core = types.material[grain_type, types.n_shells[grain_type] - 1]
    dry, wet = refractive_index_of(optics, item, pore), refractive_index_of(optics, item, pore + 1)
    core_index = refractive_index_of(optics, item, core)
    state[lane_state.INDEX_DRY + lane] = single(dry.n)
    state[lane_state.EXTINCTION_DRY + lane] = single(dry.k)
    state[lane_state.ABSORPTION_DRY + lane] = single(optics.absorption[item, pore])
    state[lane_state.INDEX_WET + lane] = single(wet.n)
    state[lane_state.EXTINCTION_WET + lane] = single(wet.k)
    state[lane_state.ABSORPTION_WET + lane] = single(optics.absorption[item, pore + 1])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    m, m1, k = compute_relative_index(dry, core_index)
    (
        state[lane_state.M_IN_DRY + lane],
        state[lane_state.M1_IN_DRY + lane],
        state[lane_state.K_IN_DRY + lane],
    ) = m, m1, k
    m, m1, k = compute_relative_index(wet, core_index)
    (
        state[lane_state.M_IN_WET + lane],
        state[lane_state.M1_IN_WET + lane],
        state[lane_state.K_IN_WET + lane],
    ) = m, m1, k
    m, m1, k = compute_relative_index(core_index, dry)
    state[lane_state.M_OUT_DRY + lane], state[lane_state.M1_OUT_DRY + lane] = m, m1
    state[lane_state.K_OUT_DRY + lane] = k
    m, m1, k = compute_relative_index(core_index, wet)
    state[lane_state.M_OUT_WET + lane], state[lane_state.M1_OUT_WET + lane] = m, m1
    state[lane_state.K_OUT_WET + lane] = k


@inline_only
def compute_relative_index(near, far):
    """Return m, m − 1 and k of the relative index of two media."""
    k = 0.0 if near.n == far.n and near.k == far.k else far.k / near.n
    return single(far.n / near.n), single((far.n - near.n) / near.n), single(k)


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
def set_grain_optics(lanes, lane, job):
    """Set the optical constants of a lane to those of the grain that was hit."""
    state, item, types, optics = lanes.state, lanes.item[lane], job.scene.types, job.optics
    grain_type = int(state[lane_state.TYPE + lane])
    n_shells = types.n_shells[grain_type]
    outer, core = types.material[grain_type, 0], types.material[grain_type, n_shells - 1]
    state[lane_state.N_SHELLS + lane] = single(n_shells)
    state[lane_state.INDEX_OUTER + lane] = single(optics.n[item, outer])
    state[lane_state.EXTINCTION_OUTER + lane] = single(optics.k[item, outer])
    state[lane_state.INDEX_CORE + lane] = single(optics.n[item, core])
    state[lane_state.EXTINCTION_CORE + lane] = single(optics.k[item, core])
    state[lane_state.ABSORPTION_OUTER + lane] = single(optics.absorption[item, outer])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    semi_major = state[lane_state.SEMI_MINOR + lane] / (ONE - state[lane_state.FLATTENING + lane])
    state[lane_state.COATING_THICKNESS + lane] = (
        single(2.0 * types.coating_thickness[grain_type, 0]) * semi_major
    )


@inline_only
def cross_boundary(lanes, lane, job):
    """Move a ray to the boundary ahead; return whether it leaves the sample there."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    geometry = load_ray(state, lane, None)
    boundary_hit = compute_boundary_hit(geometry, job.constants.layer_geometry)
    store_vector(state, lane_state.X + lane, boundary_hit.position)
    store_vector(state, lane_state.EXIT_OFFSET_X + lane, Vector(ZERO, ZERO, ZERO))
    attenuate(state, lane, boundary_hit.distance, job.features)
    store_vector(state, lane_state.PREV_DIR_X + lane, geometry.direction)
    state[lane_state.PREV_LENGTH + lane] = boundary_hit.distance
    if state[lane_state.PORE_WET + lane] == ZERO:
        return True
    if not job.scene.rules.boundary_fresnel:
        return True
    d = Vector(
        np.float64(geometry.direction.x),
        np.float64(geometry.direction.y),
        np.float64(geometry.direction.z),
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
