"""Vectors and sampling frames of directions, in either precision.

Kernels pass rays as named tuples, which the compiler dissolves: a `Vector` costs as much as three
numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic, overload

from splits.kernels.compiler.jit import INLINE_OPTIONS, ONE, TWO, ZERO, inline
from splits.kernels.math.arithmetic import fma, rsqrt, sqrt
from splits.kernels.math.elementary import Angle, sample_circle


class Vector(NamedTuple):
    """Point (m) or direction (unit length)."""

    x: float
    y: float
    z: float


class Tangents(NamedTuple):
    """Two unit vectors that complete a third one to a right-handed frame."""

    u: Vector
    v: Vector


UP = Vector(0.0, 0.0, 1.0)
ORIGIN = Vector(0.0, 0.0, 0.0)


@inline
def dot(a, b):
    """Return the scalar product of two vectors."""
    return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z))


@inline
def cross(a, b):
    """Return the vector product of two vectors."""
    return Vector(fma(a.y, b.z, -a.z * b.y), fma(a.z, b.x, -a.x * b.z), fma(a.x, b.y, -a.y * b.x))


@inline
def add(a, b):
    """Return a + b."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


@inline
def scale(s, a):
    """Return s a."""
    return Vector(s * a.x, s * a.y, s * a.z)


@inline
def add_scaled(s, a, b):
    """Return b + s a."""
    return Vector(fma(s, a.x, b.x), fma(s, a.y, b.y), fma(s, a.z, b.z))


@inline
def linear_combination(g, a, h, b):
    """Return g a + h b."""
    return Vector(fma(g, a.x, h * b.x), fma(g, a.y, h * b.y), fma(g, a.z, h * b.z))


def select(condition, a, b):
    """Return a if `condition` holds, otherwise b, without a branch: numbers or named tuples."""
    return a if condition else b


@overload(select, jit_options=INLINE_OPTIONS)
def _overload_select(condition, a, b):
    return lambda condition, a, b: _select_intrinsic(condition, a, b)


@intrinsic
def _select_intrinsic(typing_context, condition, a, b):
    def generate(context, builder, signature, arguments):
        def choose(x, y):
            if not isinstance(x.type, ir.Aggregate):
                return builder.select(arguments[0], x, y)
            chosen = x
            for i in range(len(x.type)):
                member = choose(builder.extract_value(x, i), builder.extract_value(y, i))
                chosen = builder.insert_value(chosen, member, i)
            return chosen

        return choose(*arguments[1:])

    return (a(condition, a, b), generate) if a == b else None


def to_single(value):
    """Return a named tuple of numbers in single precision."""
    return type(value)(*map(np.float32, value))


@overload(to_single, jit_options=INLINE_OPTIONS)
def _overload_to_single(value):
    kind = value.instance_class
    numbers = ", ".join(f"single(value.{name})" for name in kind._fields)
    scope = {"Kind": kind, "single": np.float32}
    exec(f"def to_single(value):\n    return Kind({numbers})", scope)
    return scope["to_single"]


@inline
def store_vector(a, row, first):
    """Write a vector into a row from a column on."""
    row[first], row[first + 1], row[first + 2] = a.x, a.y, a.z


@inline
def normalize(a):
    """Return a scaled to unit length."""
    return scale(rsqrt(dot(a, a)), a)


@inline
def reflect(d, n):
    """Return the direction d mirrored in the plane with unit normal n."""
    k = TWO * dot(d, n)
    return Vector(d.x - k * n.x, d.y - k * n.y, d.z - k * n.z)


@inline
def make_tangents(n):
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


@inline
def direction_around(n, polar, azimuth):
    """Return the unit vector at the given polar and azimuth angles around the unit vector n."""
    t = make_tangents(n)
    p = polar.sin * azimuth.cos
    q = polar.sin * azimuth.sin
    return normalize(add_scaled(q, t.v, add_scaled(p, t.u, scale(polar.cos, n))))


@inline
def sample_cosine_lobe(n, u, u_azimuth):
    """Sample a direction around the unit vector n with density cosθ/π (Lambert).

    Parameters
    ----------
    n : Vector
    u, u_azimuth : float
        Two uniform random numbers.
    """
    return direction_around(n, Angle(sqrt(u), sqrt(ONE - u)), sample_circle(u_azimuth))
