"""Scattering of rays at interfaces and particles, polarized or not."""

from __future__ import annotations

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import dot, reflect
from splits.kernels.optics.fresnel import fresnel
from splits.kernels.optics.interface import MIN_COS_INCIDENCE, sample_interface
from splits.kernels.optics.phase_function import sample_phase_function
from splits.kernels.optics.polarized_interface import (
    PolarizedInterfaceSample,
    ReflectedLight,
    reflect_polarized,
    sample_polarized_interface,
)
from splits.kernels.optics.stokes import DirectionSample, scatter_polarized


@inline_only
def reflect_or_refract_ray(state, d, stokes, normal, near, far):
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
    near, far : ComplexIndex
        Refractive indices on the side of incidence and on the far side.

    Returns
    -------
    PolarizedInterfaceSample
    """
    if stokes is None:
        sample = sample_interface(d, normal, near, far, uniform(state))
        return PolarizedInterfaceSample(sample.transmitted, sample.direction, stokes)
    return sample_polarized_interface(state, d, stokes, normal, near, far)


@inline_only
def reflect_only(d, stokes, normal, near, far):
    """Reflect a ray at a facet of an opaque medium.

    Parameters are those of `reflect_or_refract_ray`.

    Returns
    -------
    ReflectedLight
    """
    if stokes is None:
        cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
        reflectance = fresnel(near.n, far.n, far.k, cos_i).reflectance
        return ReflectedLight(reflectance, reflect(d, normal), stokes)
    return reflect_polarized(d, stokes, normal, near, far)


@inline_only
def sample_scattering(state, phase, d, stokes):
    """Sample the `DirectionSample` of a ray after scattering by a particle."""
    if stokes is None:
        return DirectionSample(sample_phase_function(state, phase, d), stokes)
    return scatter_polarized(state, phase, d, stokes)
