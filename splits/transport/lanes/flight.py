"""Roulette, the next grain and the way to it, for every lane between grains.

The scalar counterpart is `splits.transport.granular`; see there for the physics.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.absorption import NEXT_ROULETTE, ROULETTE_SURVIVAL
from splits.transport.arithmetic import fused, root
from splits.transport.elementary import circle, logarithm
from splits.transport.granular import MAX_REJECTIONS
from splits.transport.jit import HALF, ONE, TWO, ZERO, entry, kernel
from splits.transport.lanes.numbers import fine, three, word
from splits.transport.lanes.rows import (
    A_WET,
    ABSORBED,
    AT_BOUNDARY,
    AT_CURVATURE,
    AT_FLATTENING,
    AT_KIND,
    AT_SIGMA,
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
    KEEP,
    KIND,
    LANES,
    LAST,
    LAYER,
    LEGS,
    LIMIT,
    LOST,
    LX,
    LY,
    LZ,
    MINOR,
    MOST,
    NEW_CURVATURE,
    NEW_FLATTENING,
    NEW_KIND,
    NEW_SIGMA,
    ORDER,
    PICKED,
    PORE_PATH,
    QX,
    QY,
    QZ,
    SIDE,
    SIGMA,
    SKIP_LEG,
    STATUS,
    STRIDE,
    TRIAL,
    TRIES,
    VECTOR,
    WEIGHT,
    WET,
    WX,
    WY,
    WZ,
    X,
    Y,
    Z,
)  # fmt: skip
from splits.transport.lanes.vectors import look_up, two_at_a_time, widest_vectors
from splits.transport.spheroid import (
    PROJECTED,
    crosses,
    cuts_segment,
    entry_point,
    slope_squared,
)

_NEXT = single(NEXT_ROULETTE)
_SURVIVAL = single(ROULETTE_SURVIVAL)
_LIGHTER = single(1.0 / ROULETTE_SURVIVAL)
_MOST_TRIES = single(MAX_REJECTIONS)
_NUMBERS = np.uint32(5)
_33 = np.uint64(33)
_LOW31 = np.uint64(0x7FFFFFFF)
_TO_31 = single(2.0**-31)


@kernel
def position(u, last):
    """Return where the probability u lies in a table of `rng.table_probabilities`, 0 to `last`."""
    below = u < HALF
    x = root(HALF * (u if below else max(ONE - u, ZERO)))
    return (x if below else ONE - x) * last


@kernel
def draws(state, words, first, features, last):
    """Draw the numbers that decide the next grain of `STRIDE` lanes from `first` on."""
    widest_vectors()
    first &= LANES - 1
    for j in range(STRIDE):
        i = first + j
        bits = word(words, i, 3)
        state[AT_CURVATURE + i] = position((single(np.int32(bits >> _33)) + HALF) * _TO_31, last)
        state[AT_FLATTENING + i] = position((single(np.int32(bits & _LOW31)) + HALF) * _TO_31, last)
        bits = word(words, i, 4)
        if features.faceted is not None:
            state[AT_SIGMA + i] = position((single(np.int32(bits >> _33)) + HALF) * _TO_31, last)
        if features.mixed is not None:
            state[AT_KIND + i] = (single(np.int32(bits & _LOW31)) + HALF) * _TO_31
            state[PICKED + i] = ZERO
    two_at_a_time()


@kernel
def picks(state, first, share):
    """Choose the type of the next grain of `STRIDE` lanes from `first` on."""
    widest_vectors()
    first &= LANES - 1
    for row in range(share.size - 1):
        bound = single(share[row])
        for j in range(STRIDE):
            i = first + j
            state[PICKED + i] += ONE if state[AT_KIND + i] >= bound else ZERO
    for j in range(STRIDE):
        i = first + j
        kind, picked = state[NEW_KIND + i], state[PICKED + i]
        state[NEW_KIND + i] = kind if state[KEEP + i] > ZERO else picked


@entry
def draw_types(state, words, width, features, tables, share):
    """Draw type, size, shape and roughness of the next grain in every lane.

    A trial refused for its axial position keeps type and shape, which made that likely.

    Parameters
    ----------
    state, words, width, features
        See `flight`.
    tables : tuple of 3 float32[rows, m]
        Curvature, flattening and half facetness at the probabilities of
        `rng.table_probabilities`.
    share : float64[types]
        See `splits.transport.scene.Grains`.
    """
    widest_vectors()
    curvature, flattening, sigma = tables
    last = single(curvature.shape[1] - 1)
    for first in range(0, width, STRIDE):
        draws(state, words, first, features, last)
        if features.mixed is not None:
            picks(state, first, share)
    for i in range(0, width, VECTOR):
        look_up(curvature, state, NEW_KIND + i, AT_CURVATURE + i, NEW_CURVATURE + i)
        look_up(flattening, state, NEW_KIND + i, AT_FLATTENING + i, AT_FLATTENING + i)
        if features.faceted is not None:
            look_up(sigma, state, NEW_KIND + i, AT_SIGMA + i, NEW_SIGMA + i)
    for i in range(width):
        old, drawn = state[NEW_FLATTENING + i], state[AT_FLATTENING + i]
        state[NEW_FLATTENING + i] = old if state[KEEP + i] > ZERO else drawn


@kernel
def flights(state, words, first, features, scene):
    """Do what `flight` does for `STRIDE` lanes from `first` on."""
    flying = np.int32(0)
    ended = np.int32(0)
    widest_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first &= LANES - 1
    for j in range(STRIDE):
        i = first + j
        status = state[STATUS + i]
        active = status == FLYING
        u_roulette, u_facing, u_azimuth = three(word(words, i, 0))
        u_turn, u_axial, u_area = three(word(words, i, 1))
        u_leg = fine(word(words, i, 2))
        count = words[COUNT + i]
        words[COUNT + i] = np.uint32(count + _NUMBERS) if active else count
        legs = words[LEGS + i]
        words[LEGS + i] = np.uint32(legs + np.uint32(1)) if active else legs

        limit, weight = state[LIMIT + i], state[WEIGHT + i]
        played = active & (state[DEPTH + i] > limit)
        absorbed = played & (u_roulette > _SURVIVAL)
        state[LIMIT + i] = limit + _NEXT if played else limit
        state[WEIGHT + i] = weight * _LIGHTER if played else weight

        dx, dy, dz = state[DX + i], state[DY + i], state[DZ + i]
        gx, gy, gz = state[GX + i], state[GY + i], state[GZ + i]
        lx, ly, lz, last = state[LX + i], state[LY + i], state[LZ + i], state[LAST + i]
        z = state[Z + i]
        leg = -logarithm(u_leg) * scene.mean_leg
        if features.variant is not None:
            skipped = state[SKIP_LEG + i]
            leg += skipped
        # A grain kept across a boundary may have ended outside: the ray stands on the boundary.
        height = fused(leg, dz, min(max(z + gz, -scene.depth), ZERO))
        outside = (height > ZERO) | (height < -scene.depth)

        old_flattening = state[FLATTENING + i]
        flattening = state[NEW_FLATTENING + i]
        major = ONE / state[NEW_CURVATURE + i]
        minor = (ONE - flattening) * major
        axial = TWO * u_axial - ONE
        placed = u_area * u_area < slope_squared(axial, flattening)
        facing = u_facing
        if features.variant is not None:
            facing = root(u_facing) if scene.entry == PROJECTED else u_facing
        ca, sa = circle(u_azimuth)
        ct, st = circle(u_turn)
        qx, qy, qz, wx, wy, wz, _, _, _ = entry_point(
            dx, dy, dz, facing, ca, sa, axial, ct, st, flattening
        )
        across = scene.refuse_across_boundary & crosses(
            height, qz, wz, axial, minor, major, scene.depth
        )
        backwards = scene.refuse_on_last_leg & cuts_segment(
            qx, qy, qz, wx, wy, wz, minor, flattening,
            fused(-leg, dx, -gx), fused(-leg, dy, -gy), fused(-leg, dz, -gz), lx, ly, lz, last,
        )  # fmt: skip
        # The trial of the axial position comes before all else that a draw can lead to, so that
        # its failures leave no trace in distances, shapes and types.
        going = active & placed & (not absorbed)
        fits = going & (not outside) & (not across) & (not backwards)
        if features.variant is not None:
            skips = scene.skip_across_boundary if across else scene.skip_on_last_leg & backwards
            skipped = leg if going & skips else skipped
            state[SKIP_LEG + i] = ZERO if fits | (going & outside) else skipped
        state[KEEP + i] = ONE if active & (not placed) else ZERO
        tries = state[TRIES + i]
        tries = tries + ONE if active & (not fits) else ZERO
        state[TRIES + i] = tries
        if features.positions is not None:
            x, y = state[X + i], state[Y + i]
            state[X + i] = x + gx + leg * dx if fits else x
            state[Y + i] = y + gy + leg * dy if fits else y
        state[Z + i] = height if fits else z
        state[GX + i] = ZERO if fits else gx
        state[GY + i] = ZERO if fits else gy
        state[GZ + i] = ZERO if fits else gz
        state[LX + i] = dx if fits else lx
        state[LY + i] = dy if fits else ly
        state[LZ + i] = dz if fits else lz
        state[LAST + i] = leg if fits else last
        if features.wet is not None:
            path = leg * state[WET + i]
            path = path if fits else ZERO
            state[PORE_PATH + i] += path
            state[DEPTH + i] += path * state[A_WET + i]
        old = state[QX + i]
        state[QX + i] = qx if fits else old
        old = state[QY + i]
        state[QY + i] = qy if fits else old
        old = state[QZ + i]
        state[QZ + i] = qz if fits else old
        old = state[WX + i]
        state[WX + i] = wx if fits else old
        old = state[WY + i]
        state[WY + i] = wy if fits else old
        old = state[WZ + i]
        state[WZ + i] = wz if fits else old
        state[FLATTENING + i] = flattening if fits else old_flattening
        old = state[MINOR + i]
        state[MINOR + i] = minor if fits else old
        if features.faceted is not None:
            old = state[SIGMA + i]
            new = state[NEW_SIGMA + i]
            state[SIGMA + i] = new if fits else old
        old = state[LAYER + i]
        state[LAYER + i] = ZERO if fits else old
        old = state[SIDE + i]
        state[SIDE + i] = ONE if fits else old
        if features.mixed is not None:
            old = state[KIND + i]
            new = state[NEW_KIND + i]
            state[KIND + i] = new if fits else old
        after = TRIAL if fits else FLYING
        after = AT_BOUNDARY if going & outside else after
        after = LOST if tries > _MOST_TRIES else after
        after = ABSORBED if absorbed else after
        if features.orders is not None:
            order = words[ORDER + i]
            over = fits & (order >= words[MOST + i])
            words[ORDER + i] = np.uint32(order + np.uint32(1)) if fits else order
            after = ABSORBED if over else after
        after = after if active else status
        state[STATUS + i] = after
        flying = np.int32(flying + 1) if after == FLYING else flying
        ended = np.int32(ended + 1) if after >= AT_BOUNDARY else ended
    two_at_a_time()
    return flying, ended


@entry
def flight(state, words, width, features, scene):
    """Give all lanes between grains their next grain, or another fate.

    Parameters
    ----------
    state : float32[STATE]
    words : uint32[WORDS]
    width : int
        Lanes in use, from the first on: a multiple of `rows.STRIDE`.
    features, scene : Features, Scene
        See `splits.transport.lanes.rows`.

    Returns
    -------
    flying : int32
        Lanes that still wait for a grain that fits.
    ended : int32
        Lanes that wait for the loop that ends and launches rays.
    """
    widest_vectors()
    flying = np.int32(0)
    ended = np.int32(0)
    for first in range(0, width, STRIDE):
        more = flights(state, words, first, features, scene)
        flying += more[0]
        ended += more[1]
    return flying, ended
