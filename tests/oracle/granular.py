"""A slab of grains generated on the fly: the path of a ray and the tally of many.

SPLITS section 4.3 and SPLITSnow section 3.1: only the grain that the ray meets exists.  Distance,
type, size, shape, orientation and entry point are drawn; a grain that crosses a boundary or
lies on the leg just travelled is drawn again; between its two extended
boundaries the slab reaches to infinity sideways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from oracle.absorption import DEPTH, WEIGHT, start_purse, survives
from oracle.fresnel import interface, refracted
from oracle.grain import draw_pore, grain_walk
from oracle.jit import entry, kernel
from oracle.rng import from_table, pick, start_stream, uniform, unit_circle
from oracle.scene import DRY_PORE, KEPT, SKIPPED, WET_PORE
from oracle.spheroid import (
    PROJECTED,
    axial_position,
    crosses,
    cuts_segment,
    entry_point,
)
from oracle.tally import EXIT_LENGTH, record

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain was found that fits; never expected, counted so that it cannot pass unseen."""
TRAVELS = 4

MAX_REJECTIONS = 10_000_000
"""Grains refused in a row from which a ray counts as lost.  At grazing incidence the first grain
that fits below the boundary is rare: 3e5 are refused on average at 89.9999 degrees."""

NO_LEG = (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, -1.0)
"""In place of the leg travelled last, for a ray that has not travelled yet."""


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


class Window(NamedTuple):
    """Bounds on what a ray is worth, weight · exp(κ·depth) (see `splits.kernels.grains.splitting`).

    Attributes
    ----------
    weight : float
        Of the ray, absorption not counted.
    kappa : float
        1/m.
    lower, upper : float
    depth : float
        Of the slab (m).
    profile : float64[2, slices]
        For equal slices of the depth, number and total weight of the legs that began there,
        advanced in place.
    """

    weight: float
    kappa: float
    lower: float
    upper: float
    depth: float
    profile: np.ndarray


@kernel
def left_window(window, z, purse):
    """Tell whether a ray's worth lies outside its window, and note where it is."""
    slices = window.profile.shape[1]
    place = min(int(-z / window.depth * slices), slices - 1)
    window.profile[0, place] += 1.0
    window.profile[1, place] += window.weight * math.exp(-purse[DEPTH])
    worth = window.weight * math.exp(-purse[DEPTH] - window.kappa * z)
    return worth < window.lower or worth > window.upper


@kernel
def no_grain(leg):
    """Return what `next_grain` returns when there is none."""
    return leg, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@kernel
def next_grain(state, z, dx, dy, dz, to_boundary, last_leg, grains, slab, rules):
    """Draw the next grain on a ray, or find that the ray reaches a boundary first.

    SPLITS 4.3.3: distance from Eq 21 (SPLITSnow Eq 1), then size, shape and entry point; a grain
    that crosses an extended boundary or lies on the last leg is replaced by a new draw, distance
    included, from the same origin.  Skipping such grains instead, which is not in the papers, thins
    the Poisson process of grains along the ray.

    Parameters
    ----------
    z : float
        Height of the ray's origin (m).
    dx, dy, dz : float
        Direction of the ray.
    to_boundary : float
        Distance to the extended boundary ahead (m), or infinity.
    last_leg : 7 float
        Way from the end of the leg just travelled to the origin of this one, direction and length
        of that leg; length −1 when there is none.

    Returns
    -------
    leg : float
        Distance to the grain; `to_boundary` when no grain comes first; −1 when none ever fits.
    kind, minor, flattening : int, float, float
    q, w, n : 3 float each
        Entry point, major axis, outward normal, see `splits.kernels.grains.spheroid`.
    """
    g1, g2, g3, lx, ly, lz, last = last_leg
    skipped = 0.0
    for _ in range(MAX_REJECTIONS):
        leg = skipped - math.log(uniform(state)) / grains.attenuation
        if leg >= to_boundary:
            return no_grain(to_boundary)
        kind = 0
        if grains.share.size > 1:
            kind = pick(grains.share, uniform(state))
        curvature = from_table(grains.curvature, kind, uniform(state))
        sphericity = from_table(grains.sphericity, kind, uniform(state))
        ratio = sphericity * sphericity
        flattening = 1.0 - ratio
        major = 1.0 / curvature
        minor = ratio * major
        axial = axial_position(state, flattening)
        facing = uniform(state)
        if rules.entry_sampling == PROJECTED:
            facing = math.sqrt(facing)
        ca, sa = unit_circle(state)
        ct, st = unit_circle(state)
        q1, q2, q3, w1, w2, w3, n1, n2, n3 = entry_point(
            dx, dy, dz, facing, ca, sa, axial, ct, st, flattening
        )
        if rules.boundary_overlap != KEPT and crosses(
            z + leg * dz, q3, w3, axial, minor, major, slab.depth
        ):
            if rules.boundary_overlap == SKIPPED:
                skipped = leg
            continue
        if rules.segment_overlap != KEPT and last > 0.0 and cuts_segment(
            q1, q2, q3, w1, w2, w3, minor, flattening,
            -g1 - leg * dx, -g2 - leg * dy, -g3 - leg * dz, lx, ly, lz, last,
        ):  # fmt: skip
            if rules.segment_overlap == SKIPPED:
                skipped = leg
            continue
        return leg, kind, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3
    return no_grain(-1.0)


@kernel
def launch(state, slab, rules, optics):
    """Start a ray at the slab's top.

    Returns
    -------
    fate : int
        `TRAVELS`, or `REFLECTED` by the boundary of a wet pore.
    d : 3 float
        Direction.
    pore : int
        Material of the pore space that the ray enters.
    """
    mu = math.sqrt(uniform(state)) if slab.diffuse else slab.cos_incidence
    dx, dy, dz = math.sqrt(max(0.0, 1.0 - mu * mu)), 0.0, -mu
    pore = draw_pore(state, slab.saturation)
    if pore == WET_PORE and rules.boundary_fresnel:
        passed, dx, dy, dz = cross_boundary(
            state, dx, dy, dz, optics.n[DRY_PORE], optics.n[pore], optics.k[pore]
        )
        if not passed:
            return REFLECTED, dx, dy, dz, pore
    return TRAVELS, dx, dy, dz, pore


@kernel
def follow(
    state, x, y, z, dx, dy, dz, last_leg, pore,
    grains, slab, rules, optics, length, purse, window, most,
):  # fmt: skip
    """Follow a ray until it leaves the slab or is absorbed, or until its worth wants a decision.

    Parameters
    ----------
    state, grains, slab, rules, optics
        See `trace`.
    x, y, z, dx, dy, dz : float
        Origin and direction.
    last_leg : 7 float
        See `next_grain`.
    pore : int
        Material of the leg to come.
    length, purse : float64[materials], float64[3]
        Advanced in place.
    window : Window or None
        None asks for no decisions, at no cost.
    most : int
        Grains met after which a ray counts as absorbed.

    Returns
    -------
    fate : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `LOST`, or `TRAVELS` where the window is left.
    x, y, z, dx, dy, dz, last_leg, pore
        Where the ray then is.
    legs, order : int
        Legs through the pore space and grains met.
    """
    g1, g2, g3, lx, ly, lz, last = last_leg
    legs = 0
    order = 0
    while True:
        legs += 1
        to_boundary = math.inf
        if dz > 0.0:
            to_boundary = -z / dz
        elif dz < 0.0:
            to_boundary = (-slab.depth - z) / dz
        last_leg = (g1, g2, g3, lx, ly, lz, last)
        leg, kind, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3 = next_grain(
            state, z, dx, dy, dz, to_boundary, last_leg, grains, slab, rules
        )
        if leg < 0.0:
            return LOST, x, y, z, dx, dy, dz, last_leg, pore, legs, order
        met_boundary = leg >= to_boundary
        if met_boundary:
            leg = to_boundary
        if not survives(state, leg, pore, optics, rules, length, purse):
            return ABSORBED, x, y, z, dx, dy, dz, last_leg, pore, legs, order
        lx, ly, lz, last = dx, dy, dz, leg
        x += leg * dx
        y += leg * dy
        z += leg * dz
        if met_boundary:
            z = 0.0 if dz > 0.0 else -slab.depth
            g1, g2, g3 = 0.0, 0.0, 0.0
            passed = True
            if pore == WET_PORE and rules.boundary_fresnel:
                passed, dx, dy, dz = cross_boundary(
                    state, dx, dy, dz, optics.n[pore], optics.n[DRY_PORE], 0.0
                )
            if passed:
                fate = REFLECTED if dz > 0.0 else TRANSMITTED
                return fate, x, y, z, dx, dy, dz, last_leg, pore, legs, order
            continue
        if order == most:
            return ABSORBED, x, y, z, dx, dy, dz, last_leg, pore, legs, order
        order += 1
        facetness = from_table(grains.facetness, kind, uniform(state))
        alive, g1, g2, g3, dx, dy, dz, pore = grain_walk(
            state, q1, q2, q3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
            minor, flattening, facetness, kind, pore, slab.saturation,
            grains, optics, rules, length, purse,
        )  # fmt: skip
        if not alive:
            return ABSORBED, x, y, z, dx, dy, dz, last_leg, pore, legs, order
        # Only a grain kept across a boundary, or rounding, ends a walk out there: the ray counts
        # as standing on that boundary.
        z = min(max(z + g3, -slab.depth), 0.0)
        x += g1
        y += g2
        if window is not None and left_window(window, z, purse):
            last_leg = (g1, g2, g3, lx, ly, lz, last)
            return TRAVELS, x, y, z, dx, dy, dz, last_leg, pore, legs, order


@kernel
def trace(state, grains, slab, rules, optics, length, purse, most):
    """Follow one ray from the light source until it leaves the slab or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    grains, slab, rules, optics
        See `splits.kernels.grains.scene`.
    length : float64[materials]
        Set to the path length in each material (m).
    purse : float64[3]
        Set to the roulette's account, see `splits.kernels.absorption`.
    most : int
        Grains met after which the ray counts as absorbed, or `UNLIMITED`.

    Returns
    -------
    fate : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED` or `LOST`.
    x, y, z, dx, dy, dz : float
        Point and direction of exit, the latter outside the slab.
    legs : int
        Legs through the pore space: what the ray cost.
    order : int
        Grains met.
    """
    length[:] = 0.0
    start_purse(purse)
    fate, dx, dy, dz, pore = launch(state, slab, rules, optics)
    if fate != TRAVELS:
        return fate, 0.0, 0.0, 0.0, dx, dy, dz, 0, 0
    fate, x, y, z, dx, dy, dz, _, _, legs, order = follow(
        state, 0.0, 0.0, 0.0, dx, dy, dz, NO_LEG, pore,
        grains, slab, rules, optics, length, purse, None, most,
    )  # fmt: skip
    return fate, x, y, z, dx, dy, dz, legs, order


@entry
def batch(seed, work, grains, slab, rules, optics, exits):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed : int
    work : int64[4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same whoever traces it.
    grains, slab, rules, optics
        See `splits.kernels.grains.scene`.
    exits : float64[rays, columns]
        A row for each ray, see `splits.kernels.tallies.exits`; must come from `exit_rows`.

    Returns
    -------
    legs : int
        Legs traced.
    lost : bool
        Whether a ray found no grain that fits; the batch then ends early.
    """
    legs = 0
    materials = optics.n.size
    length = np.zeros(materials)
    purse = np.zeros(3)
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(work[2]):
        start_stream(state, seed, work[0], work[1] + ray)
        fate, x, y, _, dx, dy, dz, spent, order = trace(
            state, grains, slab, rules, optics, length, purse, work[3]
        )
        legs += spent
        if fate == LOST:
            return legs, True
        if fate == ABSORBED:
            continue
        record(exits[ray], fate == REFLECTED, x, y, dx, dy, dz, purse[WEIGHT], order)
        exits[ray, EXIT_LENGTH : EXIT_LENGTH + materials] = length
    return legs, False
