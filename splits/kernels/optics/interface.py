"""Smooth faces between two media: a ray is mirrored or passes."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import inline
from splits.kernels.math.vectors import Vector, dot, reflect
from splits.kernels.optics.fresnel import fresnel_between, refract

MIN_COS_INCIDENCE = 1e-12
"""Least cosine of incidence; there all light is reflected anyway."""


class ComplexIndex(NamedTuple):
    """Complex refractive index n + i k."""

    n: float
    k: float


class InterfaceSample(NamedTuple):
    """Whether a ray passed a face, and its direction after."""

    transmitted: bool
    direction: Vector


@inline
def sample_interface(d, normal, near, far, u):
    """Return what becomes of a ray along d at a face.

    Parameters
    ----------
    d, normal : Vector
        The normal is against d.
    near, far : ComplexIndex
        On the side of incidence, and beyond.
    u : float
        A uniform random number.
    """
    cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
    passage = fresnel_between(near.n, near.k, far.n, far.k, cos_i)
    if u < passage.reflectance:
        return InterfaceSample(False, reflect(d, normal))
    if passage.sine_ratio == 1.0 and passage.cos_transmitted == cos_i:
        return InterfaceSample(True, d)
    return InterfaceSample(True, refract(d, normal, cos_i, passage))


@inline
def orient_horizontal_normal(d):
    """Return the normal of a horizontal face on the side of a ray along d."""
    return Vector(0.0, 0.0, -1.0 if d.z > 0.0 else 1.0)
