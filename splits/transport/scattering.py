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
    sums : float64[3, orders, wavelengths]
        Over rays, with w the weight, Θ the angle of scattering and P_l the Legendre polynomial:
        Σ w P_l(cosΘ), Σ w² P_l(cosΘ) and Σ w² P_l(cosΘ)².
    shift : float64[4, wavelengths]
        Over rays, with δ the way from entry to exit point (m) and d, d' the directions before and
        after: Σ w δ·d, Σ w δ·d', Σ w δ·δ, and Σ w over rays that leave into a wet pore.
    """
    sums = np.zeros((3, orders, absorption.shape[0]))
    shift = np.zeros((4, absorption.shape[0]))
    polynomial = np.zeros(orders)
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
        after = g1 * dx + g2 * dy + g3 * dz
        square = g1 * g1 + g2 * g2 + g3 * g3
        # Rounding may carry the cosine past 1, which high orders would amplify.
        legendre(min(1.0, max(-1.0, dz)), polynomial)
        for i in range(absorption.shape[0]):
            depth = 0.0
            for material in range(absorption.shape[1]):
                depth += absorption[i, material] * length[material]
            w = purse[WEIGHT] * math.exp(-depth)
            for order in range(orders):
                wp = w * polynomial[order]
                sums[0, order, i] += wp
                sums[1, order, i] += w * wp
                sums[2, order, i] += wp * wp
            shift[0, i] += w * g3
            shift[1, i] += w * after
            shift[2, i] += w * square
            if pore == WET_PORE:
                shift[3, i] += w
    return sums, shift
