"""A slab of grains generated on the fly: the path of a ray and the tally of many.

SPLITS section 4.3 and SPLITSnow section 3.1: only the grain that the ray meets exists.  Distance,
type, size, shape, orientation and entry point are drawn; a grain that crosses a boundary or
lies on the leg just travelled is drawn again from the same origin; between its two extended
boundaries the slab reaches to infinity sideways.
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.absorption import WEIGHT, start_purse, survives
from splits.transport.fresnel import interface, refracted
from splits.transport.grain import draw_pore, grain_walk
from splits.transport.jit import entry, kernel
from splits.transport.rng import from_table, start_stream, uniform
from splits.transport.scene import DRY_PORE, WET_PORE
from splits.transport.spheroid import cuts_segment, half_height, struck_point

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain was found that fits; never expected, counted so that it cannot pass unseen."""

MAX_REJECTIONS = 1_000_000


@kernel
def pick(share, u):
    """Return the first type whose cumulative share exceeds u."""
    i = 0
    while u >= share[i] and i < share.size - 1:
        i += 1
    return i


@kernel
def cross_boundary(state, dx, dy, dz, n1, n2, k2):
    """Reflect or refract a ray at a smooth horizontal boundary from index n1 to n2 + i k2.

    Returns
    -------
    passed : bool
    d : 3 float
    """
    up = math.copysign(1.0, -dz)
    cos_i = max(abs(dz), 1e-12)
    reflectance, ratio, cos_t = interface(n1, n2, k2, cos_i)
    if uniform(state) < reflectance:
        return False, dx, dy, -dz
    dx, dy, dz = refracted(dx, dy, dz, 0.0, 0.0, up, cos_i, ratio, cos_t)
    return True, dx, dy, dz


@kernel
def no_grain(leg):
    """Return what `next_grain` returns when there is none."""
    return leg, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@kernel
def next_grain(state, x, y, z, dx, dy, dz, to_boundary, last_leg, grains, slab, rules):
    """Draw the next grain on a ray, or find that the ray reaches a boundary first.

    SPLITS 4.3.3: distance from Eq 21 (SPLITSnow Eq 1), then size, shape and entry point; a grain
    that crosses an extended boundary or lies on the last leg is replaced by a new draw, distance
    included, from the same origin.

    Parameters
    ----------
    x, y, z, dx, dy, dz : float
        Origin and direction of the ray.
    to_boundary : float
        Distance to the extended boundary ahead (m), or infinity.
    last_leg : 7 float
        Origin, direction and length of the leg just travelled; length −1 when there is none.

    Returns
    -------
    leg : float
        Distance to the grain; `to_boundary` when no grain comes first; −1 when none ever fits.
    kind, semi_major, sphericity : int, float, float
    c, p, w, n : 3 float each
        Centre, entry point relative to it, major axis, outward normal.
    """
    lx, ly, lz, ldx, ldy, ldz, last = last_leg
    for _ in range(MAX_REJECTIONS):
        leg = -math.log(uniform(state)) / grains.attenuation
        if leg >= to_boundary:
            return no_grain(to_boundary)
        kind = 0
        if grains.share.size > 1:
            kind = pick(grains.share, uniform(state))
        semi_major = 1.0 / from_table(grains.curvature, kind, uniform(state))
        sphericity = from_table(grains.sphericity, kind, uniform(state))
        p1, p2, p3, w1, w2, w3, n1, n2, n3 = struck_point(
            state, dx, dy, dz, semi_major, sphericity, rules.entry
        )
        semi_minor = semi_major * sphericity * sphericity
        cx = x + leg * dx - p1
        cy = y + leg * dy - p2
        cz = z + leg * dz - p3
        if rules.reject_across_boundary:
            h = half_height(w3, semi_major, semi_minor)
            if cz + h > 0.0 or cz - h < -slab.depth:
                continue
        if rules.reject_on_last_leg and last > 0.0:
            minor2 = 1.0 / (semi_minor * semi_minor)
            shift = 1.0 / (semi_major * semi_major) - minor2
            if cuts_segment(
                lx - cx, ly - cy, lz - cz, ldx, ldy, ldz, last, w1, w2, w3, minor2, shift
            ):
                continue
        return leg, kind, semi_major, sphericity, cx, cy, cz, p1, p2, p3, w1, w2, w3, n1, n2, n3
    return no_grain(-1.0)


@kernel
def trace(state, grains, slab, rules, optics, length, purse):
    """Follow one ray from the light source until it leaves the slab or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    grains, slab, rules, optics
        See `splits.transport.scene`.
    length : float64[materials]
        Set to the path length in each material (m).
    purse : float64[3]
        Set to the roulette's account, see `splits.transport.absorption`.

    Returns
    -------
    fate : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED` or `LOST`.
    x, y, z, dx, dy, dz : float
        Point and direction of exit, the latter outside the slab.
    legs : int
        Legs through the pore space: what the ray cost.
    """
    length[:] = 0.0
    start_purse(purse)
    legs = 0
    mu = math.sqrt(uniform(state)) if slab.diffuse else slab.cos_incidence
    x, y, z = 0.0, 0.0, 0.0
    dx, dy, dz = math.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, -mu
    pore = draw_pore(state, slab.saturation)
    if pore == WET_PORE and rules.boundary_fresnel:
        passed, dx, dy, dz = cross_boundary(
            state, dx, dy, dz, optics.n[DRY_PORE], optics.n[pore], optics.k[pore]
        )
        if not passed:
            return REFLECTED, x, y, z, dx, dy, dz, legs
    # The leg just travelled (origin, direction, length), on which no other grain can lie.
    last_leg = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
    while True:
        legs += 1
        to_boundary = math.inf
        if dz > 0.0:
            to_boundary = -z / dz
        elif dz < 0.0:
            to_boundary = (-slab.depth - z) / dz
        leg, kind, semi_major, sphericity, cx, cy, cz, p1, p2, p3, w1, w2, w3, n1, n2, n3 = (
            next_grain(state, x, y, z, dx, dy, dz, to_boundary, last_leg, grains, slab, rules)
        )
        if leg < 0.0:
            return LOST, x, y, z, dx, dy, dz, legs
        met_boundary = leg >= to_boundary
        if met_boundary:
            leg = to_boundary
        if not survives(state, leg, pore, optics, rules, length, purse):
            return ABSORBED, x, y, z, dx, dy, dz, legs
        last_leg = (x, y, z, dx, dy, dz, leg)
        if met_boundary:
            x += leg * dx
            y += leg * dy
            z = 0.0 if dz > 0.0 else -slab.depth
            passed = True
            if pore == WET_PORE and rules.boundary_fresnel:
                passed, dx, dy, dz = cross_boundary(
                    state, dx, dy, dz, optics.n[pore], optics.n[DRY_PORE], 0.0
                )
            if passed:
                fate = REFLECTED if dz > 0.0 else TRANSMITTED
                return fate, x, y, z, dx, dy, dz, legs
            continue
        facetness = from_table(grains.facetness, kind, uniform(state))
        alive, p1, p2, p3, dx, dy, dz, pore = grain_walk(
            state, p1, p2, p3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
            semi_major, sphericity, facetness, kind, pore, slab.saturation,
            grains, optics, rules, length, purse,
        )  # fmt: skip
        if not alive:
            return ABSORBED, x, y, z, dx, dy, dz, legs
        x = cx + p1
        y = cy + p2
        z = cz + p3
        if z > 0.0 or z < -slab.depth:
            # Only a grain kept across a boundary, or rounding, ends a walk out there: the
            # ray counts as standing on that boundary.
            z = 0.0 if z > 0.0 else -slab.depth


@entry
def batch(seed, ensemble, first_ray, rays, grains, slab, rules, optics, absorption):
    """Trace `rays` rays and tally their weights.

    Parameters
    ----------
    seed, ensemble, first_ray : int
        Name the random streams: ray i of an ensemble is the same whoever traces it.
    rays : int
    grains, slab, rules, optics
        See `splits.transport.scene`.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) that turn path lengths into weights, SPLITSnow
        Eqs 5-6 with the exponential read as the probability to pass.

    Returns
    -------
    moments : float64[2, 3, wavelengths]
        Over rays, [reflected, transmitted][Σ weight, Σ weight², largest weight].
    least : float64[wavelengths]
        Smallest weight with which any ray left; 0 once one was absorbed.
    legs : int
        Legs traced.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    moments = np.zeros((2, 3, absorption.shape[0]))
    least = np.full(absorption.shape[0], np.inf)
    legs = 0
    length = np.zeros(absorption.shape[1])
    purse = np.zeros(3)
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(first_ray, first_ray + rays):
        start_stream(state, seed, ensemble, ray)
        fate, _, _, _, _, _, _, spent = trace(state, grains, slab, rules, optics, length, purse)
        legs += spent
        if fate == LOST:
            return moments, least, legs, True
        if fate == ABSORBED:
            least[:] = 0.0
            continue
        side = 0 if fate == REFLECTED else 1
        for i in range(absorption.shape[0]):
            w = purse[WEIGHT]
            if not rules.analog:
                depth = 0.0
                for material in range(absorption.shape[1]):
                    depth += absorption[i, material] * length[material]
                w *= math.exp(-depth)
            moments[side, 0, i] += w
            moments[side, 1, i] += w * w
            moments[side, 2, i] = max(moments[side, 2, i], w)
            least[i] = min(least[i], w)
    return moments, least, legs, False
