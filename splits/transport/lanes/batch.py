"""A batch of rays on lanes: launches, boundaries and ends between the passes.

Counterpart of `splits.transport.granular.batch`, for several ensembles at a time.
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
    A_WET,
    AT_BOUNDARY,
    C_IN_DRY,
    C_IN_WET,
    C_OUT_DRY,
    C_OUT_WET,
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
    K_IN_DRY,
    K_IN_WET,
    K_OUT_WET,
    K_OUTER,
    K_WET,
    KEEP,
    KEY_HIGH,
    KEY_LOW,
    KIND,
    LANES,
    LAST,
    LAYER,
    LAYERS,
    LEGS,
    LIMIT,
    LOST,
    LX,
    LY,
    LZ,
    M_IN_DRY,
    M_IN_WET,
    M_OUT_DRY,
    M_OUT_WET,
    MINOR,
    MOST,
    N_CORE,
    N_DRY,
    N_OUTER,
    N_WET,
    ORDER,
    PORE_PATH,
    SKIP_LEG,
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
    X,
    Y,
    Z,
)  # fmt: skip
from splits.transport.lanes.surface import surface
from splits.transport.rng import start_stream
from splits.transport.scene import DRY_PORE, KEPT, SKIPPED, WET_PORE
from splits.transport.tally import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
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
def launch(state, words, lane, seed, work, item, number, slab, rules, optics, core, stream):
    """Start a ray of an item in a lane; False if the slab's wet top sends it back at once."""
    start_stream(stream, seed, work[item, 0], work[item, 1] + number)
    words[KEY_HIGH + lane] = np.uint32(stream[0] >> np.uint64(32))
    words[KEY_LOW + lane] = np.uint32(stream[0] & _LOW32)
    words[COUNT + lane] = np.uint32(1)
    words[LEGS + lane] = np.uint32(0)
    words[ORDER + lane] = np.uint32(0)
    words[MOST + lane] = np.uint32(work[item, 3])
    mu = math.sqrt(draw(words, lane)) if slab.diffuse else slab.cos_incidence
    dx, dy, dz = math.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, -mu
    wet = slab.saturation > 0.0 and draw(words, lane) < slab.saturation
    passed = True
    if wet and rules.boundary_fresnel:
        n1, n2 = optics.n[item, DRY_PORE], optics.n[item, WET_PORE]
        passed, dx, dy, dz = boundary(words, lane, dx, dy, dz, n1, n2, optics.k[item, WET_PORE])
    for row in (X, Y, Z, GX, GY, GZ, LX, LY, DEPTH, TRIES, KEEP, SKIP_LEG):
        state[row + lane] = ZERO
    for row in (PORE_PATH, COAT_PATH, CORE_PATH):
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
    illuminate(state, lane, optics, item, core)
    return passed


@kernel
def illuminate(state, lane, optics, item, core):
    """Give a lane the optics of its light; all grains have the core's unless dressed otherwise."""
    n, k = optics.n, optics.k
    state[N_DRY + lane] = single(n[item, DRY_PORE])
    state[N_WET + lane] = single(n[item, WET_PORE])
    state[K_WET + lane] = single(k[item, WET_PORE])
    state[A_WET + lane] = single(optics.absorption[item, WET_PORE])
    state[A_CORE + lane] = single(optics.absorption[item, core])
    m, c, x = step(n[item, DRY_PORE], 0.0, n[item, core], k[item, core])
    state[M_IN_DRY + lane], state[C_IN_DRY + lane], state[K_IN_DRY + lane] = m, c, x
    m, c, x = step(n[item, WET_PORE], k[item, WET_PORE], n[item, core], k[item, core])
    state[M_IN_WET + lane], state[C_IN_WET + lane], state[K_IN_WET + lane] = m, c, x
    m, c, x = step(n[item, core], k[item, core], n[item, DRY_PORE], 0.0)
    state[M_OUT_DRY + lane], state[C_OUT_DRY + lane] = m, c
    m, c, x = step(n[item, core], k[item, core], n[item, WET_PORE], k[item, WET_PORE])
    state[M_OUT_WET + lane], state[C_OUT_WET + lane], state[K_OUT_WET + lane] = m, c, x


@kernel
def step(n1, k1, n2, k2):
    """Return real part, real part less 1, and imaginary part of the index seen from medium 1."""
    k = 0.0 if n1 == n2 and k1 == k2 else k2 / n1
    return single(n2 / n1), single((n2 - n1) / n1), single(k)


@kernel
def put_down(state, lane, grains, length):
    """Add the lane's paths since last time to `length` (float64[lanes, materials])."""
    kind = int(state[KIND + lane])
    layers = grains.layers[kind]
    length[lane, WET_PORE] += state[PORE_PATH + lane]
    length[lane, grains.material[kind, 0]] += state[COAT_PATH + lane]
    length[lane, grains.material[kind, layers - 1]] += state[CORE_PATH + lane]
    for row in (PORE_PATH, COAT_PATH, CORE_PATH):
        state[row + lane] = ZERO


@kernel
def dress(state, lane, grains, optics, item):
    """Give a lane the materials of the grain that it has just met."""
    kind = int(state[KIND + lane])
    layers = grains.layers[kind]
    outer = grains.material[kind, 0]
    core = grains.material[kind, layers - 1]
    state[LAYERS + lane] = single(layers)
    state[N_OUTER + lane] = single(optics.n[item, outer])
    state[K_OUTER + lane] = single(optics.k[item, outer])
    state[N_CORE + lane] = single(optics.n[item, core])
    state[K_CORE + lane] = single(optics.k[item, core])
    state[A_OUTER + lane] = single(optics.absorption[item, outer])
    state[A_CORE + lane] = single(optics.absorption[item, core])
    major = state[MINOR + lane] / (ONE - state[FLATTENING + lane])
    state[THICKNESS + lane] = single(2.0 * grains.thickness[kind, 0]) * major


@kernel
def at_boundary(state, words, lane, slab, rules, optics, item):
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
    state[DEPTH + lane] += leg * state[A_WET + lane]
    if not rules.boundary_fresnel:
        return True
    n1, n2 = optics.n[item, WET_PORE], optics.n[item, DRY_PORE]
    passed, ex, ey, ez = boundary(words, lane, float(dx), float(dy), float(dz), n1, n2, 0.0)
    state[LX + lane], state[LY + lane], state[LZ + lane] = dx, dy, dz
    state[LAST + lane] = leg
    state[DX + lane], state[DY + lane], state[DZ + lane] = single(ex), single(ey), single(ez)
    state[TRIES + lane] = ZERO
    state[STATUS + lane] = FLYING
    return passed


@kernel
def record(row, state, words, lane, length, features):
    """Write a ray that left into a row of the exits."""
    row[EXIT_SIDE] = 0.0 if state[DZ + lane] > ZERO else 1.0
    row[EXIT_WEIGHT] = state[WEIGHT + lane]
    row[EXIT_DIRECTION] = state[DX + lane]
    row[EXIT_DIRECTION + 1] = state[DY + lane]
    row[EXIT_DIRECTION + 2] = state[DZ + lane]
    if features.orders is not None:
        row[EXIT_ORDER] = words[ORDER + lane]
    if features.positions is not None:
        row[EXIT_POSITION], row[EXIT_POSITION + 1] = state[X + lane], state[Y + lane]
    row[EXIT_LENGTH : EXIT_LENGTH + length.shape[1]] = length[lane]


@kernel
def close_ranks(state, words, length, ray, items, width, busy):
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
        items[free] = items[lane]
        state[STATUS + lane] = IDLE
    return smaller


@entry
def batch(seed, work, grains, slab, rules, optics, exits, features):
    """Trace rays of several ensembles and record how they leave.

    Rays of all of them share the lanes: only once the last of all has started do lanes stand idle.

    Parameters
    ----------
    seed : int
    work : int64[items, 4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed,
        which takes ``features.orders``.  Seed, ensemble and number name a ray's random stream: it
        is the same in whatever lane and batch, and in whatever company.
    grains, slab, rules
        See `splits.transport.scene`; at most one coating.
    optics : Optics
        With a row for each item.
    exits : float64[rays, columns]
        A row for each ray, item after item, see `splits.transport.tally`; must come from
        `exit_rows`.
    features : Features

    Returns
    -------
    legs : int64[items]
        Grains drawn: what the rays cost.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    core = grains.material[0, grains.layers[0] - 1]
    scene = Scene(
        single(1.0 / grains.attenuation),
        single(slab.depth),
        single(slab.saturation),
        rules.entry,
        rules.facets,
        rules.wrong_side != 0,
        rules.on_last_leg != KEPT,
        rules.across_boundary != KEPT,
        rules.on_last_leg == SKIPPED,
        rules.across_boundary == SKIPPED,
    )
    tables = (
        grains.curvature.astype(np.float32),
        (1.0 - grains.sphericity * grains.sphericity).astype(np.float32),
        (0.5 * grains.facetness).astype(np.float32),
    )
    state = np.zeros(STATE, dtype=np.float32)
    words = np.zeros(WORDS, dtype=np.uint32)
    length = np.zeros((LANES, optics.n.shape[1]))
    ray = np.zeros(LANES, dtype=np.int64)
    items = np.zeros(LANES, dtype=np.int64)
    legs = np.zeros(len(work), dtype=np.int64)
    stream = np.zeros(1, dtype=np.uint64)
    state[STATUS : STATUS + LANES] = IDLE
    rays = work[:, 2].sum()
    next_ray, item, number, busy = 0, 0, 0, 0
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
                        leaves = at_boundary(state, words, lane, slab, rules, optics, items[lane])
                        if not leaves:
                            break
                    if status != IDLE:
                        busy -= 1
                        legs[items[lane]] += words[LEGS + lane]
                    if leaves:
                        put_down(state, lane, grains, length)
                        record(exits[ray[lane]], state, words, lane, length, features)
                    if next_ray == rays:
                        state[STATUS + lane] = IDLE
                        break
                    while number == work[item, 2]:
                        item += 1
                        number = 0
                    length[lane] = 0.0
                    ray[lane] = next_ray
                    items[lane] = item
                    passed = launch(
                        state, words, lane, seed, work, item, number,
                        slab, rules, optics, core, stream,
                    )  # fmt: skip
                    next_ray += 1
                    number += 1
                    busy += 1
                    if not passed:
                        busy -= 1
                        record(exits[ray[lane]], state, words, lane, length, features)
                        state[STATUS + lane] = IDLE
            if busy == 0:
                return legs, False
            if busy <= width - STRIDE:
                width = close_ranks(state, words, length, ray, items, width, busy)
            flying = 0
            for lane in range(width):
                if state[STATUS + lane] == FLYING:
                    flying += 1
        # Whichever pass serves more lanes.
        if 2 * flying >= busy:
            draw_types(state, words, width, features, tables, grains.share)
            if features.mixed is not None:
                for lane in range(width):
                    if state[STATUS + lane] == FLYING:
                        put_down(state, lane, grains, length)
            flying, ended = flight(state, words, width, features, scene)
            if features.mixed is not None:
                for lane in range(width):
                    if state[STATUS + lane] == TRIAL and state[LAYER + lane] == ZERO:
                        dress(state, lane, grains, optics, items[lane])
        else:
            flying = surface(state, words, width, features, scene)
            ended = 0
