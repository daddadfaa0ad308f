"""How kernels are compiled, so that all of them are compiled alike, and in which precision."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import config, njit
from numba.extending import overload

from splits.transport.compiling.cache import keep
from splits.transport.compiling.drafts import ONLY_INSIDE
from splits.transport.compiling.ownership import Checked

ALIKE: Any = {"error_model": "numpy", "forceinline": True}
"""Options of every small function: see `kernel`."""
INSIDE: Any = {**ALIKE, **ONLY_INSIDE, "_nrt": False}
"""Options of those that only kernels call, and that own no arrays: see `ownership`."""
OWNING: Any = {**INSIDE, "_nrt": True}
"""Options of those that make arrays, or return any."""


class Kernel:
    """A small function: compiled for Python when that calls it, and into kernels that do."""

    def __init__(self, function: Any) -> None:
        functools.update_wrapper(self, function)
        self.dispatcher = keep(njit(**ALIKE, pipeline_class=Checked)(function))
        _inside(self, function)

    def __call__(self, *values: Any) -> Any:
        """Return what the compiled function does."""
        return self.dispatcher(*values)


def _inside(target: Any, function: Any, options: Any = INSIDE) -> None:
    """Let what kernels call by a name be a function, compiled into them."""
    overload(target, jit_options=options, strict=False)(lambda *types: function)


def kernel(function: Any) -> Any:
    """Compile a small function that is inlined where it is called.

    Scenes keep what they do not have out of the loop, and calls that pass dozens of scalars cost
    nothing.  Division by zero follows IEEE 754 instead of raising, which spares a check at every
    division.  No other liberty is taken: were products and sums fused at will, bits would depend
    on whether code was just compiled or comes from the cache; `arithmetic.fused` says where they
    are.
    """
    return function if config.DISABLE_JIT else Kernel(function)  # type: ignore[attr-defined]


def part(function: Any) -> Any:
    """Compile a function that only kernels call as `kernel` does, but not for calls from Python.

    There it stays as it is written.
    """
    _inside(function, function)
    return function


def owner(function: Any) -> Any:
    """Compile a function as `part` does that makes arrays, or returns any: entries may call it."""
    _inside(function, function, OWNING)
    return function


def entry(function: Any) -> Any:
    """Compile a function that Python calls, free of the interpreter's lock."""
    return keep(njit(error_model="numpy", nogil=True, pipeline_class=Checked)(function))


def borrower(function: Any) -> Any:
    """Compile a function as `entry` does that kernels call, too, and that owns no arrays."""
    options: Any = {"error_model": "numpy", "nogil": True, "_nrt": False}
    return keep(njit(**options, pipeline_class=Checked)(function))


def exact(value: float) -> float | np.float32:
    """Return a number, exact in single precision, that takes on the precision of its partners.

    Formulas that serve double and single precision write their constants so: compiled arithmetic
    of a single-precision constant with a double is exact, and with a single stays single.  Plain
    Python needs no such care.
    """
    return value if config.DISABLE_JIT else np.float32(value)  # type: ignore[attr-defined]


ZERO, HALF, ONE, TWO, THREE, FOUR = (exact(x) for x in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
ONE_AND_HALF = exact(1.5)
TINY = exact(1e-30)
"""Floor under a square whose reciprocal root is multiplied by zero; its value never matters."""
