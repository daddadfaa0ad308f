"""Fused multiply-add and roots, each implemented for the precision of its arguments.

Python calls plain functions; compiled code selects an implementation by the type of the arguments.
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
