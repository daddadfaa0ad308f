"""A batch of rays on lanes: launches, boundaries and ends between the passes.

Counterpart of `splits.transport.granular.batch`: the same arguments, the same exits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import float32 as single

from splits.transport.absorption import FIRST_ROULETTE
from splits.transport.fresnel import interface, refracted
from splits.transport.jit import ONE, ZERO, entry, kernel
from splits.transport.lanes.flight import draw_types, flight
from splits.transport.lanes.numbers import double, word
from splits.transport.lanes.rows import (
    A_CORE,
    A_OUTER,
    AT_BOUNDARY,
    COAT_PATH,
    CORE_PATH,
    COUNT,
    DEPTH,
    DX,
    DY,
    DZ,
    FLATTENING,
    FLYING,
    GX,
    GY,
    GZ,
    IDLE,
    K_CORE,
    K_OUTER,
    KEEP,
    KEY_HIGH,
    KEY_LOW,
    KIND,
    LANES,
    LAST,
    LAYER,
    LAYERS,
    LIMIT,
    LOST,
    LX,
    LY,
    LZ,
    MINOR,
    N_CORE,
    N_OUTER,
    PORE_PATH,
    STATE,
    STATUS,
    STRIDE,
    THICKNESS,
    TRIAL,
    TRIES,
    WEIGHT,
    WET,
    WORDS,
    Scene,
    Step,
    X,
    Y,
    Z,
)  # fmt: skip
from splits.transport.lanes.surface import surface
from splits.transport.rng import start_stream
from splits.transport.scene import DRY_PORE, WET_PORE
from splits.transport.tally import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
)

_LOW32 = np.uint64(0xFFFFFFFF)


@kernel
def draw(words, lane):
    """Return the lane's next random number in double precision."""
    u = double(word(words, lane, 0))
    words[COUNT + lane] = np.uint32(words[COUNT + lane] + np.uint32(1))
    return u


@kernel
def boundary(words, lane, dx, dy, dz, n1, n2, k2):
    """Return what `granular.cross_boundary` does, from the lane's stream."""
    up = math.copysign(1.0, -dz)
    cos_i = max(abs(dz), 1e-12)
    reflectance, ratio, cos_t = interface(n1, n2, k2, cos_i)
    if draw(words, lane) < reflectance:
        return False, dx, dy, -dz
    dx, dy, dz = refracted(dx, dy, dz, 0.0, 0.0, up, cos_i, ratio, cos_t)
    return True, dx, dy, dz


@kernel
def step(optics, near, far):
    """Return the `Step` from one material into another; none between equal ones."""
    n1, k1, n2, k2 = optics.n[near], optics.k[near], optics.n[far], optics.k[far]
    k = 0.0 if n1 == n2 and k1 == k2 else k2 / n1
    return Step(single(n2 / n1), single((n2 - n1) / n1), single(k))


@kernel
def launch(state, words, lane, seed, ensemble, ray, slab, rules, optics, stream):
    """Start a ray in a lane; return False if the slab's wet top sends it back at once."""
    start_stream(stream, seed, ensemble, ray)
    words[KEY_HIGH + lane] = np.uint32(stream[0] >> np.uint64(32))
    words[KEY_LOW + lane] = np.uint32(stream[0] & _LOW32)
    words[COUNT + lane] = np.uint32(1)
    mu = math.sqrt(draw(words, lane)) if slab.diffuse else slab.cos_incidence
    dx, dy, dz = math.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, -mu
    wet = slab.saturation > 0.0 and draw(words, lane) < slab.saturation
    passed = True
    if wet and rules.boundary_fresnel:
        passed, dx, dy, dz = boundary(
            words, lane, dx, dy, dz, optics.n[DRY_PORE], optics.n[WET_PORE], optics.k[WET_PORE]
        )
    for row in (X, Y, Z, GX, GY, GZ, LX, LY, PORE_PATH, COAT_PATH, CORE_PATH, DEPTH, TRIES, KEEP):
        state[row + lane] = ZERO
    state[LZ + lane] = -ONE
    state[LAST + lane] = -ONE
    state[DX + lane] = single(dx)
    state[DY + lane] = single(dy)
    state[DZ + lane] = single(dz)
    state[WET + lane] = ONE if wet else ZERO
    state[LIMIT + lane] = single(FIRST_ROULETTE)
    state[WEIGHT + lane] = ONE
    state[STATUS + lane] = FLYING
    return passed


@kernel
def put_down(state, lane, grains, length):
    """Add the lane's paths since last time to `length` (float64[lanes, materials])."""
    kind = int(state[KIND + lane])
    layers = grains.layers[kind]
    length[lane, WET_PORE] += state[PORE_PATH + lane]
    length[lane, grains.material[kind, 0]] += state[COAT_PATH + lane]
    length[lane, grains.material[kind, layers - 1]] += state[CORE_PATH + lane]
    state[PORE_PATH + lane] = ZERO
    state[COAT_PATH + lane] = ZERO
    state[CORE_PATH + lane] = ZERO


@kernel
def dress(state, lane, grains, optics):
    """Give a lane the materials of the grain that it has just met."""
    kind = int(state[KIND + lane])
    layers = grains.layers[kind]
    outer = grains.material[kind, 0]
    core = grains.material[kind, layers - 1]
    state[LAYERS + lane] = single(layers)
    state[N_OUTER + lane] = single(optics.n[outer])
    state[K_OUTER + lane] = single(optics.k[outer])
    state[N_CORE + lane] = single(optics.n[core])
    state[K_CORE + lane] = single(optics.k[core])
    state[A_OUTER + lane] = single(optics.absorption[outer])
    state[A_CORE + lane] = single(optics.absorption[core])
    major = state[MINOR + lane] / (ONE - state[FLATTENING + lane])
    state[THICKNESS + lane] = single(2.0 * grains.thickness[kind, 0]) * major


@kernel
def at_boundary(state, words, lane, slab, rules, optics):
    """Bring a ray to the boundary ahead; return whether it leaves there."""
    for row, way in ((X, GX), (Y, GY), (Z, GZ)):
        state[row + lane] += state[way + lane]
        state[way + lane] = ZERO
    dx, dy, dz = state[DX + lane], state[DY + lane], state[DZ + lane]
    goal = ZERO if dz > ZERO else -single(slab.depth)
    # A grain kept across a boundary may have ended outside: the ray stands on the boundary.
    height = min(max(state[Z + lane], -single(slab.depth)), ZERO)
    leg = (goal - height) / dz
    state[X + lane] += leg * dx
    state[Y + lane] += leg * dy
    state[Z + lane] = goal
    if state[WET + lane] == ZERO:
        return True
    state[PORE_PATH + lane] += leg
    state[DEPTH + lane] += leg * single(optics.absorption[WET_PORE])
    if not rules.boundary_fresnel:
        return True
    passed, ex, ey, ez = boundary(
        words, lane, float(dx), float(dy), float(dz), optics.n[WET_PORE], optics.n[DRY_PORE], 0.0
    )
    state[LX + lane], state[LY + lane], state[LZ + lane] = dx, dy, dz
    state[LAST + lane] = leg
    state[DX + lane], state[DY + lane], state[DZ + lane] = single(ex), single(ey), single(ez)
    state[TRIES + lane] = ZERO
    state[STATUS + lane] = FLYING
    return passed


@kernel
def record(row, state, lane, length, features):
    """Write a ray that left into a row of the exits."""
    row[EXIT_SIDE] = 0.0 if state[DZ + lane] > ZERO else 1.0
    row[EXIT_WEIGHT] = state[WEIGHT + lane]
    row[EXIT_DIRECTION] = state[DX + lane]
    row[EXIT_DIRECTION + 1] = state[DY + lane]
    row[EXIT_DIRECTION + 2] = state[DZ + lane]
    if features.positions is not None:
        row[EXIT_POSITION] = state[X + lane]
        row[EXIT_POSITION + 1] = state[Y + lane]
    row[EXIT_LENGTH : EXIT_LENGTH + length.shape[1]] = length[lane]


@kernel
def close_ranks(state, words, length, ray, width, busy):
    """Move the last rays of a batch together, and return how many lanes are then in use.

    A ray carries its random stream along, so its path does not depend on its lane.
    """
    smaller = -(-busy // STRIDE) * STRIDE
    free = 0
    for lane in range(smaller, width):
        if state[STATUS + lane] == IDLE:
            continue
        while state[STATUS + free] != IDLE:
            free += 1
        for row in range(0, STATE, LANES):
            state[row + free] = state[row + lane]
        for row in range(0, WORDS, LANES):
            words[row + free] = words[row + lane]
        length[free] = length[lane]
        ray[free] = ray[lane]
        state[STATUS + lane] = IDLE
    return smaller


@entry
def batch(seed, ensemble, first_ray, rays, grains, slab, rules, optics, exits, features):
    """Trace `rays` rays and record how they leave.

    Parameters
    ----------
    seed, ensemble, first_ray : int
        Name the random streams: ray i of an ensemble is the same in whatever lane and batch.
    rays : int
    grains, slab, rules, optics
        See `splits.transport.scene`; at most one coating.
    exits : float64[rays, columns]
        A row for each ray, see `splits.transport.tally`; must come from `exit_rows`.
    features : Features

    Returns
    -------
    legs : int
        Grains drawn: what the rays cost.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    core = grains.material[0, grains.layers[0] - 1]
    scene = Scene(
        single(1.0 / grains.attenuation),
        single(slab.depth),
        single(slab.saturation),
        single(optics.n[DRY_PORE]),
        single(optics.n[WET_PORE]),
        single(optics.k[WET_PORE]),
        step(optics, DRY_PORE, core),
        step(optics, WET_PORE, core),
        step(optics, core, DRY_PORE),
        step(optics, core, WET_PORE),
        single(optics.absorption[WET_PORE]),
        single(optics.absorption[core]),
        rules.entry,
        rules.facets,
        rules.wrong_side != 0,
        rules.reject_on_last_leg,
        rules.reject_across_boundary,
    )
    tables = (
        grains.curvature.astype(np.float32),
        (1.0 - grains.sphericity * grains.sphericity).astype(np.float32),
        (0.5 * grains.facetness).astype(np.float32),
    )
    state = np.zeros(STATE, dtype=np.float32)
    words = np.zeros(WORDS, dtype=np.uint32)
    length = np.zeros((LANES, optics.n.size))
    ray = np.zeros(LANES, dtype=np.int64)
    stream = np.zeros(1, dtype=np.uint64)
    state[STATUS : STATUS + LANES] = IDLE
    next_ray, busy, legs = 0, 0, 0
    width = min(LANES, max(1, -(-rays // STRIDE)) * STRIDE)
    flying, ended = 0, width
    while True:
        if ended > 0:
            for lane in range(width):
                while state[STATUS + lane] >= AT_BOUNDARY:
                    status = state[STATUS + lane]
                    if status == LOST:
                        return legs, True
                    leaves = False
                    if status == AT_BOUNDARY:
                        leaves = at_boundary(state, words, lane, slab, rules, optics)
                        if not leaves:
                            break
                    if status != IDLE:
                        busy -= 1
                    if leaves:
                        put_down(state, lane, grains, length)
                        record(exits[ray[lane]], state, lane, length, features)
                    if next_ray == rays:
                        state[STATUS + lane] = IDLE
                        break
                    length[lane] = 0.0
                    ray[lane] = next_ray
                    passed = launch(
                        state, words, lane, seed, ensemble, first_ray + next_ray,
                        slab, rules, optics, stream,
                    )  # fmt: skip
                    next_ray += 1
                    busy += 1
                    if not passed:
                        busy -= 1
                        record(exits[ray[lane]], state, lane, length, features)
                        state[STATUS + lane] = IDLE
            if busy == 0:
                return legs, False
            if busy <= width - STRIDE:
                width = close_ranks(state, words, length, ray, width, busy)
            flying = 0
            for lane in range(width):
                if state[STATUS + lane] == FLYING:
                    flying += 1
        # Whichever pass serves more lanes.
        if 2 * flying >= busy:
            legs += flying
            draw_types(state, words, width, features, tables, grains.share)
            if features.mixed is not None:
                for lane in range(width):
                    if state[STATUS + lane] == FLYING:
                        put_down(state, lane, grains, length)
            flying, ended = flight(state, words, width, features, scene)
            if features.mixed is not None:
                for lane in range(width):
                    if state[STATUS + lane] == TRIAL and state[LAYER + lane] == ZERO:
                        dress(state, lane, grains, optics)
        else:
            flying = surface(state, words, width, features, scene)
            ended = 0
