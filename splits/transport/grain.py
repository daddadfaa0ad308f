"""The random walk of a ray through one grain.

SPLITS section 4.3.4 and SPLITSnow section 3.3: at each meeting with the surface a microfacet is
drawn, Fresnel's reflectance decides between reflection and refraction, and inside the grain the
walk goes from wall to wall until the ray leaves or is absorbed.
"""

from __future__ import annotations

from splits.transport.absorption import survives
from splits.transport.facets import struck_facet
from splits.transport.frames import cosine_lobe, mirrored
from splits.transport.fresnel import between, refracted
from splits.transport.jit import kernel
from splits.transport.rng import uniform
from splits.transport.scene import DRY_PORE, LOBE, WET_PORE
from splits.transport.spheroid import chord, normal_at


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
    mx, my, mz, cos_i = struck_facet(state, dx, dy, dz, nx, ny, nz, facetness, rules.facets)
    reflectance, ratio, cos_t = between(n1, k1, n2, k2, cos_i)
    if reflectance > 0.0 and uniform(state) < reflectance:
        dx, dy, dz = mirrored(dx, dy, dz, mx, my, mz)
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
    state, p1, p2, p3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
    semi_major, sphericity, facetness, kind, pore, saturation,
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
    p, d, w, n : 3 float each
        Entry point relative to the centre, ray direction, major axis, outward normal at p.
    kind : int
        Particle type.
    pore : int
        Material of the pore space that the ray comes from.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.
    purse : float64[3]
        See `splits.transport.absorption`; advanced in place.

    Returns
    -------
    alive : bool
        False when the ray was absorbed.
    p, d : 3 float each
        Exit point relative to the centre and direction of exit.
    pore : int
        Material of the pore space for the next leg.
    """
    semi_minor = semi_major * sphericity * sphericity
    minor2 = 1.0 / (semi_minor * semi_minor)
    shift = 1.0 / (semi_major * semi_major) - minor2
    core = grains.layers[kind]
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
            return True, p1, p2, p3, dx, dy, dz, pore
        if layer == core:
            leg = chord(p1, p2, p3, dx, dy, dz, w1, w2, w3, minor2, shift)
            p1 += leg * dx
            p2 += leg * dy
            p3 += leg * dz
            n1, n2, n3 = normal_at(p1, p2, p3, w1, w2, w3, minor2, shift)
            inward = False
        else:
            thickness = 2.0 * semi_major * grains.thickness[kind, layer - 1]
            leg = thickness / abs(dx * n1 + dy * n2 + dz * n3)
        if not survives(state, leg, here, optics, rules, length, purse):
            return False, p1, p2, p3, dx, dy, dz, pore
