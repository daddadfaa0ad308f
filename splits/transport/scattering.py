"""One grain met in free pore space: how it deflects rays and what it absorbs, over many rays.

The grain is drawn and followed as in `granular.trace`, but alone: no boundary and no last leg can
reject it (SPLITS 4.3.3-4.3.4).
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.absorption import WEIGHT, start_purse
from splits.transport.grain import draw_pore, grain_walk
from splits.transport.jit import entry, kernel
from splits.transport.rng import from_table, pick, start_stream, uniform
from splits.transport.scene import WET_PORE
from splits.transport.spheroid import struck_point

PARTS = 16
"""Equal parts of all rays, from which errors of what theories make of them come: to 18 %."""


@kernel
def meet(state, grains, rules):
    """Draw the grain that a ray along +z strikes; all this file knows of how grains are drawn.

    Returns
    -------
    kind, minor, flattening, facetness : int, float, float, float
        Particle type, semi-minor axis (m), flattening and facetness.
    q, w, n : 3 float each
        Entry point, major axis, outward normal, see `splits.transport.spheroid`.
    """
    kind = 0
    if grains.share.size > 1:
        kind = pick(grains.share, uniform(state))
    curvature = from_table(grains.curvature, kind, uniform(state))
    sphericity = from_table(grains.sphericity, kind, uniform(state))
    ratio = sphericity * sphericity
    flattening = 1.0 - ratio
    q1, q2, q3, w1, w2, w3, n1, n2, n3 = struck_point(state, 0.0, 0.0, 1.0, flattening, rules.entry)
    facetness = from_table(grains.facetness, kind, uniform(state))
    return kind, ratio / curvature, flattening, facetness, q1, q2, q3, w1, w2, w3, n1, n2, n3


@kernel
def legendre(x, values):
    """Set `values` (float64[orders]) to the Legendre polynomials P_0(x), P_1(x) and so on."""
    values[0] = 1.0
    if values.size > 1:
        values[1] = x
    for order in range(2, values.size):
        values[order] = (
            (2 * order - 1) * x * values[order - 1] - (order - 1) * values[order - 2]
        ) / order


@entry
def scatter(
    seed, ensemble, first_ray, rays, orders, wet, saturation, grains, rules, optics, absorption
):  # fmt: skip
    """Let `rays` rays meet one grain each and tally their directions by weight.

    Parameters
    ----------
    seed, ensemble, first_ray : int
        Name the random streams, as in `granular.batch`.
    rays, orders : int
        Rays to trace; Legendre polynomials to tally.
    wet, saturation : float
        Probability that a ray comes through a wet pore, and that a pore drawn at the grain is wet.
    grains, rules, optics
        See `splits.transport.scene`; `optics.absorption` bounds `absorption` from below.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m) that turn path lengths in the grain into weights.

    Returns
    -------
    sums : float64[3, orders + 4, wavelengths]
        Over rays, with w the weight: Σ w x, Σ w² x and Σ w² x², where x are first the Legendre
        polynomials P_l(cosΘ) of the angle of scattering Θ; then, with δ the way from entry to exit
        point (m) and d, d' the directions before and after, δ·d, δ·d' and δ·δ; and at last 1 if
        the ray leaves into a wet pore, or 0.
    parts : float64[PARTS, orders + 4, wavelengths]
        Σ w x over every so many rays.
    """
    sums = np.zeros((3, orders + 4, absorption.shape[0]))
    parts = np.zeros((PARTS, orders + 4, absorption.shape[0]))
    told = np.zeros(orders + 4)
    length = np.zeros(absorption.shape[1])
    purse = np.zeros(3)
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(first_ray, first_ray + rays):
        start_stream(state, seed, ensemble, ray)
        length[:] = 0.0
        start_purse(purse)
        pore = draw_pore(state, wet)
        kind, minor, flattening, facetness, q1, q2, q3, w1, w2, w3, n1, n2, n3 = meet(
            state, grains, rules
        )
        alive, g1, g2, g3, dx, dy, dz, pore = grain_walk(
            state, q1, q2, q3, 0.0, 0.0, 1.0, w1, w2, w3, n1, n2, n3,
            minor, flattening, facetness, kind, pore, saturation,
            grains, optics, rules, length, purse,
        )  # fmt: skip
        if not alive:
            continue
        # Rounding may carry the cosine past 1, which high orders would amplify.
        legendre(min(1.0, max(-1.0, dz)), told[:orders])
        told[orders] = g3
        told[orders + 1] = g1 * dx + g2 * dy + g3 * dz
        told[orders + 2] = g1 * g1 + g2 * g2 + g3 * g3
        told[orders + 3] = 1.0 if pore == WET_PORE else 0.0
        part = parts[ray % PARTS]
        for i in range(absorption.shape[0]):
            depth = 0.0
            for material in range(absorption.shape[1]):
                depth += absorption[i, material] * length[material]
            w = purse[WEIGHT] * math.exp(-depth)
            for j in range(told.size):
                wx = w * told[j]
                sums[0, j, i] += wx
                sums[1, j, i] += w * wx
                sums[2, j, i] += wx * wx
                part[j, i] += wx
    return sums, parts
