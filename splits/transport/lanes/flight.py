"""Roulette, the next grain and the way to it, for every lane between grains.

See `splits.transport.grains.flight` for the physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.jit import ONE, ZERO, borrower, part
from splits.transport.grains.flight import Flier, Purse, Space, next_grain, roulette
from splits.transport.grains.scene import MAX_REJECTIONS
from splits.transport.grains.spheroid import Aim, Segment, Size, placed
from splits.transport.lanes import rows
from splits.transport.lanes.numbers import fine, three, word
from splits.transport.lanes.rows import put, vector
from splits.transport.lanes.vectors import two_at_a_time, widest_vectors
from splits.transport.numerics.elementary import circle
from splits.transport.numerics.vectors import Vector, chosen

_MOST_TRIES = single(MAX_REJECTIONS)
_NUMBERS = np.uint32(5)


class Numbers(NamedTuple):
    """Uniform random numbers of a flight."""

    roulette: float
    leg: float
    aim: Aim


class Waiting(NamedTuple):
    """Lanes that wait for a grain, and for the loop that ends and launches rays."""

    flying: int
    ended: int


@part
def numbers_at(words, i, active):
    """Draw a lane's random numbers of a flight; lanes that wait keep their place in the stream."""
    roulette_, facing, azimuth = three(word(words, i, 0))
    turn, axial, area = three(word(words, i, 1))
    leg = fine(word(words, i, 2))
    count = words[rows.COUNT + i]
    words[rows.COUNT + i] = np.uint32(count + _NUMBERS) if active else count
    legs = words[rows.LEGS + i]
    words[rows.LEGS + i] = np.uint32(legs + np.uint32(1)) if active else legs
    return Numbers(roulette_, leg, Aim(facing, circle(azimuth), circle(turn), axial, area))


@part
def flier_at(state, i, layered):
    """Return a lane's ray between grains."""
    last = Segment(vector(state, rows.LX + i), vector(state, rows.LX + i), state[rows.LAST + i])
    place, way = vector(state, rows.X + i), vector(state, rows.GX + i)
    skipped = state[rows.SKIP_LEG + i]
    if layered is not None:
        skipped = state[rows.AHEAD + i]
    return Flier(place, way, vector(state, rows.DX + i), last, skipped)


@part
def space_at(state, i, scene, layered):
    """Return the space that a lane's ray is in."""
    space = scene.space
    if layered is None:
        return space
    mean_leg, low, high = (
        state[rows.MEAN_LEG + i], state[rows.LOW + i], state[rows.HIGH + i]
    )  # fmt: skip
    return Space(mean_leg, low, high, space.floor, space.ceiling, space.brim)


@part
def astray(state, i, ray, space):
    """Tell whether a lane's ray left a grain on the other side of a face between layers."""
    z = ray.place.z + ray.way.z
    above = (z > space.high) & (space.high < space.ceiling)
    below = (z < space.low) & (space.low > space.floor)
    setting_out = (state[rows.LAYER + i] == state[rows.START + i]) & (
        state[rows.STANDS + i] == ZERO
    )
    return setting_out & (above | below)


@part
def redrawn(state, i, ray, met, refused):
    """Note from where a lane's next grain is drawn; tell whether that is in another layer."""
    left_out = refused & (met.skipped == met.leg)
    ahead, skip, start = state[rows.AHEAD + i], state[rows.SKIP_LEG + i], state[rows.FROM + i]
    layer = state[rows.LAYER + i]
    back = refused & (not left_out) & (layer != start)
    again = refused & (not left_out) & (layer == start)
    state[rows.SKIP_LEG + i] = met.leg if left_out else skip
    state[rows.FROM + i] = layer if left_out else start
    ahead = skip if again else ahead
    state[rows.AHEAD + i] = met.leg if left_out else ahead
    return back


@part
def fly(state, words, i, features, scene):
    """Give a lane its next grain or another fate, and return what it then waits for."""
    status = state[rows.STATUS + i]
    active = status == rows.FLYING
    numbers = numbers_at(words, i, active)
    purse = Purse(state[rows.DEPTH + i], state[rows.LIMIT + i], state[rows.WEIGHT + i])
    played = roulette(purse, numbers.roulette, active)
    state[rows.LIMIT + i], state[rows.WEIGHT + i] = played.purse.limit, played.purse.weight
    ray = flier_at(state, i, features.layered)
    space = space_at(state, i, scene, features.layered)
    # The trial of the axial position comes before all else that a draw can lead to, so that its
    # failures leave no trace in distances, shapes and types.
    size = Size(ONE / state[rows.NEW_CURVATURE + i], state[rows.NEW_FLATTENING + i])
    met = next_grain(ray, size, numbers.aim, numbers.leg, space, scene.fates)
    sound = placed(numbers.aim, size.flattening)
    going = active & sound & (not played.ended)
    strays = False
    if features.layered is not None:
        strays = active & (not played.ended) & astray(state, i, ray, space)
        going = going & (not strays)
    fits = going & met.fits
    after = rows.TRIAL if fits else rows.FLYING
    after = rows.AT_FACE if going & met.outside else after
    if features.layered is not None:
        refused = going & (not met.fits) & (not met.outside)
        after = rows.BACK if redrawn(state, i, ray, met, refused) else after
        after = rows.ASTRAY if strays else after
        landed = state[rows.LANDED + i]
        state[rows.LANDED + i] = ZERO if fits else landed
    else:
        state[rows.SKIP_LEG + i] = met.skipped if going else ray.skipped
    state[rows.KEEP + i] = ONE if active & (not sound) else ZERO
    tries = state[rows.TRIES + i]
    tries = tries + ONE if active & (not fits) else ZERO
    state[rows.TRIES + i] = tries
    arrive(state, i, ray, met, fits, features)
    take(state, i, met.entry.grain, fits, features)
    after = rows.LOST if tries > _MOST_TRIES else after
    after = rows.ABSORBED if played.ended else after
    order = words[rows.ORDER + i]
    over = fits & (order >= words[rows.MOST + i])
    words[rows.ORDER + i] = np.uint32(order + np.uint32(1)) if fits else order
    after = rows.ABSORBED if over else after
    after = after if active else status
    state[rows.STATUS + i] = after
    return after


@part
def arrive(state, i, ray, met, fits, features):
    """Bring a lane's ray to the grain that it meets, if there is one."""
    place, way, d, leg = ray.place, ray.way, ray.d, met.leg
    state[rows.X + i] = place.x + way.x + leg * d.x if fits else place.x
    state[rows.Y + i] = place.y + way.y + leg * d.y if fits else place.y
    state[rows.Z + i] = met.height if fits else place.z
    put(state, rows.GX + i, chosen(fits, Vector(ZERO, ZERO, ZERO), way))
    put(state, rows.LX + i, chosen(fits, d, ray.last.d))
    state[rows.LAST + i] = leg if fits else ray.last.length
    # Legs through several layers are booked between the passes.
    if features.layered is None:
        travel(state, i, leg if fits else ZERO, features)


@part
def travel(state, i, leg, features):
    """Take a lane's leg through its pore."""
    wet = state[rows.WET + i]
    if features.wet is not None:
        path = leg * wet
        state[rows.WET_PATH + i] += path
        state[rows.DEPTH + i] += path * state[rows.A_WET + i]
    path = leg * (ONE - wet)
    state[rows.DRY_PATH + i] += path
    state[rows.DEPTH + i] += path * state[rows.A_DRY + i]


@part
def take(state, i, grain, fits, features):
    """Give a lane the grain that its ray meets, if it does."""
    put(state, rows.QX + i, chosen(fits, grain.q, vector(state, rows.QX + i)))
    put(state, rows.WX + i, chosen(fits, grain.w, vector(state, rows.WX + i)))
    flattening, minor = state[rows.FLATTENING + i], state[rows.MINOR + i]
    layer, side = state[rows.SHELL + i], state[rows.SIDE + i]
    state[rows.FLATTENING + i] = grain.flattening if fits else flattening
    state[rows.MINOR + i] = grain.minor if fits else minor
    state[rows.SHELL + i] = ZERO if fits else layer
    state[rows.SIDE + i] = ONE if fits else side
    if features.faceted is not None:
        old, new = state[rows.SIGMA + i], state[rows.NEW_SIGMA + i]
        state[rows.SIGMA + i] = new if fits else old
    if features.mixed is not None:
        old, new = state[rows.KIND + i], state[rows.NEW_KIND + i]
        state[rows.KIND + i] = new if fits else old


@part
def flights(state, words, first, features, scene):
    """Do what `flight` does for `STRIDE` lanes from `first` on."""
    flying = np.int32(0)
    ended = np.int32(0)
    widest_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first &= rows.LANES - 1
    for j in range(rows.STRIDE):
        after = fly(state, words, first + j, features, scene)
        flying = np.int32(flying + 1) if after == rows.FLYING else flying
        ended = np.int32(ended + 1) if after >= rows.AT_FACE else ended
    two_at_a_time()
    return Waiting(flying, ended)


@borrower
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
    Waiting
    """
    widest_vectors()
    flying = np.int32(0)
    ended = np.int32(0)
    for first in range(0, width, rows.STRIDE):
        more = flights(state, words, first, features, scene)
        flying = np.int32(flying + more.flying)
        ended = np.int32(ended + more.ended)
    return Waiting(flying, ended)
