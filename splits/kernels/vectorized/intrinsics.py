"""LLVM intrinsics and hints: vector width, loop interleaving, and gathers."""

from __future__ import annotations

import re
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from splits.kernels.compiler.structure_of_arrays import list_addresses
from splits.kernels.vectorized.lane_state import VECTOR_WIDTH

_INT, _LONG = ir.IntType(32), ir.IntType(64)
_INTS, _LONGS, _FLOATS = (
    ir.VectorType(kind, VECTOR_WIDTH) for kind in (_INT, _LONG, ir.FloatType())
)


@intrinsic
def prefer_512_bit_vectors(typing_context):
    """Mark the function that calls this with LLVM's attribute prefer-vector-width=512.

    By default LLVM uses 256 bits on processors with 512, because early ones reduced their clock
    rate; for these passes 512 bits are about twice as fast.  Other machines ignore the attribute.
    """

    def generate(context, builder, signature, arguments):
        # llvmlite accepts attributes without a value only; its base class, a set, accepts any text.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def interleave_loops(typing_context):
    """Mark the loops above, in the function that calls this, with llvm.loop.interleave.count=2.

    An interaction is one long chain of dependent operations; two interleaved vectors hide their
    latency.  LLVM, which considers registers only, would not interleave.
    """

    def generate(context, builder, signature, arguments):
        module = builder.module
        name = ir.MetaDataString(module, "llvm.loop.interleave.count")
        count = module.add_metadata([name, ir.Constant(ir.IntType(32), 2)])
        for block in builder.function.blocks:
            end = block.terminator
            if isinstance(end, ir.Branch) and _get_bytecode_offset(
                end.operands[0]
            ) < _get_bytecode_offset(block):
                loop = module.add_metadata([count])
                # LLVM identifies a loop by metadata that refers to itself.
                loop.operands = (loop, count)
                end.set_metadata("llvm.loop", loop)
        return context.get_dummy_value()

    return types.void(), generate


def _get_bytecode_offset(block: ir.Block) -> int:
    """Return the bytecode offset of a block from its name, such as B216 or B74.endif."""
    found = re.match(r"B(\d+)", block.name)
    return int(found[1]) if found else 0


@intrinsic(prefer_literal=True)
def gather_interpolate(typing_context, table, lane, row, position, value):
    """Interpolate a table linearly for `VECTOR_WIDTH` lanes at once.

    LLVM cannot prove that stores to lanes do not change the table, and loads its values one by one;
    an explicit gather takes a fifth of the time.

    Parameters
    ----------
    table : float32[rows, points]
    lane : Lane
        The first one.
    row, position, value : str
        Fields of the row in the table (clipped to the last one), of the position from 0 to
        points − 1, and of the interpolated value.
    """

    def generate(context, builder, signature, arguments):
        values = context.make_array(table)(context, builder, arguments[0])
        rows, points = (builder.trunc(n, _INT) for n in cgutils.unpack_tuple(builder, values.shape))

        def locate(field, kind):
            address = next(list_addresses(builder, lane, arguments[1], field.literal_value))
            return builder.bitcast(address, kind.as_pointer())

        def clip(number, limit):
            limit = _broadcast(builder, limit, _INTS)
            return builder.select(builder.icmp_signed("<", number, limit), number, limit)

        at = builder.load(locate(position, _FLOATS), align=4)
        below = clip(builder.fptosi(at, _INTS), builder.sub(points, _INT(2)))
        fraction = builder.fsub(at, builder.sitofp(below, _FLOATS))
        which = clip(builder.load(locate(row, _INTS), align=4), builder.sub(rows, _INT(1)))
        offset = builder.add(builder.mul(which, _broadcast(builder, points, _INTS)), below)
        start, step = builder.ptrtoint(values.data, _LONG), _LONGS([4] * VECTOR_WIDTH)
        offset = builder.mul(builder.zext(offset, _LONGS), step)
        low_at = builder.add(_broadcast(builder, start, _LONGS), offset)
        low, high = _gather(builder, low_at), _gather(builder, builder.add(low_at, step))
        result = builder.fadd(low, builder.fmul(fraction, builder.fsub(high, low)))
        builder.store(result, locate(value, _FLOATS), align=4)
        return context.get_dummy_value()

    return types.void(table, lane, row, position, value), generate


def _broadcast(builder: Any, value: Any, kind: ir.VectorType) -> Any:
    """Return a vector of equal numbers."""
    first = builder.insert_element(kind(ir.Undefined), value, _INT(0))
    return builder.shuffle_vector(first, kind(ir.Undefined), _INTS([0] * VECTOR_WIDTH))


def _gather(builder: Any, addresses: Any) -> Any:
    """Load a number from each address of a vector."""
    mask = ir.VectorType(ir.IntType(1), VECTOR_WIDTH)
    pointers = ir.VectorType(ir.FloatType().as_pointer(), VECTOR_WIDTH)
    gather = cgutils.get_or_insert_function(
        builder.module,
        ir.FunctionType(_FLOATS, [pointers, _INT, mask, _FLOATS]),
        f"llvm.masked.gather.v{VECTOR_WIDTH}f32.v{VECTOR_WIDTH}p0",
    )
    addresses, everywhere = builder.inttoptr(addresses, pointers), mask([1] * VECTOR_WIDTH)
    return builder.call(gather, [addresses, _INT(4), everywhere, _FLOATS(ir.Undefined)])
