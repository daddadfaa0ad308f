"""The random walk of a ray through one grain.

SPLITS section 4.3.4 and SPLITSnow section 3.3: at each meeting with the surface a microfacet is
drawn, Fresnel's reflectance decides between reflection and refraction, and inside the grain the
walk goes from wall to wall until the ray leaves or is absorbed.
"""

from __future__ import annotations

from oracle.absorption import survives
from oracle.facets import struck_facet
from oracle.frames import cosine_lobe, mirrored, normalized
from oracle.fresnel import between, refracted
from oracle.jit import kernel
from oracle.rng import uniform
from oracle.scene import DRY_PORE, LOBE, WET_PORE
from oracle.spheroid import across, normal_at


@kernel
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


@kernel
def interact(state, dx, dy, dz, nx, ny, nz, facetness, n1, k1, n2, k2, rules):
    """Reflect or refract a ray along d at a surface whose normal n faces it (d·n < 0).

    Parameters
    ----------
    n1, k1, n2, k2 : float
        Complex refractive indices on the ray's side and behind the surface.

    Returns
    -------
    passed : bool
        Whether the ray goes on behind the surface.
    d : 3 float
        New direction, on the side that `passed` names.
    """
    mx, my, mz, cos_i = struck_facet(state, dx, dy, dz, nx, ny, nz, facetness, rules.facet_sampling)
    reflectance, ratio, cos_t = between(n1, k1, n2, k2, cos_i)
    if reflectance > 0.0 and uniform(state) < reflectance:
        dx, dy, dz = mirrored(dx, dy, dz, mx, my, mz)
        # Reflection keeps the length only up to rounding, which adds up in long walks.
        dx, dy, dz = normalized(dx, dy, dz)
        dx, dy, dz = onto_side(state, dx, dy, dz, nx, ny, nz, rules.wrong_side)
        return False, dx, dy, dz
    dx, dy, dz = refracted(dx, dy, dz, mx, my, mz, cos_i, ratio, cos_t)
    dx, dy, dz = onto_side(state, dx, dy, dz, -nx, -ny, -nz, rules.wrong_side)
    return True, dx, dy, dz


@kernel
def draw_pore(state, saturation):
    """Return the material of the pore space for the next leg (SPLITS 4.3.2)."""
    if saturation > 0.0 and uniform(state) < saturation:
        return WET_PORE
    return DRY_PORE


@kernel
def grain_walk(
    state, q1, q2, q3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
    minor, flattening, facetness, kind, pore, saturation,
    grains, optics, rules, length, purse,
):  # fmt: skip
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    The layers of the grain are numbered from 0, the pore space, over the coatings inwards to
    the core.  A coating is so thin that it acts where the ray meets it as a flat slab: a leg
    through it is h/|n·d| long and leaves the point on the grain unchanged (SPLITS 4.2.3, 4.3.4).
    The pore is drawn anew whenever a ray reaches the outermost interface from the inside
    (SPLITS 4.3.2) and when it is reflected there from the outside (SPLITSnow 3.3).

    Parameters
    ----------
    q, d, w, n : 3 float each
        Entry point on the unit sphere (see `spheroid.py` in the package), ray direction, major
        axis, outward normal.
    minor, flattening, facetness : float
        Semi-minor axis (m), flattening and facetness of the grain.
    kind : int
        Particle type.
    pore : int
        Material of the pore space that the ray comes from.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.
    purse : float64[3]
        See `splits.kernels.absorption`; advanced in place.

    Returns
    -------
    alive : bool
        False when the ray was absorbed.
    g : 3 float
        Way from the entry to the exit point (m).
    d : 3 float
        Direction of exit.
    pore : int
        Material of the pore space for the next leg.
    """
    core = grains.layers[kind]
    major = minor / (1.0 - flattening)
    g1, g2, g3 = 0.0, 0.0, 0.0
    layer = 0
    inward = True
    here = pore
    while True:
        if inward:
            step = 1
            there = grains.material[kind, layer]
        else:
            step = -1
            if layer == 1:
                pore = draw_pore(state, saturation)
                there = pore
            else:
                there = grains.material[kind, layer - 2]
        passed, dx, dy, dz = interact(
            state, dx, dy, dz, step * n1, step * n2, step * n3, facetness,
            optics.n[here], optics.k[here], optics.n[there], optics.k[there], rules,
        )  # fmt: skip
        if passed:
            layer += step
            here = there
        else:
            inward = not inward
        if layer == 0:
            if not passed:
                pore = draw_pore(state, saturation)
            return True, g1, g2, g3, dx, dy, dz, pore
        if layer == core:
            leg, q1, q2, q3 = across(q1, q2, q3, dx, dy, dz, w1, w2, w3, flattening)
            leg *= minor
            g1 += leg * dx
            g2 += leg * dy
            g3 += leg * dz
            n1, n2, n3 = normal_at(q1, q2, q3, w1, w2, w3, flattening)
            inward = False
        else:
            leg = 2.0 * major * grains.thickness[kind, layer - 1] / abs(dx * n1 + dy * n2 + dz * n3)
        if not survives(state, leg, here, optics, rules, length, purse):
            return False, g1, g2, g3, dx, dy, dz, pore
