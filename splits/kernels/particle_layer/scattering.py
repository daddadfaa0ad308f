"""Scattering of rays at interfaces, particles and Lambertian boundaries, polarized or not."""

from __future__ import annotations

import math

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import sample_azimuth, uniform
from splits.kernels.math.vectors import direction_around, dot, reflect
from splits.kernels.optics.fresnel import fresnel
from splits.kernels.optics.interface import MIN_COS_INCIDENCE, ComplexIndex, sample_interface
from splits.kernels.optics.phase_function import sample_phase_function
from splits.kernels.optics.polarized_interface import (
    PolarizedInterfaceSample,
    ReflectedLight,
    reflect_polarized,
    sample_polarized_interface,
)
from splits.kernels.optics.stokes import DirectionSample, make_unpolarized, scatter_polarized


@inline_only
def reflect_or_refract_ray(state, d, stokes, normal, n1, n2):
    """Reflect or refract a ray at a facet.

    Parameters
    ----------
    state : uint64[1]
    d : Vector
        Direction of travel.
    stokes : Stokes or None
        Polarization of the ray.
    normal : Vector
        Normal of the facet, against the ray.
    n1, n2 : float
        Refractive indices on the side of incidence and on the far side.

    Returns
    -------
    PolarizedInterfaceSample
    """
    if stokes is None:
        sample = sample_interface(
            d, normal, ComplexIndex(n1, 0.0), ComplexIndex(n2, 0.0), uniform(state)
        )
        return PolarizedInterfaceSample(sample.transmitted, sample.direction, stokes)
    return sample_polarized_interface(state, d, stokes, normal, n1, n2)


@inline_only
def reflect_only(d, stokes, normal, n2):
    """Reflect a ray from outside at a facet of an opaque medium.

    Parameters are those of `reflect_or_refract_ray`.

    Returns
    -------
    ReflectedLight
    """
    if stokes is None:
        cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
        reflectance = fresnel(1.0, n2, 0.0, cos_i).reflectance
        return ReflectedLight(reflectance, reflect(d, normal), stokes)
    return reflect_polarized(d, stokes, normal, 1.0, n2)


@inline_only
def sample_scattering(state, phase, d, stokes):
    """Sample the `DirectionSample` of a ray after scattering by a particle."""
    if stokes is None:
        return DirectionSample(sample_phase_function(state, phase, d), stokes)
    return scatter_polarized(state, phase, d, stokes)


@inline_only
def sample_lambertian_reflection(state, normal, stokes):
    """Sample the `DirectionSample` of a ray after Lambertian reflection, which depolarizes it.

    It follows Lambert's law as `vectors.sample_cosine_lobe`, with the azimuth sampled by rejection.
    """
    u = uniform(state)
    c, s = sample_azimuth(state)
    d = direction_around(normal, Angle(math.sqrt(u), math.sqrt(1.0 - u)), Angle(c, s))
    return DirectionSample(d, make_unpolarized(d, stokes))
