"""The path of a ray through one grain.

SPLITS section 4.3.4 and SPLITSnow section 3.3: at each hit of the surface a microfacet is sampled,
reflection or refraction is sampled with Fresnel's reflectance, and inside the grain the ray crosses
chords until it leaves or is absorbed.
"""

from oracle.absorption import attenuate_segment
from oracle.facets import sample_facet
from oracle.frames import mirror, normalized, sample_cosine_lobe
from oracle.fresnel import compute_media_interface, refract
from oracle.jit import kernel
from oracle.rng import uniform
from oracle.scene import DRY_PORE, LOBE, WET_PORE
from oracle.spheroid import compute_chord, compute_outward_normal


@kernel
def redirect_to_side(state, dx, dy, dz, nx, ny, nz, wrong_side):
    """Return d if d·n > 0, and otherwise a direction that models scattering between facets.

    SPLITS 4.3.4: a cosine lobe around n.  The alternative mirrors d in the surface.
    """
    out = dx * nx + dy * ny + dz * nz
    if out > 0.0:
        return dx, dy, dz
    if wrong_side == LOBE or out == 0.0:
        return sample_cosine_lobe(state, nx, ny, nz)
    return mirror(dx, dy, dz, nx, ny, nz)


@kernel
def reflect_or_refract(state, dx, dy, dz, nx, ny, nz, facetness, n1, k1, n2, k2, rules):
    """Reflect or refract a ray along d at a surface whose normal n faces it (d·n < 0).

    Parameters
    ----------
    n1, k1, n2, k2 : float
        Complex refractive indices on the ray's side and behind the surface.

    Returns
    -------
    passed : bool
        Whether the ray is transmitted.
    d : 3 float
        New direction, on the side given by `passed`.
    """
    mx, my, mz, cos_i = sample_facet(state, dx, dy, dz, nx, ny, nz, facetness, rules.facet_sampling)
    reflectance, ratio, cos_t = compute_media_interface(n1, k1, n2, k2, cos_i)
    if reflectance > 0.0 and uniform(state) < reflectance:
        dx, dy, dz = mirror(dx, dy, dz, mx, my, mz)
        # Reflection keeps unit length only up to rounding, which accumulates on long paths.
        dx, dy, dz = normalized(dx, dy, dz)
        dx, dy, dz = redirect_to_side(state, dx, dy, dz, nx, ny, nz, rules.wrong_side)
        return False, dx, dy, dz
    dx, dy, dz = refract(dx, dy, dz, mx, my, mz, cos_i, ratio, cos_t)
    dx, dy, dz = redirect_to_side(state, dx, dy, dz, -nx, -ny, -nz, rules.wrong_side)
    return True, dx, dy, dz


@kernel
def sample_pore(state, saturation):
    """Sample the material of the pore space for the next segment (SPLITS 4.3.2)."""
    if saturation > 0.0 and uniform(state) < saturation:
        return WET_PORE
    return DRY_PORE


@kernel
def trace_through_grain(
    state, q1, q2, q3, dx, dy, dz, w1, w2, w3, n1, n2, n3,
    minor, flattening, facetness, kind, pore, saturation,
    grains, optics, rules, path_lengths, roulette_state,
):  # fmt: skip
    """Trace a ray from its entry point on a grain until it is back in the pore space.

    The layers of the grain are numbered from 0, the pore space, through the coatings to the core.
    A coating is thin, and is treated locally as a plane slab: a segment through it is h/|n·d| long
    and does not move the point on the grain (SPLITS 4.2.3, 4.3.4).  The pore is sampled again when
    a ray reaches the outermost interface from the inside (SPLITS 4.3.2) and when it is reflected
    there from the outside (SPLITSnow 3.3).

    Parameters
    ----------
    q, d, w, n : 3 float each
        Entry point on the unit sphere (see `oracle.spheroid`), ray direction, major axis,
        outward normal.
    minor, flattening, facetness : float
        Semi-minor axis (m), flattening and facetness of the grain.
    kind : int
        Particle type.
    pore : int
        Material of the pore space from which the ray enters.
    path_lengths : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.
    roulette_state : float64[3]
        See `oracle.absorption`; advanced in place.

    Returns
    -------
    alive : bool
        False when the ray was absorbed.
    g : 3 float
        Vector from the entry point to the exit point (m).
    d : 3 float
        Direction of exit.
    pore : int
        Material of the pore space for the next segment.
    """
    core = grains.layers[kind]
    major = minor / (1.0 - flattening)
    g1, g2, g3 = 0.0, 0.0, 0.0
    layer = 0
    inward = True
    near = pore
    while True:
        if inward:
            step = 1
            far = grains.material[kind, layer]
        else:
            step = -1
            if layer == 1:
                pore = sample_pore(state, saturation)
                far = pore
            else:
                far = grains.material[kind, layer - 2]
        passed, dx, dy, dz = reflect_or_refract(
            state, dx, dy, dz, step * n1, step * n2, step * n3, facetness,
            optics.n[near], optics.k[near], optics.n[far], optics.k[far], rules,
        )  # fmt: skip
        if passed:
            layer += step
            near = far
        else:
            inward = not inward
        if layer == 0:
            if not passed:
                pore = sample_pore(state, saturation)
            return True, g1, g2, g3, dx, dy, dz, pore
        if layer == core:
            distance, q1, q2, q3 = compute_chord(q1, q2, q3, dx, dy, dz, w1, w2, w3, flattening)
            distance *= minor
            g1 += distance * dx
            g2 += distance * dy
            g3 += distance * dz
            n1, n2, n3 = compute_outward_normal(q1, q2, q3, w1, w2, w3, flattening)
            inward = False
        else:
            distance = (
                2.0 * major * grains.thickness[kind, layer - 1] / abs(dx * n1 + dy * n2 + dz * n3)
            )
        if not attenuate_segment(
            state, distance, near, optics, rules, path_lengths, roulette_state
        ):
            return False, g1, g2, g3, dx, dy, dz, pore
