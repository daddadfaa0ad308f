"""Interaction of polarized light with the surface of a grain.

The facet is that of the scalar interaction.  The Mueller matrices of Fresnel's equations apply to
it, with the plane of incidence on the facet as reference.  Whether light is reflected is sampled
with the reflectance of the polarized light.  A cosine lobe, which represents multiple scattering
between facets, depolarizes.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.features import ALL_FEATURES
from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.interaction import InteractionResult, reflect_or_refract
from splits.kernels.grains.microfacet import compute_facet_normal
from splits.kernels.math.vectors import dot, reflect, scale
from splits.kernels.optics.polarized_interface import (
    apply_mueller,
    compute_mueller,
    rotate_to_plane_of_incidence,
)
from splits.kernels.optics.stokes import Stokes, make_unpolarized


class PolarizedInteraction(NamedTuple):
    """An `InteractionResult`, and the polarization after it."""

    result: InteractionResult
    stokes: Stokes


@inline_only
def reflect_or_refract_polarized(d, stokes, interface, facet, media, u, mirror_wrong_side):
    """Reflect or refract polarized light at a facet, or direct it into a cosine lobe.

    Parameters
    ----------
    d : Vector
    stokes : Stokes
    interface, facet, media, u, mirror_wrong_side
        See `splits.kernels.grains.interaction.reflect_or_refract`.

    Returns
    -------
    PolarizedInteraction
        With the polarization of the incident light if the interaction must be repeated.
    """
    normal = compute_facet_normal(d, facet.normal, facet.cos_i, facet.tilt, facet.azimuth)
    if facet.back_side:
        normal = scale(-1.0, normal)
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    k = 0.0 if media.equal else media.k
    mueller = compute_mueller(media.m, media.m_minus_1, k, facet.cos_facet)
    if not interface.in_lobe:
        # A variate of 0 or 1 has the scalar interaction reflect or refract.
        reflectance = mueller.reflection.plus + mueller.reflection.minus * light.q
        u = 0.0 if u < reflectance else 1.0
    result = reflect_or_refract(d, interface, facet, media, u, False, ALL_FEATURES)
    if interface.in_lobe:
        return PolarizedInteraction(result, make_unpolarized(result.direction, stokes))
    if not (result.accepted or (mirror_wrong_side and result.needs_lobe)):
        return PolarizedInteraction(result, stokes)
    if result.transmitted:
        stokes = apply_mueller(result.direction, light, mueller.transmission)
    else:
        stokes = apply_mueller(result.direction, light, mueller.reflection)
    if not result.accepted:
        # A mirror image reverses the sense of U and V.
        direction = reflect(result.direction, facet.normal)
        e = reflect(stokes.e, facet.normal)
        stokes = Stokes(e, stokes.q, -stokes.u, -stokes.v)
        result = InteractionResult(
            direction, result.transmitted, True, False, dot(direction, facet.normal)
        )
    return PolarizedInteraction(result, stokes)
