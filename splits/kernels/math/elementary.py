"""Elementary functions; polynomials in single precision, which compilers can vectorize.

Calls of a mathematical library prevent the vectorization of a loop over lanes, so in single
precision the few functions needed are polynomials.  `tests/unit/kernels/test_elementary.py`
compares each with mpmath over its range.  Double precision uses the library.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy import float32 as single

from splits.kernels.compiler.jit import (
    COMMON_OPTIONS,
    HALF,
    ONE,
    TWO,
    ZERO,
    float32_constant,
    inline,
)
from splits.kernels.math.arithmetic import fma

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
