"""Vectors where lines of the cache begin: others lie in two lines, and take twice the time to load.

Arrays and stacks of compiled functions begin at multiples of 32 and 16 bytes, by chance at one
of 64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from splits.kernels.compiler.jit import inline_allocating

CACHE_LINE_BYTES = 64
"""Bytes in a line of the cache, and in the widest vectors."""


@inline_allocating
def allocate_aligned(count):
    """Return so many zeros of single precision that begin where a line does."""
    words = CACHE_LINE_BYTES // 4
    room = np.zeros(count + words, dtype=np.float32)
    first = -(room.ctypes.data // 4) % words
    return room[first : first + count]


@intrinsic
def align_stack(typing_context: Any) -> Any:
    """Let the frame of the function that calls this begin where a line does."""

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            place = builder.alloca(ir.ArrayType(ir.IntType(8), CACHE_LINE_BYTES))
            place.align = CACHE_LINE_BYTES
        # Nothing is done with the place: but what somebody may look at is not left out.
        looked_at = ir.FunctionType(ir.VoidType(), [place.type])
        builder.asm(looked_at, "", "r", [place], True)
        return context.get_dummy_value()

    return types.void(), lower
