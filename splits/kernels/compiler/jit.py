"""Decorators that compile the kernels with common options, and constants of either precision."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import config, njit
from numba.extending import overload

from splits.kernels.compiler.cache import enable_caching
from splits.kernels.compiler.deferred import make_deferred_options
from splits.kernels.compiler.passes import RefcountCheckedCompiler

COMMON_OPTIONS: Any = {"error_model": "numpy", "forceinline": True}
"""Options of all small functions, see `inline`."""
INLINE_OPTIONS: Any = {**COMMON_OPTIONS, **make_deferred_options(), "_nrt": False}
"""Options of functions that only kernels call and that do not allocate, see `passes`."""
ALLOCATING_OPTIONS: Any = {**INLINE_OPTIONS, "_nrt": True}
"""Options of functions that allocate or return arrays."""


class InlineFunction:
    """Small function, inlined into the kernels that call it and compiled for calls from Python."""

    def __init__(self, function: Any) -> None:
        functools.update_wrapper(self, function)
        self.dispatcher = enable_caching(
            njit(**COMMON_OPTIONS, pipeline_class=RefcountCheckedCompiler)(function)
        )
        _register_overload(self, function)

    def __call__(self, *values: Any) -> Any:
        """Return the result of the compiled function."""
        return self.dispatcher(*values)


def _register_overload(target: Any, function: Any, options: Any = INLINE_OPTIONS) -> None:
    """Inline a function into the kernels that call `target`."""

    def choose(*types: Any) -> Any:
        return None if _has_class(types, _SPECIALIZED.get(target, ())) else function

    overload(target, jit_options=options, strict=False)(choose)


_SPECIALIZED: dict[Any, tuple[type, ...]] = {}
"""Classes of arguments for which functions have other versions."""


def _has_class(types: Any, classes: tuple[type, ...]) -> bool:
    """Return whether the Numba type of any argument is a named tuple of one of the classes."""
    return any(getattr(one, "instance_class", None) in classes for one in types)


def specialize(target: Any, kind: type) -> Any:
    """Decorate the version of an inlined function for named tuples of a class.

    It takes the place of `target` in compiled code, where one of its arguments is of this class; so
    can a shape of grains be added without changes of other modules.  Calls from Python and runs
    without the compiler (NUMBA_DISABLE_JIT) use `target` itself.  The version must be in
    `splits.kernels`, because cached kernels are compiled again only after a change of the sources
    there.
    """

    def register(function: Any) -> Any:
        _SPECIALIZED[target] = (*_SPECIALIZED.get(target, ()), kind)
        overload(target, jit_options=INLINE_OPTIONS, strict=False)(
            lambda *types: function if _has_class(types, (kind,)) else None
        )
        return function

    return register


def inline(function: Any) -> Any:
    """Compile a small function that is inlined where it is called.

    Inlining removes the code of absent features and the cost of passing dozens of scalars.
    Division by zero follows IEEE 754 instead of raising, which saves a check at every division.
    Fast-math options are off: with free contraction of products and sums the bits would depend on
    whether code was just compiled or comes from the cache.  `arithmetic.fma` marks the contracted
    ones.
    """
    return function if config.DISABLE_JIT else InlineFunction(function)  # type: ignore[attr-defined]


def inline_only(function: Any) -> Any:
    """Inline a function as `inline` does; calls from Python run its source."""
    _register_overload(function, function)
    return function


def inline_allocating(function: Any) -> Any:
    """Inline a function, as `inline_only` does, that allocates or returns arrays."""
    _register_overload(function, function, ALLOCATING_OPTIONS)
    return function


def entry_point(function: Any) -> Any:
    """Compile a function that Python calls, without the global interpreter lock."""
    return enable_caching(
        njit(error_model="numpy", nogil=True, pipeline_class=RefcountCheckedCompiler)(function)
    )


def entry_point_no_refcount(function: Any) -> Any:
    """Compile a function, as `entry_point` does, that allocates no arrays.

    Kernels may call it, too.
    """
    options: Any = {"error_model": "numpy", "nogil": True, "_nrt": False}
    return enable_caching(njit(**options, pipeline_class=RefcountCheckedCompiler)(function))


def float32_constant(value: float) -> float | np.float32:
    """Return a constant that adopts the precision of the operands.

    Compiled arithmetic of a single-precision constant with a double is in double precision, and
    with a single stays single, so that one formula serves both precisions.  A value that is not
    exact in single precision is rounded for both.
    """
    return value if config.DISABLE_JIT else np.float32(value)  # type: ignore[attr-defined]


ZERO, HALF, ONE, TWO, THREE, FOUR = (float32_constant(x) for x in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
ONE_AND_HALF = float32_constant(1.5)
TINY = float32_constant(1e-30)
"""Lower bound of a square whose reciprocal root is multiplied by zero; its value does not affect
results."""
