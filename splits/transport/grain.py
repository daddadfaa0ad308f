"""The random walk of a ray through one grain.

SPLITS section 4.3.4 and SPLITSnow section 3.3: at each meeting with the surface a microfacet is
drawn, Fresnel's reflectance decides between reflection and refraction, and inside the grain the
walk goes from wall to wall until the ray leaves or is absorbed.
"""

from __future__ import annotations

import math

from numba import njit

from splits.transport.facets import struck_facet
from splits.transport.frames import cosine_lobe, mirrored
from splits.transport.fresnel import interface, refracted
from splits.transport.rng import uniform
from splits.transport.scene import DRY_PORE, LOBE, WET_PORE
from splits.transport.spheroid import chord, normal_at


@njit(cache=True)
def onto_side(state, dx, dy, dz, nx, ny, nz, wrong_side):
    """Return d if d·n > 0, and otherwise what stands for multiple scattering between facets.

    SPLITS 4.3.4: a cosine lobe around n.  The alternative mirrors d in the surface.
    """
    out = dx * nx + dy * ny + dz * nz
    if out > 0.0:
        return dx, dy, dz
    if wrong_side == LOBE or out == 0.0:
        return cosine_lobe(state, nx, ny, nz)
    return mirrored(dx, dy, dz, nx, ny, nz)


@njit(cache=True)
def interact(state, dx, dy, dz, nx, ny, nz, facetness, n1, n2, k2, rules):
    """Reflect or refract a ray along d at a surface whose normal n faces it (d·n < 0).

    Returns
    -------
    passed : bool
        Whether the ray goes on behind the surface.
    d : 3 float
        New direction, on the side that `passed` names.
    """
    mx, my, mz, cos_i = struck_facet(state, dx, dy, dz, nx, ny, nz, facetness, rules.facets)
    reflectance, ratio, cos_t = interface(n1, n2, k2, cos_i)
    if reflectance > 0.0 and uniform(state) < reflectance:
        dx, dy, dz = mirrored(dx, dy, dz, mx, my, mz)
        dx, dy, dz = onto_side(state, dx, dy, dz, nx, ny, nz, rules.wrong_side)
        return False, dx, dy, dz
    dx, dy, dz = refracted(dx, dy, dz, mx, my, mz, cos_i, ratio, cos_t)
    dx, dy, dz = onto_side(state, dx, dy, dz, -nx, -ny, -nz, rules.wrong_side)
    return True, dx, dy, dz


@njit(cache=True)
def draw_pore(state, saturation):
    """Return the material of the pore space for the next leg (SPLITS 4.3.2)."""
    if saturation > 0.0 and uniform(state) < saturation:
        return WET_PORE
    return DRY_PORE


@njit(cache=True)
def grain_walk(
    state, p1, p2, p3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
    semi_major, sphericity, facetness, material, pore, saturation, optics, rules, length,
):  # fmt: skip
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    p, d, w, n : 3 float each
        Entry point relative to the centre, ray direction, major axis, outward normal at p.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.

    Returns
    -------
    alive : bool
        False when the ray was absorbed (analog runs only).
    p, d : 3 float each
        Exit point relative to the centre and direction of exit.
    pore : int
        Material of the pore space for the next leg.
    """
    semi_minor = semi_major * sphericity * sphericity
    minor2 = 1.0 / (semi_minor * semi_minor)
    shift = 1.0 / (semi_major * semi_major) - minor2
    index = optics.n[material]
    inside, dx, dy, dz = interact(
        state, dx, dy, dz, n1, n2, n3, facetness,
        optics.n[pore], index, optics.k[material], rules,
    )  # fmt: skip
    if not inside:
        # SPLITSnow 3.3: reflected into a newly chosen interstitial medium.
        return True, p1, p2, p3, dx, dy, dz, draw_pore(state, saturation)
    while True:
        leg = chord(p1, p2, p3, dx, dy, dz, w1, w2, w3, minor2, shift)
        length[material] += leg
        if rules.analog and uniform(state) > math.exp(-optics.absorption[material] * leg):
            return False, p1, p2, p3, dx, dy, dz, pore
        p1 += leg * dx
        p2 += leg * dy
        p3 += leg * dz
        n1, n2, n3 = normal_at(p1, p2, p3, w1, w2, w3, minor2, shift)
        pore = draw_pore(state, saturation)
        outside, dx, dy, dz = interact(
            state, dx, dy, dz, -n1, -n2, -n3, facetness,
            index, optics.n[pore], optics.k[pore], rules,
        )  # fmt: skip
        if outside:
            return True, p1, p2, p3, dx, dy, dz, pore
