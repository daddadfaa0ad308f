"""Sums over the plane waves of a surface: heights, slopes, and bounds along a ray.

One formula serves plain Python and compiled code, where it runs on `LANES` waves side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, errors, types
from numba.extending import intrinsic, overload

from splits.transport.compiling.jit import INSIDE

LANES = 8
"""Waves that are evaluated side by side."""
ROWS = AMPLITUDE, KX, KY, PHASE = tuple(range(4))
"""Rows of an array of waves."""

TURN = 2.0 * math.pi
_ROUND = 6755399441055744.0
"""1.5 · 2⁵²: a double added to it and taken off again is rounded to an integer."""

# sin πr / r and cos πr on |r| ≤ ½ in powers of r², Chebyshev approximations: 2e-16 and 2e-15.
_SINE = (
    3.1415926535897927, -5.1677127800497855, 2.5501640398618677, -0.599264528825224,
    0.08214587881631043, -0.0073703643265304155, 0.0004659870158043378, -2.113362735205297e-05,
)  # fmt: skip
_COSINE = (
    1.0, -4.934802200544676, 4.058712126416497, -1.335262768843447, 0.23533063012953284,
    -0.025806888737002202, 0.0019295562724817132, -0.00010456655338748738, 4.149564353942586e-06,
)  # fmt: skip


class WaveSums(NamedTuple):
    """Σ over waves for Ψ and, per −4π, for ∂Ψ/∂x and ∂Ψ/∂y; or the pair of factors of each."""

    height: Any
    scaled_slope_x: Any
    scaled_slope_y: Any


class LegSums(NamedTuple):
    """Σ a|q|, Σ (aq)², Σ a q², Σ (a q²)² for q = k·d; or the pair of factors of each."""

    slope: Any
    slope2: Any
    curvature: Any
    curvature2: Any


class _Lanes:
    """A vector of `LANES` doubles in LLVM's hands, with the operators that formulas use."""

    llvm_type = ir.VectorType(ir.DoubleType(), LANES)

    def __init__(self, builder: ir.IRBuilder, value: Any) -> None:
        constant = isinstance(value, float)
        self.builder = builder
        self.value = ir.Constant(self.llvm_type, [value] * LANES) if constant else value

    def _to_values(self, operands: tuple[Any, ...]) -> list[ir.Value]:
        lanes = (x if isinstance(x, _Lanes) else _Lanes(self.builder, x) for x in operands)
        return [self.value, *(x.value for x in lanes)]

    def _emit(self, instruction: str, *operands: Any) -> _Lanes:
        emit = getattr(self.builder, instruction)
        return _Lanes(self.builder, emit(*self._to_values(operands)))

    def _call_intrinsic(self, name: str, *operands: Any) -> _Lanes:
        values = self._to_values(operands)
        function = cgutils.get_or_insert_function(
            self.builder.module,
            ir.FunctionType(self.llvm_type, [self.llvm_type] * len(values)),
            f"llvm.{name}.v{LANES}f64",
        )
        return _Lanes(self.builder, self.builder.call(function, values))

    def __add__(self, other: Any) -> _Lanes:
        return self._emit("fadd", other)

    def __sub__(self, other: Any) -> _Lanes:
        return self._emit("fsub", other)

    def __mul__(self, other: Any) -> _Lanes:
        return self._emit("fmul", other)

    def __neg__(self) -> _Lanes:
        return self._emit("fneg")

    def __abs__(self) -> _Lanes:
        return self._call_intrinsic("fabs")

    def fma(self, factor: Any, summand: Any) -> _Lanes:
        return self._call_intrinsic("fmuladd", factor, summand)


def _fused(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, of vectors as `arithmetic.fused` does of numbers."""
    return a.fma(b, c) if isinstance(a, _Lanes) else a * b + c


def _summed(formula: Callable[..., Any], sums_type: Any) -> Callable[..., Any]:
    """Return the function (waves, first, end, p, q) that sums a formula over columns of waves.

    The formula takes p, q and the rows of waves, and returns for every sum a pair of factors, in a
    named tuple of the given kind, as the sums are.  It serves plain Python, with whole rows, and
    compiled code, with vectors of `LANES` columns: left to itself the compiler would add wave after
    wave, as another order is another sum.
    """

    def plain(waves, first, end, p, q):
        return sums_type(*(float(np.dot(*pair)) for pair in formula(p, q, *waves[:, first:end])))

    count = len(sums_type._fields)

    @intrinsic
    def vectors(typing_context, waves, first, end, p, q):
        if not (isinstance(waves, types.Array) and (waves.ndim, waves.layout) == (2, "C")):
            raise errors.TypingError("waves must be a contiguous array of rows")
        ends, numbers = [types.intp] * 2, [types.float64] * 2
        signature = types.NamedUniTuple(types.float64, count, sums_type)(waves, *ends, *numbers)

        def generate(context, builder, signature, arguments):
            array = context.make_array(waves)(context, builder, arguments[0])
            sums = _loop(formula, count, builder, array, *arguments[1:])
            return context.make_tuple(builder, signature.return_type, sums)

        return signature, generate

    @overload(plain, jit_options=INSIDE)
    def _compiled(waves, first, end, p, q):
        return lambda waves, first, end, p, q: vectors(waves, first, end, p, q)

    return plain


def _loop(
    formula: Callable[..., tuple],
    n_sums: int,
    builder: ir.IRBuilder,
    waves: Any,
    first: ir.Value,
    end: ir.Value,
    p: ir.Value,
    q: ir.Value,
) -> list[ir.Value]:
    """Write the loop over columns and the sums over lanes; return the values of the sums."""
    columns = cgutils.unpack_tuple(builder, waves.shape, 2)[1]
    size, index = columns.type, ir.IntType(32)
    undefined = ir.Constant(_Lanes.llvm_type, ir.Undefined)
    everywhere = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)

    def spread(number: ir.Value) -> _Lanes:
        one = builder.insert_element(undefined, number, index(0))
        return _Lanes(builder, builder.shuffle_vector(one, undefined, everywhere))

    def row(number: int, column: ir.Value) -> _Lanes:
        place = builder.gep(waves.data, [builder.add(builder.mul(columns, size(number)), column)])
        place = builder.bitcast(place, _Lanes.llvm_type.as_pointer())
        return _Lanes(builder, builder.load(place, align=8))

    p, q = spread(p), spread(q)
    sums = [cgutils.alloca_once(builder, _Lanes.llvm_type) for _ in range(n_sums)]
    for place in sums:
        builder.store(ir.Constant(_Lanes.llvm_type, [0.0] * LANES), place)
    steps = builder.sdiv(builder.sub(end, first), size(LANES))
    with cgutils.for_range(builder, steps) as loop:
        column = builder.add(first, builder.mul(loop.index, size(LANES)))
        pairs = formula(p, q, *(row(number, column) for number in ROWS))
        for place, (left, right) in zip(sums, pairs, strict=True):
            builder.store(left.fma(right, _Lanes(builder, builder.load(place))).value, place)
    found = []
    for place in sums:
        total = builder.load(place)
        parts = [builder.extract_element(total, index(lane)) for lane in range(LANES)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [builder.fadd(*pair) for pair in zip(parts[:half], parts[half:], strict=True)]
        found.append(parts[0])
    return found


def _wave(x, y, amplitude, kx, ky, phase):
    """Factors of Ψ and of ∂Ψ/∂x, ∂Ψ/∂y per −4π, with cos 2πt = 1 − 2 sin² πt (Eq 3)."""
    t = _fused(kx, x, _fused(ky, y, -phase))
    r = t - ((t + _ROUND) - _ROUND)
    square = r * r
    sine = _fused(square, _SINE[-1], _SINE[-2])
    for coefficient in _SINE[-3::-1]:
        sine = _fused(sine, square, coefficient)
    cosine = _fused(square, _COSINE[-1], _COSINE[-2])
    for coefficient in _COSINE[-3::-1]:
        cosine = _fused(cosine, square, coefficient)
    sine = sine * r
    half = amplitude * (sine * cosine)
    return WaveSums((amplitude, _fused(sine * -2.0, sine, 1.0)), (kx, half), (ky, half))


def _along(dx, dy, amplitude, kx, ky, phase):
    """Factors of the bounds along d, q = k·d in cycles per metre."""
    q = abs(_fused(kx, dx, ky * dy))
    slope = amplitude * q
    curvature = slope * q
    return LegSums((amplitude, q), (slope, slope), (slope, q), (curvature, curvature))


wave_sums = _summed(_wave, WaveSums)
sums_along = _summed(_along, LegSums)
