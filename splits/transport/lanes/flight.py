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
    distance: float
    entry: Aim


class Waiting(NamedTuple):
    """Lanes that wait for a grain, and for the loop that ends and launches rays."""

    n_in_flight: int
    n_finished: int


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
def space_at(state, i, constants, layered):
    """Return the space that a lane's ray is in."""
    space = constants.layer_geometry
    if layered is None:
        return space
    mean_leg, low, high = (
        state[rows.MEAN_LEG + i], state[rows.LOW + i], state[rows.HIGH + i]
    )  # fmt: skip
    return Space(mean_leg, low, high, space.slab_bottom, space.slab_top, space.grain_ceiling)


@part
def astray(state, i, geometry, layer_geometry):
    """Tell whether a lane's ray left a grain on the other side of a face between layers."""
    z = geometry.position.z + geometry.exit_offset.z
    above = (z > layer_geometry.top) & (layer_geometry.top < layer_geometry.slab_top)
    below = (z < layer_geometry.bottom) & (layer_geometry.bottom > layer_geometry.slab_bottom)
    setting_out = (state[rows.LAYER + i] == state[rows.START + i]) & (
        state[rows.STANDS + i] == ZERO
    )
    return setting_out & (above | below)


@part
def redrawn(state, i, geometry, collision, rejected):
    """Note from where a lane's next grain is drawn; tell whether that is in another layer."""
    left_out = rejected & (collision.start_distance == collision.distance)
    ahead, skip, start = state[rows.AHEAD + i], state[rows.SKIP_LEG + i], state[rows.FROM + i]
    layer = state[rows.LAYER + i]
    back = rejected & (not left_out) & (layer != start)
    again = rejected & (not left_out) & (layer == start)
    state[rows.SKIP_LEG + i] = collision.distance if left_out else skip
    state[rows.FROM + i] = layer if left_out else start
    ahead = skip if again else ahead
    state[rows.AHEAD + i] = collision.distance if left_out else ahead
    return back


@part
def fly(state, words, i, features, constants):
    """Give a lane its next grain or another fate, and return what it then waits for."""
    status = state[rows.STATUS + i]
    active = status == rows.FLYING
    numbers = numbers_at(words, i, active)
    purse = Purse(state[rows.DEPTH + i], state[rows.LIMIT + i], state[rows.WEIGHT + i])
    played = roulette(purse, numbers.roulette, active)
    state[rows.LIMIT + i], state[rows.WEIGHT + i] = played.roulette.next_roulette, played.roulette.weight
    ray = flier_at(state, i, features.layered)
    space = space_at(state, i, constants, features.layered)
    # The trial of the axial position comes before all else that a draw can lead to, so that its
    # failures leave no trace in distances, shapes and types.
    size = Size(ONE / state[rows.NEW_CURVATURE + i], state[rows.NEW_FLATTENING + i])
    met = next_grain(ray, size, numbers.entry, numbers.distance, space, constants.rejection_rules)
    sound = placed(numbers.entry, size.flattening)
    going = active & sound & (not played.terminated)
    strays = False
    if features.layered is not None:
        strays = active & (not played.terminated) & astray(state, i, ray, space)
        going = going & (not strays)
    fits = going & met.accepted
    after = rows.TRIAL if fits else rows.FLYING
    after = rows.AT_FACE if going & met.leaves_layer else after
    if features.layered is not None:
        refused = going & (not met.accepted) & (not met.leaves_layer)
        after = rows.BACK if redrawn(state, i, ray, met, refused) else after
        after = rows.ASTRAY if strays else after
        landed = state[rows.LANDED + i]
        state[rows.LANDED + i] = ZERO if fits else landed
    else:
        state[rows.SKIP_LEG + i] = met.start_distance if going else ray.start_distance
    state[rows.KEEP + i] = ONE if active & (not sound) else ZERO
    tries = state[rows.TRIES + i]
    tries = tries + ONE if active & (not fits) else ZERO
    state[rows.TRIES + i] = tries
    arrive(state, i, ray, met, fits, features)
    take(state, i, met.entry.grain, fits, features)
    after = rows.LOST if tries > _MOST_TRIES else after
    after = rows.ABSORBED if played.terminated else after
    order = words[rows.ORDER + i]
    over = fits & (order >= words[rows.MOST + i])
    words[rows.ORDER + i] = np.uint32(order + np.uint32(1)) if fits else order
    after = rows.ABSORBED if over else after
    after = after if active else status
    state[rows.STATUS + i] = after
    return after


@part
def arrive(state, i, geometry, collision, accepted, features):
    """Bring a lane's ray to the grain that it meets, if there is one."""
    place, way, d, leg = geometry.position, geometry.exit_offset, geometry.direction, collision.distance
    state[rows.X + i] = place.x + way.x + leg * d.x if accepted else place.x
    state[rows.Y + i] = place.y + way.y + leg * d.y if accepted else place.y
    state[rows.Z + i] = collision.height if accepted else place.z
    put(state, rows.GX + i, chosen(accepted, Vector(ZERO, ZERO, ZERO), way))
    put(state, rows.LX + i, chosen(accepted, d, geometry.previous_segment.direction))
    state[rows.LAST + i] = leg if accepted else geometry.previous_segment.length
    # Legs through several layers are booked between the passes.
    if features.layered is None:
        travel(state, i, leg if accepted else ZERO, features)


@part
def travel(state, i, distance, features):
    """Take a lane's leg through its pore."""
    wet = state[rows.WET + i]
    if features.wet is not None:
        path = distance * wet
        state[rows.WET_PATH + i] += path
        state[rows.DEPTH + i] += path * state[rows.A_WET + i]
    path = distance * (ONE - wet)
    state[rows.DRY_PATH + i] += path
    state[rows.DEPTH + i] += path * state[rows.A_DRY + i]


@part
def take(state, i, grain, accepted, features):
    """Give a lane the grain that its ray meets, if it does."""
    put(state, rows.QX + i, chosen(accepted, grain.q, vector(state, rows.QX + i)))
    put(state, rows.WX + i, chosen(accepted, grain.w, vector(state, rows.WX + i)))
    flattening, minor = state[rows.FLATTENING + i], state[rows.MINOR + i]
    layer, side = state[rows.SHELL + i], state[rows.SIDE + i]
    state[rows.FLATTENING + i] = grain.flattening if accepted else flattening
    state[rows.MINOR + i] = grain.semi_minor if accepted else minor
    state[rows.SHELL + i] = ZERO if accepted else layer
    state[rows.SIDE + i] = ONE if accepted else side
    if features.faceted is not None:
        old, new = state[rows.SIGMA + i], state[rows.NEW_SIGMA + i]
        state[rows.SIGMA + i] = new if accepted else old
    if features.mixed is not None:
        old, new = state[rows.KIND + i], state[rows.NEW_KIND + i]
        state[rows.KIND + i] = new if accepted else old


@part
def flights(state, words, first_lane, features, constants):
    """Do what `flight` does for `STRIDE` lanes from `first` on."""
    flying = np.int32(0)
    ended = np.int32(0)
    widest_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first_lane &= rows.LANES - 1
    for j in range(rows.STRIDE):
        after = fly(state, words, first_lane + j, features, constants)
        flying = np.int32(flying + 1) if after == rows.FLYING else flying
        ended = np.int32(ended + 1) if after >= rows.AT_FACE else ended
    two_at_a_time()
    return Waiting(flying, ended)


@borrower
def flight(state, words, width, features, constants):
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
        more = flights(state, words, first, features, constants)
        flying = np.int32(flying + more.n_in_flight)
        ended = np.int32(ended + more.n_finished)
    return Waiting(flying, ended)
