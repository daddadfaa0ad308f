"""Single events in a ray's life, drawn as the kernels draw them: for tests to look at.

Each comes in double precision, as the scalar kernel has it, and where its name ends in `_by_lane`
in single precision, with the random numbers of a lane.
"""

from __future__ import annotations

import math

import numpy as np
from chi2 import stream
from numba import njit
from scenes import carried

from splits.transport.compiling.features import EVERYTHING
from splits.transport.grains import facets, granular, scalar, spheroid, surface
from splits.transport.grains.flight import FIRST_ROULETTE, Meeting
from splits.transport.grains.scalar import Candidate, Found
from splits.transport.grains.scene import LOBE, UNLIMITED
from splits.transport.grains.spheroid import Spheroid
from splits.transport.grains.surface import Numbers, Stand
from splits.transport.grains.walk import trial, walk
from splits.transport.lanes import rows
from splits.transport.lanes.surface import numbers_at
from splits.transport.numerics import rng
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.vectors import UP, Vector
from splits.transport.optics.faces import Crossing

single = np.float32


@njit
def unit_sphere(state):
    """Return a direction uniform on the sphere (Marsaglia 1972)."""
    z = 2.0 * rng.uniform(state) - 1.0
    turn = rng.unit_circle(state)
    r = np.sqrt((1.0 - z) * (1.0 + z))
    return Vector(r * turn.cos, r * turn.sin, z)


@njit
def singly(v):
    """Return a vector in single precision."""
    return Vector(single(v.x), single(v.y), single(v.z))


def lane_words(ray=0):
    """Return the whole numbers of lanes whose rays have drawn nothing yet."""
    words = np.zeros(rows.WORDS, dtype=np.uint32)
    for lane in range(rows.LANES):
        start = int(stream(ray + lane)[0])
        words[rows.KEY_HIGH + lane] = start >> 32
        words[rows.KEY_LOW + lane] = start & 0xFFFFFFFF
        words[rows.COUNT + lane] = 1
        words[rows.MOST + lane] = UNLIMITED
    return words


# --- grains -----------------------------------------------------------------------------------


@njit
def struck(state, d, size, entry_rule):
    """Return where a ray along d strikes a grain."""
    aim = scalar.aim_of(state, size.flattening)
    return spheroid.strike(d, size, aim, entry_rule)


@njit
def walked(state, d, size, facetness, wet, scene, optics, length):
    """Return a ray after a grain of the first type, as the kernel has it, and the point of entry.

    Lengths are set.
    """
    length[:] = 0.0
    entry = struck(state, d, size, scene.rules.entry_sampling)
    limit = math.inf if scene.rules.analog else FIRST_ROULETTE
    candidate = Candidate(0, size, 0.5 * facetness)
    found = Found(candidate, Meeting(0.0, 0.0, entry, False, True, 0.0), 0, False)
    return walk(state, carried(d, wet, limit), found, scene, optics, length), entry


@njit
def weight_after(state, grain_path):
    """Return the weight of a ray after a grain and the roulette that follows it, 0 for none."""
    payment = granular.played(state, grain_path.payload.roulette)
    return payment.roulette.weight if grain_path.alive and payment.alive else 0.0


# --- surfaces ---------------------------------------------------------------------------------


@njit
def flat(normal):
    """Return a grain, and where on it its outward normal is `normal`."""
    return Spheroid(normal, UP, 0.0, 1.0)


@njit
def flat_by_lane(normal):
    return Spheroid(normal, singly(UP), single(0.0), single(1.0))


@njit
def facet_struck(state, d, normal, facetness, rule):
    """Return the facet that a ray strikes on a surface, drawn as `walk.trial` does."""
    smooth = facets.facing(d, flat(normal), 1.0)
    while True:
        azimuth = rng.unit_circle(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        numbers = Numbers(rng.uniform(state), 0.5, 0.0, rng.half_normal(state), azimuth)
        facet = facets.rough(d, smooth, 0.5 * facetness, numbers, False, rule)
        if facet.accepted:
            return facet


@njit
def facet_struck_by_lane(words, d, normal, sigma, rule):
    """Return the facet that a ray strikes on a surface, drawn as the lanes' `trial` does."""
    smooth = facets.facing(d, flat_by_lane(normal), single(1.0))
    while True:
        numbers = numbers_at(words, 0, True, True)
        facet = facets.rough(d, smooth, sigma, numbers, False, rule)
        if facet.accepted:
            return facet


@njit
def facet_normal_of(d, facet):
    """Return a facet's normal on the side of the ray, as `surface.outcome` takes it."""
    normal = surface.facet_normal(d, facet.normal, facet.cos_i, facet.tilt, facet.azimuth)
    sign = -1.0 if facet.back_side else 1.0
    return Vector(sign * normal.x, sign * normal.y, sign * normal.z)


@njit
def tried(state, d, interface_state, normal, facetness, media, rules):
    """Return what a trial at a surface leads to."""
    return trial(state, d, interface_state, flat(normal), 0.5 * facetness, media, rules)


@njit
def tried_by_lane(words, d, interface_state, normal, sigma, media, rules):
    """Return what a trial at a surface leads to, drawn as the lanes' `trial` does."""
    numbers = numbers_at(words, 0, True, True)
    facet = facets.facing(d, flat_by_lane(normal), interface_state.side)
    if sigma > single(0.0):
        facet = facets.rough(d, facet, sigma, numbers, interface_state.in_lobe, rules.facet_sampling)
    mirrored = rules.wrong_side != LOBE
    return surface.outcome(d, interface_state, facet, media, numbers.u_fresnel, mirrored, EVERYTHING)


@njit
def interact(state, d, normal, facetness, near, far, rules):
    """Return what becomes of a ray at a surface whose normal is against it."""
    stand = Stand(0.0, 1.0, False, False)
    media = surface.contrast(near, far)
    while True:
        after = tried(state, d, stand, normal, facetness, media, rules)
        if after.accepted:
            return Crossing(after.transmitted, after.direction)
        stand = Stand(0.0, 1.0, after.needs_lobe, after.transmitted)


@njit
def interact_by_lane(words, d, normal, sigma, near, far, rules):
    """Return what becomes of a ray at a surface, by the numbers of a lane."""
    zero, one = single(0.0), single(1.0)
    stand = Stand(zero, one, False, False)
    media = surface.contrast(near, far)
    while True:
        after = tried_by_lane(words, d, stand, normal, sigma, media, rules)
        if after.accepted:
            return Crossing(after.transmitted, after.direction)
        stand = Stand(zero, one, after.needs_lobe, after.transmitted)
