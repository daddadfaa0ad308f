"""Smooth faces between two media: a ray is mirrored or passes."""

from __future__ import annotations

from typing import NamedTuple

from splits.transport.compiling.jit import kernel
from splits.transport.numerics.vectors import Vector, dot, mirrored
from splits.transport.optics.fresnel import between, refracted

GRAZING = 1e-12
"""Least cosine of incidence; there all light is reflected anyway."""


class Index(NamedTuple):
    """Complex refractive index n + i k."""

    n: float
    k: float


class Crossing(NamedTuple):
    """Whether a ray passed a face, and its direction after."""

    transmitted: bool
    direction: Vector


@kernel
def meet(d, normal, near, far, u):
    """Return what becomes of a ray along d at a face.

    Parameters
    ----------
    d, normal : Vector
        The normal is against d.
    near, far : Index
        On the side of incidence, and beyond.
    u : float
        A uniform random number.
    """
    cos_i = min(max(-dot(d, normal), GRAZING), 1.0)
    passage = between(near.n, near.k, far.n, far.k, cos_i)
    if u < passage.reflectance:
        return Crossing(False, mirrored(d, normal))
    if passage.sine_ratio == 1.0 and passage.cos_transmitted == cos_i:
        return Crossing(True, d)
    return Crossing(True, refracted(d, normal, cos_i, passage))


@kernel
def facing(d):
    """Return the normal of a horizontal face on the side of a ray along d."""
    return Vector(0.0, 0.0, -1.0 if d.z > 0.0 else 1.0)
