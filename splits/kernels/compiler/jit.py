"""How kernels are compiled, so that all of them are compiled alike, and in which precision."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import config, njit
from numba.extending import overload

from splits.kernels.compiler.cache import enable_caching
from splits.kernels.compiler.passes import DEFERRED_CODEGEN_OPTIONS, RefcountCheckedCompiler

COMMON_OPTIONS: Any = {"error_model": "numpy", "forceinline": True}
"""Options of every small function: see `inline`."""
INLINE_OPTIONS: Any = {**COMMON_OPTIONS, **DEFERRED_CODEGEN_OPTIONS, "_nrt": False}
"""Options of those that only kernels call, and that own no arrays: see `ownership`."""
ALLOCATING_OPTIONS: Any = {**INLINE_OPTIONS, "_nrt": True}
"""Options of those that make arrays, or return any."""


class InlineFunction:
    """A small function: compiled for Python when that calls it, and into kernels that do."""

    def __init__(self, function: Any) -> None:
        functools.update_wrapper(self, function)
        self.dispatcher = enable_caching(
            njit(**COMMON_OPTIONS, pipeline_class=RefcountCheckedCompiler)(function)
        )
        _register_overload(self, function)

    def __call__(self, *values: Any) -> Any:
        """Return what the compiled function does."""
        return self.dispatcher(*values)


def _register_overload(target: Any, function: Any, options: Any = INLINE_OPTIONS) -> None:
    """Let what kernels call by a name be a function, compiled into them."""
    overload(target, jit_options=options, strict=False)(lambda *types: function)


def inline(function: Any) -> Any:
    """Compile a small function that is inlined where it is called.

    Scenes keep what they do not have out of the loop, and calls that pass dozens of scalars cost
    nothing.  Division by zero follows IEEE 754 instead of raising, which spares a check at every
    division.  No other liberty is taken: were products and sums fused at will, bits would depend
    on whether code was just compiled or comes from the cache; `arithmetic.fused` says where they
    are.
    """
    return function if config.DISABLE_JIT else InlineFunction(function)  # type: ignore[attr-defined]


def inline_only(function: Any) -> Any:
    """Compile a function that only kernels call as `inline` does, but not for calls from Python.

    There it stays as it is written.
    """
    _register_overload(function, function)
    return function


def inline_allocating(function: Any) -> Any:
    """Compile a function as `inline_only` does that makes arrays, or returns any: entries may call it."""
    _register_overload(function, function, ALLOCATING_OPTIONS)
    return function


def entry_point(function: Any) -> Any:
    """Compile a function that Python calls, free of the interpreter's lock."""
    return enable_caching(
        njit(error_model="numpy", nogil=True, pipeline_class=RefcountCheckedCompiler)(function)
    )


def entry_point_no_refcount(function: Any) -> Any:
    """Compile a function as `entry_point` does that kernels call, too, and that owns no arrays."""
    options: Any = {"error_model": "numpy", "nogil": True, "_nrt": False}
    return enable_caching(njit(**options, pipeline_class=RefcountCheckedCompiler)(function))


def float32_constant(value: float) -> float | np.float32:
    """Return a number, exact in single precision, that takes on the precision of its partners.

    Formulas that serve double and single precision write their constants so: compiled arithmetic
    of a single-precision constant with a double is exact, and with a single stays single.  Plain
    Python needs no such care.
    """
    return value if config.DISABLE_JIT else np.float32(value)  # type: ignore[attr-defined]


ZERO, HALF, ONE, TWO, THREE, FOUR = (float32_constant(x) for x in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
ONE_AND_HALF = float32_constant(1.5)
TINY = float32_constant(1e-30)
"""Floor under a square whose reciprocal root is multiplied by zero; its value never matters."""
