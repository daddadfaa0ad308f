"""LLVM intrinsics and hints: vector width, loop interleaving, and gathers."""

from __future__ import annotations

import re

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from splits.kernels.compiler.structure_of_arrays import list_addresses
from splits.kernels.vectorized.lane_state import VECTOR_WIDTH


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
        number, short, long = ir.FloatType(), ir.IntType(32), ir.IntType(64)
        numbers, shorts, longs = (
            ir.VectorType(kind, VECTOR_WIDTH) for kind in (number, short, long)
        )
        mask = ir.VectorType(ir.IntType(1), VECTOR_WIDTH)
        pointers = ir.VectorType(number.as_pointer(), VECTOR_WIDTH)
        values = context.make_array(table)(context, builder, arguments[0])
        rows, points = (
            builder.trunc(size, short) for size in cgutils.unpack_tuple(builder, values.shape)
        )

        def broadcast(value, kind):
            undefined = ir.Constant(kind, ir.Undefined)
            first = builder.insert_element(undefined, value, ir.Constant(short, 0))
            return builder.shuffle_vector(first, undefined, ir.Constant(shorts, [0] * VECTOR_WIDTH))

        def locate(field, kind):
            first = next(list_addresses(builder, lane, arguments[1], field.literal_value))
            return builder.bitcast(first, kind.as_pointer())

        def clip(value, limit):
            limit = broadcast(limit, shorts)
            return builder.select(builder.icmp_signed("<", value, limit), value, limit)

        def gather_values(address):
            gather = cgutils.get_or_insert_function(
                builder.module,
                ir.FunctionType(numbers, [pointers, short, mask, numbers]),
                f"llvm.masked.gather.v{VECTOR_WIDTH}f32.v{VECTOR_WIDTH}p0",
            )
            return builder.call(
                gather,
                [
                    builder.inttoptr(address, pointers),
                    ir.Constant(short, 4),
                    ir.Constant(mask, [1] * VECTOR_WIDTH),
                    ir.Constant(numbers, ir.Undefined),
                ],
            )

        at = builder.load(locate(position, numbers), align=4)
        below = builder.fptosi(at, shorts)
        below = clip(below, builder.sub(points, ir.Constant(short, 2)))
        fraction = builder.fsub(at, builder.sitofp(below, numbers))
        which = clip(builder.load(locate(row, shorts), align=4), builder.sub(rows, ir.Constant(short, 1)))
        offset_in_table = builder.add(builder.mul(which, broadcast(points, shorts)), below)
        step = ir.Constant(longs, [4] * VECTOR_WIDTH)
        start = broadcast(builder.ptrtoint(values.data, long), longs)
        low_at = builder.add(start, builder.mul(builder.zext(offset_in_table, longs), step))
        low, high = gather_values(low_at), gather_values(builder.add(low_at, step))
        result = builder.fadd(low, builder.fmul(fraction, builder.fsub(high, low)))
        builder.store(result, locate(value, numbers), align=4)
        return context.get_dummy_value()

    return types.void(table, lane, row, position, value), generate
