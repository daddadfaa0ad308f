"""How kernels are compiled: one decorator, so that all of them are compiled alike."""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, error_model="numpy", forceinline=True)
"""A small function that is inlined where it is called: scenes keep what they do not have out of
the loop, and calls that pass dozens of scalars cost nothing.  Division by zero follows IEEE 754
instead of raising, which spares a check at every division."""

entry = njit(cache=True, error_model="numpy", nogil=True)
"""A function that Python calls, free of the interpreter's lock."""
