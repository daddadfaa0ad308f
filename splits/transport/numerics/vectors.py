"""Vectors, angles and the frames directions are drawn in; every function serves both precisions.

A kernel hands its ray from function to function in named tuples, which the compiler dissolves: a
`Vector` costs what three numbers cost.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.transport.compiling.jit import ONE, TWO, ZERO, kernel
from splits.transport.numerics.arithmetic import fused, reciprocal_root, root
from splits.transport.numerics.elementary import Angle, circle


class Vector(NamedTuple):
    """A point (m) or a direction (unit length)."""

    x: float
    y: float
    z: float


class Tangents(NamedTuple):
    """Two unit vectors that complete a third to a right-handed frame."""

    u: Vector
    v: Vector


UP = Vector(0.0, 0.0, 1.0)
ORIGIN = Vector(0.0, 0.0, 0.0)


@kernel
def dot(a, b):
    """Return the scalar product of two vectors."""
    return fused(a.x, b.x, fused(a.y, b.y, a.z * b.z))


@kernel
def cross(a, b):
    """Return the vector product of two vectors."""
    return Vector(
        fused(a.y, b.z, -a.z * b.y), fused(a.z, b.x, -a.x * b.z), fused(a.x, b.y, -a.y * b.x)
    )


@kernel
def scaled(s, a):
    """Return s a."""
    return Vector(s * a.x, s * a.y, s * a.z)


@kernel
def along(s, a, b):
    """Return b + s a: where one comes from b, going s along a."""
    return Vector(fused(s, a.x, b.x), fused(s, a.y, b.y), fused(s, a.z, b.z))


@kernel
def combined(g, a, h, b):
    """Return g a + h b."""
    return Vector(fused(g, a.x, h * b.x), fused(g, a.y, h * b.y), fused(g, a.z, h * b.z))


@kernel
def chosen(condition, a, b):
    """Return a where `which` holds, otherwise b; of both, as vector code wants it."""
    return Vector(a.x if condition else b.x, a.y if condition else b.y, a.z if condition else b.z)


@kernel
def normalized(a):
    """Return a scaled to unit length."""
    return scaled(reciprocal_root(dot(a, a)), a)


@kernel
def mirrored(d, n):
    """Return the direction d mirrored in the plane with unit normal n."""
    k = TWO * dot(d, n)
    return Vector(d.x - k * n.x, d.y - k * n.y, d.z - k * n.z)


@kernel
def tangents(n):
    """Return two unit vectors that complete the unit vector n to a right-handed frame.

    Branch-free construction of Duff et al. (2017), J. Comput. Graph. Tech. 6(1), listing 3.
    """
    sign = ONE if n.z >= ZERO else -ONE
    a = -ONE / (sign + n.z)
    b = n.x * n.y * a
    return Tangents(
        Vector(ONE + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vector(b, sign + n.y * n.y * a, -n.y),
    )


@kernel
def around(n, polar, azimuth):
    """Return the unit vector at the given polar and azimuth angles around the unit vector n."""
    t = tangents(n)
    p = polar.sin * azimuth.cos
    q = polar.sin * azimuth.sin
    return normalized(along(q, t.v, along(p, t.u, scaled(polar.cos, n))))


@kernel
def lobe(n, u, u_azimuth):
    """Return a direction around the unit vector n with density cosθ/π (Lambert).

    Parameters
    ----------
    n : Vector
    u, turn : float
        Two uniform random numbers.
    """
    return around(n, Angle(root(u), root(ONE - u)), circle(u_azimuth))
