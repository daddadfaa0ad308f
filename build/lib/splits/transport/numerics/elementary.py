"""Elementary functions, in single precision such that compilers can turn them into vector code.

Calls of a mathematical library in a loop over lanes undo its vectorisation, so in single precision
the few functions needed are polynomials.  `tests/unit/test_elementary.py` holds each against mpmath
over its range.  In double precision the library serves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy import float32 as single

from splits.transport.compiling.jit import ALIKE, HALF, ONE, TWO, ZERO, exact, kernel
from splits.transport.numerics.arithmetic import fused

_SIGNIFICAND = 0x007FFFFF
_ONE_BITS = 0x3F800000
_LOG2_E = exact(1.4426950408889634)
# ln 2 in two parts: the first has so few digits that its products with exponents are exact.
_LN2_HIGH = exact(0.693359375)
_LN2_LOW = exact(-2.12194440e-4)
_SQRT2 = exact(1.41421356)
_PI = exact(3.14159265)


class Angle(NamedTuple):
    """An angle, by its cosine and sine."""

    cos: float
    sin: float


def logarithm(x):
    """Return ln x; in single precision see `single_logarithm`."""
    return math.log(x)


@overload(logarithm, jit_options=ALIKE)
def _logarithm(x):
    if x == types.float32:
        return lambda x: single_logarithm(x)
    return lambda x: math.log(x)


def half_circle(u):
    """Return the angle π(u − ½) in (−π/2, π/2); in single precision see `single_half_circle`."""
    angle = math.pi * (u - 0.5)
    return Angle(math.cos(angle), math.sin(angle))


@overload(half_circle, jit_options=ALIKE)
def _half_circle(u):
    if u == types.float32:
        return lambda u: single_half_circle(u)

    def by_library(u):
        angle = math.pi * (u - 0.5)
        return Angle(math.cos(angle), math.sin(angle))

    return by_library


@kernel
def circle(u):
    """Return a uniform angle on the circle for u uniform on (0, 1), in single precision to 1e-6."""
    half = half_circle(u)
    return Angle(fused(TWO * half.cos, half.cos, -ONE), TWO * half.sin * half.cos)


@kernel
def single_logarithm(x):
    """Return ln x of a float32 x in [1e-30, 1e30], to 2e-7 relative plus 1e-7 absolute.

    The significand is brought to [√½, √2]; ln(1 + f) = f − f²/2 + f³ P(f), P of degree 8
    (Cephes, S. Moshier, logf).
    """
    bits = np.float32(x).view(np.int32)
    exponent = np.int32((bits >> 23) - 127)
    m = np.int32((bits & _SIGNIFICAND) | _ONE_BITS).view(np.float32)
    high = m > _SQRT2
    e = np.float32(exponent)
    e = e + ONE if high else e
    f = (HALF * m if high else m) - ONE
    p = single(7.0376836292e-2)
    p = fused(p, f, single(-1.1514610310e-1))
    p = fused(p, f, single(1.1676998740e-1))
    p = fused(p, f, single(-1.2420140846e-1))
    p = fused(p, f, single(1.4249322787e-1))
    p = fused(p, f, single(-1.6668057665e-1))
    p = fused(p, f, single(2.0000714765e-1))
    p = fused(p, f, single(-2.4999993993e-1))
    p = fused(p, f, single(3.3333331174e-1))
    square = f * f
    low = fused(p * f, square, fused(e, _LN2_LOW, -HALF * square))
    return fused(e, _LN2_HIGH, f + low)


@kernel
def exponential(x):
    """Return exp x of a float32 x ≤ 0, to 2e-7 relative; 0 from −87 on; exactly 1 at 0.

    exp x = 2ⁿ exp r with |r| ≤ ln 2 / 2 (Cephes, S. Moshier, expf).
    """
    held = max(x, single(-87.0))
    n = np.int32(held * _LOG2_E - HALF)
    whole = np.float32(n)
    r = fused(-whole, _LN2_LOW, fused(-whole, _LN2_HIGH, held))
    p = single(1.9875691500e-4)
    p = fused(p, r, single(1.3981999507e-3))
    p = fused(p, r, single(8.3334519073e-3))
    p = fused(p, r, single(4.1665795894e-2))
    p = fused(p, r, single(1.6666665459e-1))
    p = fused(p, r, single(5.0000001201e-1))
    p = fused(p * r, r, r) + ONE
    power = np.int32((n + 127) << 23).view(np.float32)
    return p * power if x > single(-87.0) else ZERO


@kernel
def single_half_circle(u):
    """Return the angle π(u − ½) in (−π/2, π/2), float32, to 3e-7.

    Taylor polynomials of degree 11 and 12.
    """
    x = _PI * (u - HALF)
    y = x * x
    s = single(-2.50521083854e-8)
    s = fused(s, y, single(2.75573192240e-6))
    s = fused(s, y, single(-1.98412698413e-4))
    s = fused(s, y, single(8.33333333333e-3))
    s = fused(s, y, single(-1.66666666667e-1))
    c = single(2.08767569879e-9)
    c = fused(c, y, single(-2.75573192240e-7))
    c = fused(c, y, single(2.48015873016e-5))
    c = fused(c, y, single(-1.38888888889e-3))
    c = fused(c, y, single(4.16666666667e-2))
    c = fused(c, y, -HALF)
    return Angle(fused(c, y, ONE), fused(s * y, x, x))
