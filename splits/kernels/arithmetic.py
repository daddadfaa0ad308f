"""Arithmetic, elementary functions and vectors, in either precision."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload
from numpy import float32 as single

from splits.kernels.compiler.jit import (
    COMMON_OPTIONS,
    HALF,
    INLINE_OPTIONS,
    ONE,
    ONE_AND_HALF,
    TWO,
    ZERO,
    float32_constant,
    inline,
)
from splits.kernels.scene import Vector

# --------------------------------------------------------------------------------------------------
# Fused multiply-add and roots, each implemented for the precision of its arguments.
#
# Python calls plain functions; compiled code selects an implementation by the type of the
# arguments.


def fma(a, b, c):
    """Return a b + c, compiled with a single rounding where the processor supports it."""
    return a * b + c


@overload(fma, jit_options=INLINE_OPTIONS)
def _overload_fma(a, b, c):
    if a == b == c and isinstance(a, types.Float):
        return lambda a, b, c: _fma_intrinsic(a, b, c)
    return lambda a, b, c: a * b + c


@intrinsic
def _fma_intrinsic(typing_context, a, b, c):
    def generate(context, builder, signature, arguments):
        llvm_type = arguments[0].type
        function_type = ir.FunctionType(llvm_type, [llvm_type] * 3)
        return builder.call(
            builder.module.declare_intrinsic("llvm.fmuladd", [llvm_type], function_type), arguments
        )

    return a(a, b, c), generate


_RSQRT_MAGIC = np.int32(0x5F3759DF)


def rsqrt(x):
    """Return 1/√x of x > 0; in single precision to 2e-7 from 1e-36 on, and finite at 0.

    Single precision uses three steps of Newton's method from an estimate by half of the exponent
    (error 3.5 %, Lomont 2003): the vectorized kernel needs more roots than the single unit for
    roots and divisions of a processor delivers.
    """
    return 1.0 / math.sqrt(x)


@overload(rsqrt, jit_options=INLINE_OPTIONS)
def _overload_rsqrt(x):
    if x != types.float32:
        return lambda x: 1.0 / math.sqrt(x)

    def by_newton(x):
        half = HALF * x
        y = np.int32(_RSQRT_MAGIC - (np.float32(x).view(np.int32) >> 1)).view(np.float32)
        y = y * fma(-half * y, y, ONE_AND_HALF)
        y = y * fma(-half * y, y, ONE_AND_HALF)
        return fma(y, fma(-half * y, y, HALF), y)

    return by_newton


def sqrt(x):
    """Return √x of x ≥ 0; in single precision to 3e-7."""
    return math.sqrt(x)


@overload(sqrt, jit_options=INLINE_OPTIONS)
def _overload_sqrt(x):
    if x != types.float32:
        return lambda x: math.sqrt(x)
    return lambda x: x * rsqrt(x)


class Precision(NamedTuple):
    """Constants of a floating-point precision.

    Attributes
    ----------
    one, zero : float
    min_cos_incidence : float
        Lower bound of the cosine of incidence.
    min_sin2_incidence : float
        Smallest sin² of incidence for which facet normals are rotated exactly; in single precision
        1e-8 of all samples lie below.
    """

    one: Any
    zero: Any
    min_cos_incidence: Any
    min_sin2_incidence: Any


_SINGLE = Precision(np.float32(1.0), np.float32(0.0), np.float32(1e-6), np.float32(1e-8))
_DOUBLE = Precision(1.0, 0.0, 1e-12, 1e-20)


def get_precision(x):
    """Return the `Precision` of a number."""
    return _SINGLE if isinstance(x, np.float32) else _DOUBLE


@overload(get_precision, jit_options=INLINE_OPTIONS)
def _overload_get_precision(x):
    if x == types.float32:
        return lambda x: _SINGLE
    return lambda x: _DOUBLE


# --------------------------------------------------------------------------------------------------
# Elementary functions; polynomials in single precision, which compilers can vectorize.
#
# Calls of a mathematical library prevent the vectorization of a loop over lanes, so in single
# precision the few functions needed are polynomials.  `tests/unit/kernels/test_elementary.py`
# compares each with mpmath over its range.  Double precision uses the library.

_SIGNIFICAND_MASK = 0x007FFFFF
_ONE_BITS = 0x3F800000
_LOG2_E = float32_constant(1.4426950408889634)
# ln 2 as a sum: the first part has few digits, so that its products with exponents are exact.
_LN2_HIGH = float32_constant(0.693359375)
_LN2_LOW = float32_constant(-2.12194440e-4)
_SQRT2 = float32_constant(1.41421356)
_PI = float32_constant(3.14159265)


class Angle(NamedTuple):
    """Cosine and sine of an angle."""

    cos: float
    sin: float


def log(x):
    """Return ln x; in single precision by `log_float32`."""
    return math.log(x)


@overload(log, jit_options=COMMON_OPTIONS)
def _overload_log(x):
    if x == types.float32:
        return lambda x: log_float32(x)
    return lambda x: math.log(x)


def sample_half_circle(u):
    """Return the angle π(u − ½); in single precision by `sample_half_circle_float32`."""
    angle = math.pi * (u - 0.5)
    return Angle(math.cos(angle), math.sin(angle))


@overload(sample_half_circle, jit_options=COMMON_OPTIONS)
def _overload_sample_half_circle(u):
    if u == types.float32:
        return lambda u: sample_half_circle_float32(u)

    def by_library(u):
        angle = math.pi * (u - 0.5)
        return Angle(math.cos(angle), math.sin(angle))

    return by_library


@inline
def sample_circle(u):
    """Return an angle uniform on the circle for a uniform u, to 1e-6 in single precision."""
    half = sample_half_circle(u)
    return Angle(fma(TWO * half.cos, half.cos, -ONE), TWO * half.sin * half.cos)


@inline
def log_float32(x):
    """Return ln x of a float32 x in [1e-30, 1e30], to 2e-7 relative plus 1e-7 absolute.

    The significand is scaled to [√½, √2]; ln(1 + f) = f − f²/2 + f³ P(f), P of degree 8
    (Cephes, S. Moshier, logf).
    """
    bits = np.float32(x).view(np.int32)
    exponent = np.int32((bits >> 23) - 127)
    m = np.int32((bits & _SIGNIFICAND_MASK) | _ONE_BITS).view(np.float32)
    high = m > _SQRT2
    e = np.float32(exponent)
    e = e + ONE if high else e
    f = (HALF * m if high else m) - ONE
    p = single(7.0376836292e-2)
    p = fma(p, f, single(-1.1514610310e-1))
    p = fma(p, f, single(1.1676998740e-1))
    p = fma(p, f, single(-1.2420140846e-1))
    p = fma(p, f, single(1.4249322787e-1))
    p = fma(p, f, single(-1.6668057665e-1))
    p = fma(p, f, single(2.0000714765e-1))
    p = fma(p, f, single(-2.4999993993e-1))
    p = fma(p, f, single(3.3333331174e-1))
    square = f * f
    low = fma(p * f, square, fma(e, _LN2_LOW, -HALF * square))
    return fma(e, _LN2_HIGH, f + low)


@inline
def exp_float32(x):
    """Return exp x of a float32 x ≤ 0, to 2e-7 relative; 0 from −87 on; exactly 1 at 0.

    exp x = 2ⁿ exp r with |r| ≤ ln 2 / 2 (Cephes, S. Moshier, expf).
    """
    clamped = max(x, single(-87.0))
    n = np.int32(clamped * _LOG2_E - HALF)
    n_float = np.float32(n)
    r = fma(-n_float, _LN2_LOW, fma(-n_float, _LN2_HIGH, clamped))
    p = single(1.9875691500e-4)
    p = fma(p, r, single(1.3981999507e-3))
    p = fma(p, r, single(8.3334519073e-3))
    p = fma(p, r, single(4.1665795894e-2))
    p = fma(p, r, single(1.6666665459e-1))
    p = fma(p, r, single(5.0000001201e-1))
    p = fma(p * r, r, r) + ONE
    power = np.int32((n + 127) << 23).view(np.float32)
    return p * power if x > single(-87.0) else ZERO


@inline
def sample_half_circle_float32(u):
    """Return the angle π(u − ½) in (−π/2, π/2), float32, to 3e-7.

    Taylor polynomials of degree 11 and 12.
    """
    x = _PI * (u - HALF)
    y = x * x
    s = single(-2.50521083854e-8)
    s = fma(s, y, single(2.75573192240e-6))
    s = fma(s, y, single(-1.98412698413e-4))
    s = fma(s, y, single(8.33333333333e-3))
    s = fma(s, y, single(-1.66666666667e-1))
    c = single(2.08767569879e-9)
    c = fma(c, y, single(-2.75573192240e-7))
    c = fma(c, y, single(2.48015873016e-5))
    c = fma(c, y, single(-1.38888888889e-3))
    c = fma(c, y, single(4.16666666667e-2))
    c = fma(c, y, -HALF)
    return Angle(fma(c, y, ONE), fma(s * y, x, x))


# --------------------------------------------------------------------------------------------------
# Vectors and sampling frames of directions, in either precision.
#
# Kernels pass rays as named tuples, which the compiler dissolves: a `Vector` costs as much as three
# numbers.


class Tangents(NamedTuple):
    """Two unit vectors that complete a third one to a right-handed frame."""

    u: Vector
    v: Vector


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
