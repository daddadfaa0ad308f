"""Light sources: a collimated beam and diffuse light from above."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import inline
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.math.vectors import Vector


class Source(NamedTuple):
    """Collimated beam, isotropic radiance from the upper hemisphere, or a mixture of both.

    Attributes
    ----------
    cos_incidence : float
        Cosine of the beam's angle of incidence, in (0, 1].
    diffuse_fraction : float
        Fraction of the incident flux that is diffuse, with isotropic radiance, 0 to 1.
    """

    cos_incidence: float
    diffuse_fraction: float


@inline
def sample_source_direction(source, u):
    """Sample the direction of an incident ray, from above, with azimuth 0.

    Media are azimuthally symmetric, so that only the polar angle of diffuse light is sampled.

    Parameters
    ----------
    source : Source
    u : float
        A uniform random number; unused for a beam alone.
    """
    mu = source.cos_incidence
    if u < source.diffuse_fraction:
        # Lambert's law; conditional on the choice, u / diffuse_fraction is uniform again.
        mu = sqrt(u / source.diffuse_fraction)
    return Vector(sqrt(max((1.0 - mu) * (1.0 + mu), 0.0)), 0.0, -mu)
