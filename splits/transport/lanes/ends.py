"""Between the passes: launches, boundaries, the optics of a lane, and ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.features import Features
from splits.transport.compiling.jit import ONE, ZERO, part
from splits.transport.grains.flight import FIRST_ROULETTE, to_boundary
from splits.transport.grains.scene import DRY_PORE, WET_PORE, Optics, Scene
from splits.transport.lanes import rows
from splits.transport.lanes.flight import flier_at, travel
from splits.transport.lanes.numbers import double, word
from splits.transport.lanes.rows import Passing, put, vector
from splits.transport.numerics.rng import start_stream
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.faces import Index, facing, meet
from splits.transport.optics.light import launched
from splits.transport.sums.notes import write
from splits.transport.sums.tally import EXIT_LENGTH, record

_LOW32 = np.uint64(0xFFFFFFFF)


class Task(NamedTuple):
    """What a batch is to trace.

    Attributes
    ----------
    seed : int
    work : int64[items, 4]
        See `splits.transport.lanes.batch.batch`.
    scene : Scene
    optics : Optics
        With a row for each item.
    features : Features
    passing : Passing
    """

    seed: int
    work: np.ndarray
    scene: Scene
    optics: Optics
    features: Features
    constants: Passing


class Lanes(NamedTuple):
    """All lanes.

    Attributes
    ----------
    state, words : float32[STATE], uint32[WORDS]
        See `splits.transport.lanes.rows`.
    length : float64[LANES, materials]
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


@part
def draw(words, lane):
    """Return the lane's next random number in double precision."""
    u = double(word(words, lane, 0))
    words[rows.COUNT + lane] = np.uint32(words[rows.COUNT + lane] + np.uint32(1))
    return u


@part
def index_of(optics, item, material):
    """Return the refractive index of a material for an item."""
    return Index(optics.n[item, material], optics.k[item, material])


@part
def launch(lanes, lane, job, ray_in_item):
    """Start a ray of the lane's item; return whether the slab's wet top lets it in."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    light = job.scene.source
    start_stream(lanes.stream, job.seed, job.work[item, 0], job.work[item, 1] + ray_in_item)
    words[rows.KEY_HIGH + lane] = np.uint32(lanes.stream[0] >> np.uint64(32))
    words[rows.KEY_LOW + lane] = np.uint32(lanes.stream[0] & _LOW32)
    words[rows.COUNT + lane] = np.uint32(1)
    words[rows.LEGS + lane] = np.uint32(0)
    words[rows.ORDER + lane] = np.uint32(0)
    words[rows.MOST + lane] = np.uint32(job.work[item, 3])
    d = launched(light, draw(words, lane) if light.diffuse_fraction > 0.0 else 1.0)
    passed = let_in(lanes, lane, job, 0, d)
    for row in range(0, rows.TRAVELLED, rows.LANES):
        state[row + lane] = ZERO
    put(state, rows.LX + lane, Vector(ZERO, ZERO, -ONE))
    state[rows.LAST + lane] = -ONE
    state[rows.LIMIT + lane] = single(FIRST_ROULETTE)
    state[rows.WEIGHT + lane] = ONE
    state[rows.STATUS + lane] = rows.FLYING
    illuminate(state, lane, job.scene, job.optics, item)
    return passed


@part
def let_in(lanes, lane, job, layer, d):
    """Draw the pore of a lane's ray that comes from outside; return whether its face lets it in."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    layers, optics = job.scene.layers, job.optics
    wet, pore = False, 0.0
    if job.features.wet is not None:
        pore = draw(words, lane)
        wet = pore < layers.saturation[layer]
    passed = True
    if wet and job.scene.rules.boundary_fresnel:
        dry = layers.pore[layer]
        near, far = index_of(optics, item, dry), index_of(optics, item, dry + 1)
        passed, d = meet(d, facing(d), near, far, draw(words, lane))
    put(state, rows.DX + lane, Vector(single(d.x), single(d.y), single(d.z)))
    state[rows.WET + lane] = ONE if wet else ZERO
    state[rows.PORE + lane] = single(pore)
    return passed


@part
def illuminate(state, lane, scene, optics, item):
    """Give a lane its layer, and the optics of its light there.

    All grains have the core's of the first type, unless dressed otherwise.
    """
    layers, types = scene.layers, scene.types
    layer = int(state[rows.LAYER + lane])
    state[rows.HIGH + lane], state[rows.LOW + lane] = layers.boundaries[layer], layers.boundaries[layer + 1]
    state[rows.MEAN_LEG + lane] = 1.0 / layers.attenuation[layer]
    state[rows.SATURATION + lane] = layers.saturation[layer]
    state[rows.FIRST_KIND + lane] = layers.first_type[layer]
    kind, pore = layers.first_type[layer], layers.pore[layer]
    core = types.material[kind, types.n_shells[kind] - 1]
    dry, wet = index_of(optics, item, pore), index_of(optics, item, pore + 1)
    ice = index_of(optics, item, core)
    state[rows.N_DRY + lane] = single(dry.n)
    state[rows.K_DRY + lane] = single(dry.k)
    state[rows.A_DRY + lane] = single(optics.absorption[item, pore])
    state[rows.N_WET + lane] = single(wet.n)
    state[rows.K_WET + lane] = single(wet.k)
    state[rows.A_WET + lane] = single(optics.absorption[item, pore + 1])
    state[rows.A_CORE + lane] = single(optics.absorption[item, core])
    m, c, k = seen(dry, ice)
    state[rows.M_IN_DRY + lane], state[rows.C_IN_DRY + lane], state[rows.K_IN_DRY + lane] = m, c, k
    m, c, k = seen(wet, ice)
    state[rows.M_IN_WET + lane], state[rows.C_IN_WET + lane], state[rows.K_IN_WET + lane] = m, c, k
    m, c, k = seen(ice, dry)
    state[rows.M_OUT_DRY + lane], state[rows.C_OUT_DRY + lane] = m, c
    state[rows.K_OUT_DRY + lane] = k
    m, c, k = seen(ice, wet)
    state[rows.M_OUT_WET + lane], state[rows.C_OUT_WET + lane] = m, c
    state[rows.K_OUT_WET + lane] = k


@part
def seen(near, far):
    """Return real part, real part less 1, and imaginary part of an index seen from another."""
    k = 0.0 if near.n == far.n and near.k == far.k else far.k / near.n
    return single(far.n / near.n), single((far.n - near.n) / near.n), single(k)


@part
def put_down(lanes, lane, scene):
    """Add the lane's paths since last time to its lengths."""
    state, length, types = lanes.state, lanes.path_lengths, scene.types
    kind = int(state[rows.KIND + lane])
    length[lane, DRY_PORE] += state[rows.DRY_PATH + lane]
    length[lane, WET_PORE] += state[rows.WET_PATH + lane]
    length[lane, types.material[kind, 0]] += state[rows.COAT_PATH + lane]
    length[lane, types.material[kind, types.n_shells[kind] - 1]] += state[rows.CORE_PATH + lane]
    for row in (rows.DRY_PATH, rows.WET_PATH, rows.COAT_PATH, rows.CORE_PATH):
        state[row + lane] = ZERO


@part
def dress(lanes, lane, job):
    """Give a lane the materials of the grain that it has just met."""
    state, item, types, optics = lanes.state, lanes.item[lane], job.scene.types, job.optics
    kind = int(state[rows.KIND + lane])
    shells = types.n_shells[kind]
    outer, core = types.material[kind, 0], types.material[kind, shells - 1]
    state[rows.SHELLS + lane] = single(shells)
    state[rows.N_OUTER + lane] = single(optics.n[item, outer])
    state[rows.K_OUTER + lane] = single(optics.k[item, outer])
    state[rows.N_CORE + lane] = single(optics.n[item, core])
    state[rows.K_CORE + lane] = single(optics.k[item, core])
    state[rows.A_OUTER + lane] = single(optics.absorption[item, outer])
    state[rows.A_CORE + lane] = single(optics.absorption[item, core])
    major = state[rows.MINOR + lane] / (ONE - state[rows.FLATTENING + lane])
    state[rows.THICKNESS + lane] = single(2.0 * types.coating_thickness[kind, 0]) * major


@part
def at_boundary(lanes, lane, job):
    """Bring a ray to the boundary ahead; return whether it leaves there."""
    state, words, item = lanes.state, lanes.words, lanes.item[lane]
    ray = flier_at(state, lane, None)
    arrival = to_boundary(ray, job.constants.layer_geometry)
    put(state, rows.X + lane, arrival.position)
    put(state, rows.GX + lane, Vector(ZERO, ZERO, ZERO))
    travel(state, lane, arrival.distance, job.features)
    put(state, rows.LX + lane, ray.direction)
    state[rows.LAST + lane] = arrival.distance
    if state[rows.WET + lane] == ZERO:
        return True
    if not job.scene.rules.boundary_fresnel:
        return True
    d = Vector(np.float64(ray.direction.x), np.float64(ray.direction.y), np.float64(ray.direction.z))
    near = index_of(job.optics, item, WET_PORE)
    crossing = meet(d, facing(d), near, index_of(job.optics, item, DRY_PORE), draw(words, lane))
    e = crossing.direction
    put(state, rows.DX + lane, Vector(single(e.x), single(e.y), single(e.z)))
    state[rows.TRIES + lane] = ZERO
    state[rows.STATUS + lane] = rows.FLYING
    return crossing.transmitted


@part
def leave(lanes, lane, exits):
    """Write a ray that left into its row of the exits."""
    state, row = lanes.state, exits[lanes.ray[lane]]
    x, d = vector(state, rows.X + lane), vector(state, rows.DX + lane)
    place = Vector(np.float64(x.x), np.float64(x.y), np.float64(x.z))
    order = np.float64(lanes.words[rows.ORDER + lane])
    record(row, d.z > ZERO, place, d, state[rows.WEIGHT + lane], order)
    write(row, EXIT_LENGTH, lanes.path_lengths[lane])


@part
def close_ranks(lanes, width, n_active):
    """Move the last rays of a batch together, and return how many lanes are then in use.

    A ray carries its random stream along, so its path does not depend on its lane.
    """
    state, words = lanes.state, lanes.words
    smaller = -(-n_active // rows.STRIDE) * rows.STRIDE
    free = 0
    for lane in range(smaller, width):
        if state[rows.STATUS + lane] == rows.IDLE:
            continue
        while state[rows.STATUS + free] != rows.IDLE:
            free += 1
        for row in range(0, rows.STATE, rows.LANES):
            state[row + free] = state[row + lane]
        for row in range(0, rows.WORDS, rows.LANES):
            words[row + free] = words[row + lane]
        write(lanes.path_lengths[free], 0, lanes.path_lengths[lane])
        lanes.ray[free] = lanes.ray[lane]
        lanes.item[free] = lanes.item[lane]
        state[rows.STATUS + lane] = rows.IDLE
    return smaller
