"""What a ray meets in a layer: faces and particles, with and without polarization."""

from __future__ import annotations

import math

from splits.transport.compiling.jit import part
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.rng import uniform, unit_circle
from splits.transport.numerics.vectors import around, dot, mirrored
from splits.transport.optics.faces import GRAZING, Index, meet
from splits.transport.optics.fresnel import interface
from splits.transport.optics.phase import scattered
from splits.transport.optics.polarized_faces import (
    Meeting,
    Reflected,
    reflect_or_refract_polarized,
    reflected_polarized,
)
from splits.transport.optics.stokes import Scattered, scatter_polarized, unpolarized


@part
def meet_face(state, d, stokes, normal, n1, n2):
    """Reflect or refract a ray at a facet.

    Parameters
    ----------
    state : uint64[1]
    d : Vector
        Direction of travel.
    stokes : Stokes or None
        Its polarization.
    normal : Vector
        Of the facet, against the ray.
    n1, n2 : float
        Refractive index on the side of incidence and beyond.

    Returns
    -------
    Meeting
    """
    if stokes is None:
        crossing = meet(d, normal, Index(n1, 0.0), Index(n2, 0.0), uniform(state))
        return Meeting(crossing.transmitted, crossing.direction, stokes)
    return reflect_or_refract_polarized(state, d, stokes, normal, n1, n2)


@part
def only_reflected(d, stokes, normal, n2):
    """Reflect a ray from outside at a facet, for which other light than the reflected is lost.

    Parameters are those of `meet_face`.

    Returns
    -------
    Reflected
    """
    if stokes is None:
        cos_i = min(max(-dot(d, normal), GRAZING), 1.0)
        share = interface(1.0, n2, 0.0, cos_i).reflectance
        return Reflected(share, mirrored(d, normal), stokes)
    return reflected_polarized(d, stokes, normal, 1.0, n2)


@part
def scatter(state, phase, d, stokes):
    """Return what a particle makes of a ray, a `Scattered`; see `meet_face`."""
    if stokes is None:
        return Scattered(scattered(state, phase, d), stokes)
    return scatter_polarized(state, phase, d, stokes)


@part
def reflect_diffusely(state, normal, stokes):
    """Return what a Lambertian face makes of a ray, a `Scattered`: no light is polarized then.

    Lambert's law as in `vectors.lobe`, with the azimuth drawn by rejection.
    """
    u = uniform(state)
    c, s = unit_circle(state)
    d = around(normal, Angle(math.sqrt(u), math.sqrt(1.0 - u)), Angle(c, s))
    return Scattered(d, unpolarized(d, stokes))
