"""A request to the compiler: use the widest vectors of this machine.

By default LLVM keeps to 256 bits on processors that have 512, because their clocks once suffered;
for these passes 512 bits are about twice as fast.  On other machines the request means nothing.
"""

from __future__ import annotations

from numba.core import types
from numba.extending import intrinsic


@intrinsic
def widest_vectors(typing_context):
    """Mark the function that calls this with LLVM's attribute prefer-vector-width=512."""

    def generate(context, builder, signature, arguments):
        # llvmlite knows attributes without a value only; the set below them takes any text.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate
