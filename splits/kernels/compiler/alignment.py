"""Alignment of arrays and stack frames to cache lines.

A vector that crosses a cache line takes twice the time to load.  Arrays and stack frames of
compiled functions are aligned to 32 and 16 bytes only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from splits.kernels.compiler.jit import inline_allocating

CACHE_LINE_BYTES = 64
"""Size of a cache line, and of the widest vectors."""


@inline_allocating
def allocate_aligned(count):
    """Return uint32[count] of zeros, aligned to a cache line."""
    words = CACHE_LINE_BYTES // 4
    buffer = np.zeros(count + words, dtype=np.uint32)
    offset = -(buffer.ctypes.data // 4) % words
    return buffer[offset : offset + count]


@intrinsic
def align_stack(typing_context: Any) -> Any:
    """Align the stack frame of the calling function to a cache line."""

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            slot = builder.alloca(ir.ArrayType(ir.IntType(8), CACHE_LINE_BYTES))
            slot.align = CACHE_LINE_BYTES
        # The empty assembly uses the slot, so that LLVM does not remove it.
        use_type = ir.FunctionType(ir.VoidType(), [slot.type])
        builder.asm(use_type, "", "r", [slot], True)
        return context.get_dummy_value()

    return types.void(), lower
