"""Reflection and refraction of rays at a smooth interface."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import inline
from splits.kernels.math.vectors import Vector, dot, reflect
from splits.kernels.optics.fresnel import fresnel_between, refract

MIN_COS_INCIDENCE = 1e-12
"""Smallest cosine of incidence, at which all light is reflected."""


class ComplexIndex(NamedTuple):
    """Complex refractive index n + i k."""

    n: float
    k: float


class InterfaceSample(NamedTuple):
    """Whether a ray was transmitted, and its new direction."""

    transmitted: bool
    direction: Vector


@inline
def sample_interface(d, normal, near, far, u):
    """Sample reflection or refraction of a ray along d.

    Parameters
    ----------
    d, normal : Vector
        The normal is against d.
    near, far : ComplexIndex
        On the side of incidence, and on the far side.
    u : float
        A uniform random number.
    """
    cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
    result = fresnel_between(near.n, near.k, far.n, far.k, cos_i)
    if u < result.reflectance:
        return InterfaceSample(False, reflect(d, normal))
    if result.sine_ratio == 1.0 and result.cos_transmitted == cos_i:
        return InterfaceSample(True, d)
    return InterfaceSample(True, refract(d, normal, cos_i, result))


@inline
def orient_horizontal_normal(d):
    """Return the normal of a horizontal interface that points against a ray along d."""
    return Vector(0.0, 0.0, -1.0 if d.z > 0.0 else 1.0)
