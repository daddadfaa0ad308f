"""Rays at their start, and where they are."""

from __future__ import annotations

from splits.kernels.arithmetic import add, sqrt
from splits.kernels.compiler.jit import inline, inline_only
from splits.kernels.scene import ALIVE, NO_SEGMENT, ORIGIN, Ray, Vector


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


@inline_only
def make_ray(position, direction, stokes, pore_variate, next_roulette, max_order):
    """Return a new ray in the top layer."""
    return Ray(
        ALIVE, position, ORIGIN, direction, NO_SEGMENT, 0.0, 0, pore_variate, 1.0, 0.0,
        next_roulette, 0, 0, max_order, stokes,
    )  # fmt: skip


@inline_only
def compute_position(ray):
    """Return the position of a ray (m)."""
    return add(ray.position, ray.exit_offset)
