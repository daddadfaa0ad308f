"""Sums over the plane waves of a surface: heights, slopes, and bounds along a ray.

One formula serves plain Python and compiled code, where it evaluates `N_WAVE_LANES` waves at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, errors, types
from numba.extending import intrinsic, overload

from splits.kernels.compiler.jit import INLINE_OPTIONS

N_WAVE_LANES = 8
"""Waves that are evaluated at once, as the lanes of a vector."""
WAVE_ROWS = AMPLITUDE, KX, KY, PHASE = tuple(range(4))
"""Rows of an array of waves."""

TWO_PI = 2.0 * math.pi
_ROUNDING_SHIFT = 6755399441055744.0
"""1.5 · 2⁵²: adding and subtracting it rounds a double to an integer."""

# sin πr / r and cos πr on |r| ≤ ½ in powers of r², Chebyshev approximations: 2e-16 and 2e-15.
_SINE_COEFFICIENTS = (
    3.1415926535897927, -5.1677127800497855, 2.5501640398618677, -0.599264528825224,
    0.08214587881631043, -0.0073703643265304155, 0.0004659870158043378, -2.113362735205297e-05,
)  # fmt: skip
_COSINE_COEFFICIENTS = (
    1.0, -4.934802200544676, 4.058712126416497, -1.335262768843447, 0.23533063012953284,
    -0.025806888737002202, 0.0019295562724817132, -0.00010456655338748738, 4.149564353942586e-06,
)  # fmt: skip


class WaveSums(NamedTuple):
    """Sums over waves for Ψ and, divided by −4π, for ∂Ψ/∂x and ∂Ψ/∂y; or the factors of each."""

    height: Any
    scaled_slope_x: Any
    scaled_slope_y: Any


class RayBoundSums(NamedTuple):
    """Sums Σ a|q|, Σ (aq)², Σ a q², Σ (a q²)² for q = k·d; or the factors of each."""

    slope: Any
    slope2: Any
    curvature: Any
    curvature2: Any


class _WaveVector:
    """LLVM vector of `N_WAVE_LANES` doubles, with the operators that the formulas use."""

    llvm_type = ir.VectorType(ir.DoubleType(), N_WAVE_LANES)

    def __init__(self, builder: ir.IRBuilder, value: Any) -> None:
        constant = isinstance(value, float)
        self.builder = builder
        self.value = ir.Constant(self.llvm_type, [value] * N_WAVE_LANES) if constant else value

    def _to_values(self, operands: tuple[Any, ...]) -> list[ir.Value]:
        lanes = (
            x if isinstance(x, _WaveVector) else _WaveVector(self.builder, x) for x in operands
        )
        return [self.value, *(x.value for x in lanes)]

    def _emit(self, instruction: str, *operands: Any) -> _WaveVector:
        emit = getattr(self.builder, instruction)
        return _WaveVector(self.builder, emit(*self._to_values(operands)))

    def _call_intrinsic(self, name: str, *operands: Any) -> _WaveVector:
        values = self._to_values(operands)
        function = cgutils.get_or_insert_function(
            self.builder.module,
            ir.FunctionType(self.llvm_type, [self.llvm_type] * len(values)),
            f"llvm.{name}.v{N_WAVE_LANES}f64",
        )
        return _WaveVector(self.builder, self.builder.call(function, values))

    def __add__(self, other: Any) -> _WaveVector:
        return self._emit("fadd", other)

    def __sub__(self, other: Any) -> _WaveVector:
        return self._emit("fsub", other)

    def __mul__(self, other: Any) -> _WaveVector:
        return self._emit("fmul", other)

    def __neg__(self) -> _WaveVector:
        return self._emit("fneg")

    def __abs__(self) -> _WaveVector:
        return self._call_intrinsic("fabs")

    def fma(self, factor: Any, summand: Any) -> _WaveVector:
        return self._call_intrinsic("fmuladd", factor, summand)


def _fma(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c of numbers, arrays or LLVM vectors."""
    return a.fma(b, c) if isinstance(a, _WaveVector) else a * b + c


def _make_wave_sum(formula: Callable[..., Any], sums_type: Any) -> Callable[..., Any]:
    """Return the function (waves, first, end, p, q) that sums a formula over columns of waves.

    The formula takes p, q and the rows of waves, and returns a pair of factors for every sum, as
    the named tuple `sums_type`.  It serves plain Python, with whole rows, and compiled code, with
    vectors of `N_WAVE_LANES` columns.  The vectors are explicit because a compiler must not reorder
    a sum of floats, and would add one wave at a time.
    """

    def plain(waves, first, end, p, q):
        return sums_type(*(float(np.dot(*pair)) for pair in formula(p, q, *waves[:, first:end])))

    count = len(sums_type._fields)

    @intrinsic
    def vectors(typing_context, waves, first, end, p, q):
        if not (isinstance(waves, types.Array) and (waves.ndim, waves.layout) == (2, "C")):
            raise errors.TypingError("waves must be a contiguous array of rows")
        bounds, numbers = [types.intp] * 2, [types.float64] * 2
        signature = types.NamedUniTuple(types.float64, count, sums_type)(waves, *bounds, *numbers)

        def generate(context, builder, signature, arguments):
            array = context.make_array(waves)(context, builder, arguments[0])
            sums = _emit_loop(formula, count, builder, array, *arguments[1:])
            return context.make_tuple(builder, signature.return_type, sums)

        return signature, generate

    @overload(plain, jit_options=INLINE_OPTIONS)
    def _compiled(waves, first, end, p, q):
        return lambda waves, first, end, p, q: vectors(waves, first, end, p, q)

    return plain


def _emit_loop(
    formula: Callable[..., tuple],
    n_sums: int,
    builder: ir.IRBuilder,
    waves: Any,
    first: ir.Value,
    end: ir.Value,
    p: ir.Value,
    q: ir.Value,
) -> list[ir.Value]:
    """Emit the loop over columns and the sums over lanes; return the values of the sums."""
    columns = cgutils.unpack_tuple(builder, waves.shape, 2)[1]
    size, index = columns.type, ir.IntType(32)
    undefined = ir.Constant(_WaveVector.llvm_type, ir.Undefined)
    first_lane = ir.Constant(ir.VectorType(index, N_WAVE_LANES), [0] * N_WAVE_LANES)

    def broadcast(number: ir.Value) -> _WaveVector:
        vector = builder.insert_element(undefined, number, index(0))
        return _WaveVector(builder, builder.shuffle_vector(vector, undefined, first_lane))

    def row(number: int, column: ir.Value) -> _WaveVector:
        pointer = builder.gep(waves.data, [builder.add(builder.mul(columns, size(number)), column)])
        pointer = builder.bitcast(pointer, _WaveVector.llvm_type.as_pointer())
        return _WaveVector(builder, builder.load(pointer, align=8))

    p, q = broadcast(p), broadcast(q)
    sums = [cgutils.alloca_once(builder, _WaveVector.llvm_type) for _ in range(n_sums)]
    for slot in sums:
        builder.store(ir.Constant(_WaveVector.llvm_type, [0.0] * N_WAVE_LANES), slot)
    steps = builder.sdiv(builder.sub(end, first), size(N_WAVE_LANES))
    with cgutils.for_range(builder, steps) as loop:
        column = builder.add(first, builder.mul(loop.index, size(N_WAVE_LANES)))
        pairs = formula(p, q, *(row(number, column) for number in WAVE_ROWS))
        for slot, (left, right) in zip(sums, pairs, strict=True):
            builder.store(left.fma(right, _WaveVector(builder, builder.load(slot))).value, slot)
    totals = []
    for slot in sums:
        total = builder.load(slot)
        parts = [builder.extract_element(total, index(lane)) for lane in range(N_WAVE_LANES)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [builder.fadd(*pair) for pair in zip(parts[:half], parts[half:], strict=True)]
        totals.append(parts[0])
    return totals


def _height_factors(x, y, amplitude, kx, ky, phase):
    """Return the factors of `WaveSums`, with cos 2πt = 1 − 2 sin² πt (Eq 3)."""
    t = _fma(kx, x, _fma(ky, y, -phase))
    r = t - ((t + _ROUNDING_SHIFT) - _ROUNDING_SHIFT)
    square = r * r
    sine = _fma(square, _SINE_COEFFICIENTS[-1], _SINE_COEFFICIENTS[-2])
    for coefficient in _SINE_COEFFICIENTS[-3::-1]:
        sine = _fma(sine, square, coefficient)
    cosine = _fma(square, _COSINE_COEFFICIENTS[-1], _COSINE_COEFFICIENTS[-2])
    for coefficient in _COSINE_COEFFICIENTS[-3::-1]:
        cosine = _fma(cosine, square, coefficient)
    sine = sine * r
    half = amplitude * (sine * cosine)
    return WaveSums((amplitude, _fma(sine * -2.0, sine, 1.0)), (kx, half), (ky, half))


def _bound_factors(dx, dy, amplitude, kx, ky, phase):
    """Return the factors of `RayBoundSums` along d, q = k·d in cycles per metre."""
    q = abs(_fma(kx, dx, ky * dy))
    slope = amplitude * q
    curvature = slope * q
    return RayBoundSums((amplitude, q), (slope, slope), (slope, q), (curvature, curvature))


sum_waves = _make_wave_sum(_height_factors, WaveSums)
sum_ray_bounds = _make_wave_sum(_bound_factors, RayBoundSums)
