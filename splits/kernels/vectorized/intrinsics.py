"""LLVM intrinsics and hints: vector width, loop interleaving, and gathers."""

from __future__ import annotations

import re

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

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


@intrinsic
def gather_interpolate(typing_context, table, state, row_at, position_at, value_at):
    """Interpolate a table linearly for `VECTOR_WIDTH` lanes at once.

    LLVM cannot prove that stores to lanes do not change the table, and loads its values one by one;
    an explicit gather takes a fifth of the time.

    Parameters
    ----------
    table : float32[rows, points]
    state : float32[:]
    row_at, position_at, value_at : int
        Offsets in `state` of the rows of the lanes (clipped to the last one), of their positions
        from 0 to points − 1, and of the interpolated values.
    """

    def generate(context, builder, signature, arguments):
        number, short, long = ir.FloatType(), ir.IntType(32), ir.IntType(64)
        numbers, shorts, longs = (
            ir.VectorType(kind, VECTOR_WIDTH) for kind in (number, short, long)
        )
        mask = ir.VectorType(ir.IntType(1), VECTOR_WIDTH)
        pointers = ir.VectorType(number.as_pointer(), VECTOR_WIDTH)
        values, lanes = (
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args[:2], arguments[:2], strict=True)
        )
        rows, points = (
            builder.trunc(size, short) for size in cgutils.unpack_tuple(builder, values.shape)
        )

        def broadcast(value, kind):
            undefined = ir.Constant(kind, ir.Undefined)
            first = builder.insert_element(undefined, value, ir.Constant(short, 0))
            return builder.shuffle_vector(first, undefined, ir.Constant(shorts, [0] * VECTOR_WIDTH))

        def lane(offset):
            return builder.bitcast(builder.gep(lanes.data, [offset]), numbers.as_pointer())

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

        position = builder.load(lane(arguments[3]), align=4)
        below = builder.fptosi(position, shorts)
        below = clip(below, builder.sub(points, ir.Constant(short, 2)))
        fraction = builder.fsub(position, builder.sitofp(below, numbers))
        which = builder.fptosi(builder.load(lane(arguments[2]), align=4), shorts)
        which = clip(which, builder.sub(rows, ir.Constant(short, 1)))
        offset_in_table = builder.add(builder.mul(which, broadcast(points, shorts)), below)
        step = ir.Constant(longs, [4] * VECTOR_WIDTH)
        start = broadcast(builder.ptrtoint(values.data, long), longs)
        low_at = builder.add(start, builder.mul(builder.zext(offset_in_table, longs), step))
        low, high = gather_values(low_at), gather_values(builder.add(low_at, step))
        value = builder.fadd(low, builder.fmul(fraction, builder.fsub(high, low)))
        builder.store(value, lane(arguments[4]), align=4)
        return context.get_dummy_value()

    return types.void(table, state, row_at, position_at, value_at), generate
