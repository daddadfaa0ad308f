"""Sums of products and roots, each in the way that suits the precision it is asked for.

Plain functions for Python; compiled, the type of the numbers decides what stands in their place.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from splits.kernels.compiler.jit import HALF, INLINE_OPTIONS, ONE_AND_HALF


def fma(a, b, c):
    """Return a b + c, of compiled floats with one rounding where the machine has that."""
    return a * b + c


@overload(fma, jit_options=INLINE_OPTIONS)
def _overload_fma(a, b, c):
    if a == b == c and isinstance(a, types.Float):
        return lambda a, b, c: _fma_intrinsic(a, b, c)
    return lambda a, b, c: a * b + c


@intrinsic
def _fma_intrinsic(typing_context, a, b, c):
    def generate(context, builder, signature, arguments):
        kind = arguments[0].type
        shape = ir.FunctionType(kind, [kind] * 3)
        return builder.call(
            builder.module.declare_intrinsic("llvm.fmuladd", [kind], shape), arguments
        )

    return a(a, b, c), generate


_RSQRT_MAGIC = np.int32(0x5F3759DF)


def rsqrt(x):
    """Return 1/√x of x > 0; in single precision to 2e-7 from 1e-36 on, and finite of 0.

    Compiled for single precision by Newton's method, three steps from a guess that takes half of
    the exponent (error 3.5 %, Lomont 2003): the lanes need more roots than the one unit for roots
    and quotients of a processor gets done.
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
    """Numbers of a precision.

    Attributes
    ----------
    one, zero : float
    min_cos_incidence : float
        Least cosine of incidence.
    min_sin2_incidence : float
        Least sin² of incidence for which facets are turned exactly; in single precision met by
        1e-8 of all trials.
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
