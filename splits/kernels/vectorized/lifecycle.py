"""Between the passes: launches, boundaries, the optics of a lane, and ends."""

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
    """What a batch is to trace.

    Attributes
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.kernels.vectorized.batch.trace_batch`.
    scene : LayerScene
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
    """All lanes.

    Attributes
    ----------
    state, words : float32[STATE], uint32[WORDS]
        See `splits.kernels.vectorized.lane_state`.
    path_lengths : float64[LANES, materials]
        Path lengths (m) put down so far.
    ray, item : int64[LANES]
        Row of the exits and item of the rays in the lanes.
    stream : uint64[1]
        Room for the start of a random stream.
    """

    state: np.ndarray
    words: np.ndarray
    path_lengths: np.ndarray
    ray: np.ndarray
    item: np.ndarray
    stream: np.ndarray


@inline_only
def draw_uniform(words, lane):
    """Return the lane's next random number in double precision."""
    u = to_uniform_52(compute_random_bits(words, lane, 0))
    words[lane_state.N_DRAWN + lane] = np.uint32(words[lane_state.N_DRAWN + lane] + np.uint32(1))
    return u


@inline_only
def refractive_index_of(optics, item, material):
    """Return the refractive index of a material for an item."""
    return ComplexIndex(optics.n[item, material], optics.k[item, material])


@inline_only
def sample_source(lanes, lane, job, ray_in_item):
    """Start a ray of the lane's item; return whether the slab's wet top lets it in."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    light = job.scene.source
    start_stream(lanes.stream, job.seed, job.work[item, 0], job.work[item, 1] + ray_in_item)
    words[lane_state.KEY_HIGH + lane] = np.uint32(lanes.stream[0] >> np.uint64(32))
    words[lane_state.KEY_LOW + lane] = np.uint32(lanes.stream[0] & _LOW_32_BITS)
    words[lane_state.N_DRAWN + lane] = np.uint32(1)
    words[lane_state.N_SEGMENTS + lane] = np.uint32(0)
    words[lane_state.ORDER + lane] = np.uint32(0)
    words[lane_state.MAX_ORDER + lane] = np.uint32(job.work[item, 3])
    d = sample_source_direction(
        light, draw_uniform(words, lane) if light.diffuse_fraction > 0.0 else 1.0
    )
    passed = enter_layer(lanes, lane, job, 0, d)
    for row in range(0, lane_state.ZEROED_SIZE, lane_state.N_LANES):
        state[row + lane] = ZERO
    store_vector(state, lane_state.PREV_DIR_X + lane, Vector(ZERO, ZERO, -ONE))
    state[lane_state.PREV_LENGTH + lane] = -ONE
    state[lane_state.NEXT_ROULETTE + lane] = single(FIRST_ROULETTE_DEPTH)
    state[lane_state.WEIGHT + lane] = ONE
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    set_layer_optics(state, lane, job.scene, job.optics, item)
    return passed


@inline_only
def enter_layer(lanes, lane, job, layer, d):
    """Draw the pore of a lane's ray that comes from outside; return whether its face lets it in."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    wet, pore = False, 0.0
    if job.features.wet is not None:
        pore = draw_uniform(words, lane)
        wet = pore < layers.saturation[layer]
    passed = True
    if wet and job.scene.rules.boundary_fresnel:
        dry = layers.pore[layer]
        near, far = (
            refractive_index_of(optics, item, dry),
            refractive_index_of(optics, item, dry + 1),
        )
        passed, d = sample_interface(
            d, orient_horizontal_normal(d), near, far, draw_uniform(words, lane)
        )
    store_vector(state, lane_state.DIR_X + lane, Vector(single(d.x), single(d.y), single(d.z)))
    state[lane_state.PORE_WET + lane] = ONE if wet else ZERO
    state[lane_state.PORE_VARIATE + lane] = single(pore)
    return passed


@inline_only
def set_layer_optics(state, lane, scene, optics, item):
    """Give a lane its layer, and the optics of its light there.

    All grains have the core's of the first type, unless dressed otherwise.
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
    kind, pore = layers.first_type[layer], layers.pore[layer]
    core = types.material[kind, types.n_shells[kind] - 1]
    dry, wet = refractive_index_of(optics, item, pore), refractive_index_of(optics, item, pore + 1)
    ice = refractive_index_of(optics, item, core)
    state[lane_state.INDEX_DRY + lane] = single(dry.n)
    state[lane_state.EXTINCTION_DRY + lane] = single(dry.k)
    state[lane_state.ABSORPTION_DRY + lane] = single(optics.absorption[item, pore])
    state[lane_state.INDEX_WET + lane] = single(wet.n)
    state[lane_state.EXTINCTION_WET + lane] = single(wet.k)
    state[lane_state.ABSORPTION_WET + lane] = single(optics.absorption[item, pore + 1])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    m, c, k = compute_relative_index(dry, ice)
    (
        state[lane_state.M_IN_DRY + lane],
        state[lane_state.M1_IN_DRY + lane],
        state[lane_state.K_IN_DRY + lane],
    ) = m, c, k
    m, c, k = compute_relative_index(wet, ice)
    (
        state[lane_state.M_IN_WET + lane],
        state[lane_state.M1_IN_WET + lane],
        state[lane_state.K_IN_WET + lane],
    ) = m, c, k
    m, c, k = compute_relative_index(ice, dry)
    state[lane_state.M_OUT_DRY + lane], state[lane_state.M1_OUT_DRY + lane] = m, c
    state[lane_state.K_OUT_DRY + lane] = k
    m, c, k = compute_relative_index(ice, wet)
    state[lane_state.M_OUT_WET + lane], state[lane_state.M1_OUT_WET + lane] = m, c
    state[lane_state.K_OUT_WET + lane] = k


@inline_only
def compute_relative_index(near, far):
    """Return real part, real part less 1, and imaginary part of an index seen from another."""
    k = 0.0 if near.n == far.n and near.k == far.k else far.k / near.n
    return single(far.n / near.n), single((far.n - near.n) / near.n), single(k)


@inline_only
def flush_path_lengths(lanes, lane, scene):
    """Add the lane's paths since last time to its lengths."""
    state, length, types = lanes.state, lanes.path_lengths, scene.types
    kind = int(state[lane_state.TYPE + lane])
    length[lane, DRY_PORE] += state[lane_state.DRY_PATH + lane]
    length[lane, WET_PORE] += state[lane_state.WET_PATH + lane]
    length[lane, types.material[kind, 0]] += state[lane_state.COATING_PATH + lane]
    length[lane, types.material[kind, types.n_shells[kind] - 1]] += state[
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
    """Give a lane the materials of the grain that it has just met."""
    state, item, types, optics = lanes.state, lanes.item[lane], job.scene.types, job.optics
    kind = int(state[lane_state.TYPE + lane])
    shells = types.n_shells[kind]
    outer, core = types.material[kind, 0], types.material[kind, shells - 1]
    state[lane_state.N_SHELLS + lane] = single(shells)
    state[lane_state.INDEX_OUTER + lane] = single(optics.n[item, outer])
    state[lane_state.EXTINCTION_OUTER + lane] = single(optics.k[item, outer])
    state[lane_state.INDEX_CORE + lane] = single(optics.n[item, core])
    state[lane_state.EXTINCTION_CORE + lane] = single(optics.k[item, core])
    state[lane_state.ABSORPTION_OUTER + lane] = single(optics.absorption[item, outer])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    major = state[lane_state.SEMI_MINOR + lane] / (ONE - state[lane_state.FLATTENING + lane])
    state[lane_state.COATING_THICKNESS + lane] = (
        single(2.0 * types.coating_thickness[kind, 0]) * major
    )


@inline_only
def cross_boundary(lanes, lane, job):
    """Bring a ray to the boundary ahead; return whether it leaves there."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ray = load_ray(state, lane, None)
    arrival = compute_boundary_hit(ray, job.constants.layer_geometry)
    store_vector(state, lane_state.X + lane, arrival.position)
    store_vector(state, lane_state.EXIT_OFFSET_X + lane, Vector(ZERO, ZERO, ZERO))
    attenuate(state, lane, arrival.distance, job.features)
    store_vector(state, lane_state.PREV_DIR_X + lane, ray.direction)
    state[lane_state.PREV_LENGTH + lane] = arrival.distance
    if state[lane_state.PORE_WET + lane] == ZERO:
        return True
    if not job.scene.rules.boundary_fresnel:
        return True
    d = Vector(
        np.float64(ray.direction.x), np.float64(ray.direction.y), np.float64(ray.direction.z)
    )
    near = refractive_index_of(job.optics, item, WET_PORE)
    crossing = sample_interface(
        d,
        orient_horizontal_normal(d),
        near,
        refractive_index_of(job.optics, item, DRY_PORE),
        draw_uniform(words, lane),
    )
    e = crossing.direction
    store_vector(state, lane_state.DIR_X + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[lane_state.N_REJECTED + lane] = ZERO
    state[lane_state.STATUS + lane] = lane_state.IN_FLIGHT
    return crossing.transmitted


@inline_only
def record_lane_exit(lanes, lane, exits):
    """Write a ray that left into its row of the exits."""
    state, row = lanes.state, exits[lanes.ray[lane]]
    x, d = load_vector(state, lane_state.X + lane), load_vector(state, lane_state.DIR_X + lane)
    place = Vector(np.float64(x.x), np.float64(x.y), np.float64(x.z))
    order = np.float64(lanes.words[lane_state.ORDER + lane])
    record_exit(row, d.z > ZERO, place, d, state[lane_state.WEIGHT + lane], order)
    copy_into_row(row, EXIT_LENGTH, lanes.path_lengths[lane])


@inline_only
def compact_lanes(lanes, width, n_active):
    """Move the last rays of a batch together, and return how many lanes are then in use.

    A ray carries its random stream along, so its path does not depend on its lane.
    """
    state, words = lanes.state, lanes.words
    smaller = -(-n_active // lane_state.STRIDE) * lane_state.STRIDE
    free = 0
    for lane in range(smaller, width):
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
    return smaller
