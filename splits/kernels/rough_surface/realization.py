"""Realizations of a randomly rough surface z = Ψ(x, y) as sums of plane waves, and their bounds.

Budak & Grimailo 2020, Eq 3: a field of M waves is
σ/√M Σ √(−2 ln α') cos(λ (x cos 2πγ + y sin 2πγ) − 2πα'') with α', α'', γ uniform on (0, 1) and wave
numbers λ sampled from a distribution; heights at a point are normally distributed for any M.
Fields are superposed.  A realization is an array of waves, rows `AMPLITUDE` (m), `KX`, `KY` (cycles
per metre), `PHASE` (cycles), which makes the reduction of an argument to one cycle exact.  Columns
are sorted by octaves of the wave number and padded to a multiple of `N_WAVE_LANES`.

Waves are grouped in bands.  High above the surface the intersection search (`intersection.py`)
does not evaluate the finest bands: there they enter with their maximum height only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, errors, types
from numba.extending import intrinsic, overload

from splits.kernels.compiler.jit import (
    INLINE_OPTIONS,
    entry_point,
    inline,
    inline_allocating,
    inline_only,
)
from splits.kernels.rng import interpolate_quantile, sample_azimuth, uniform
from splits.kernels.scene import EXPONENTIAL_AS_PRINTED, GAUSSIAN, ORIGIN, TABULATED, Vector

# --------------------------------------------------------------------------------------------------
# Sums over the plane waves of a surface: heights, slopes, and bounds along a ray.
#
# One formula serves plain Python and compiled code, where it evaluates `N_WAVE_LANES` waves at
# once.

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


# --------------------------------------------------------------------------------------------------
# Octaves and bands of the waves of a rough surface.
#
# A band contains all waves up to a wave number, so that the finest band contains all waves.

MAX_BANDS = 8
"""Largest number of bands of a realization."""
BAND_ROWS = BAND_END, FINER_HEIGHT, MAX_SLOPE, MAX_CURVATURE = tuple(range(4))
"""Rows of the array of bands, see `SurfaceRealization`."""
BOUND_SIGMA = 8.0
"""Bound of a sum of waves in standard deviations, used if the sum of amplitudes is larger.

For given waves with random phases, the probability that a point exceeds it is below
2 exp(−8²/2) = 3e-14: the mean of exp(u cos 2πα) is I0(u) ≤ exp(u²/4) (Chernoff).
"""
_N_OCTAVES = 16
"""Octaves that are distinguished, from the finest down."""


@inline_only
def _compute_octave(waves, column):
    """Return the octave of a wave number, half the binary exponent of its square."""
    return np.float64(waves[KX, column] ** 2 + waves[KY, column] ** 2).view(np.int64) >> 53


@inline_allocating
def sort_by_octave(unsorted, waves):
    """Sort waves by octave; those far below the finest octave count as one."""
    columns = waves.shape[1]
    lowest = 0
    for column in range(columns):
        lowest = max(lowest, _compute_octave(unsorted, column) - _N_OCTAVES + 1)
    begin = np.zeros(_N_OCTAVES + 1, dtype=np.int64)
    for column in range(columns):
        begin[max(_compute_octave(unsorted, column) - lowest, 0) + 1] += 1
    for octave in range(_N_OCTAVES):
        begin[octave + 1] += begin[octave]
    for column in range(columns):
        octave = max(_compute_octave(unsorted, column) - lowest, 0)
        for row in WAVE_ROWS:
            waves[row, begin[octave]] = unsorted[row, column]
        begin[octave] += 1


@inline_only
def split_bands(waves, bands, max_finer_height):
    """Split waves into bands, and return the number of bands.

    Parameters
    ----------
    waves, bands : float64 array
        See `SurfaceRealization`; of bands, `BAND_END` and `FINER_HEIGHT` are set.
    max_finer_height : float
        Largest height (m) of the waves outside a band.
    """
    bands[:] = 0.0
    bands[BAND_END, 0] = waves.shape[1]
    n_bands = 1
    finest = _compute_octave(waves, waves.shape[1] - 1)
    finer_height, finer_variance = 0.0, 0.0
    for end in range(waves.shape[1] - N_WAVE_LANES, 0, -N_WAVE_LANES):
        for i in range(end, end + N_WAVE_LANES):
            finer_height += waves[AMPLITUDE, i]
            finer_variance += waves[AMPLITUDE, i] ** 2
        max_height = min(finer_height, BOUND_SIGMA * math.sqrt(0.5 * finer_variance))
        if max_height > max_finer_height or n_bands == MAX_BANDS:
            break
        octave = _compute_octave(waves, end - 1)
        # Half the wave number has a quarter of the curvature and allows steps of twice the length.
        if octave < finest:
            bands[BAND_END, n_bands] = end
            bands[FINER_HEIGHT, n_bands] = max_height
            finest = octave
            n_bands += 1
    return n_bands


# --------------------------------------------------------------------------------------------------
# Realizations of a randomly rough surface z = Ψ(x, y) as sums of plane waves, and their bounds.


_MAX_FINER_SIGMA = 4.0
"""Largest height of the waves outside a band, in standard deviations of the surface."""

_MIN_ONE_MINUS_BETA = 2.0**-40
"""Smallest 1 − β: unbounded distributions are cut off at 1e12 k0, which keeps arguments below 2⁵¹
cycles."""


class SurfaceRealization(NamedTuple):
    """Realization of a rough surface, with its bounds.

    Attributes
    ----------
    waves : float64[4, columns]
        Rows `WAVE_ROWS`.
    bands : float64[4, bands]
        A column per band, the finest first.  A band contains all waves up to `BAND_END`;
        `FINER_HEIGHT` (m) is the maximum height of the other waves; `MAX_SLOPE` and `MAX_CURVATURE`
        (1/m) bound the band along the current path segment, see
        `splits.kernels.rough_surface.intersection`.
    n_bands : int
        Number of bands in use.
    max_height : float
        Bound of the height above and below the mean surface (m).
    max_slope : float
        Bound of the slopes.
    """

    waves: np.ndarray
    bands: np.ndarray
    n_bands: int
    max_height: float
    max_slope: float


class SurfaceSlope(NamedTuple):
    """Slopes ∂Ψ/∂x and ∂Ψ/∂y: numbers or arrays."""

    x: float
    y: float


class HeightAndSlope(NamedTuple):
    """Height Ψ (m) and slope at one or several points."""

    height: float
    slope: SurfaceSlope


@inline
def wave_number_quantile(fields, field, u):
    """Return the quantile `u` of the wave number λ (1/m) below the band limit.

    `EXPONENTIAL_AS_PRINTED`: λ = k0 β/√(1 − β²), Budak & Grimailo 2020, Eq 3.  `EXPONENTIAL`, with
    the correlation exp(−k0 r): λ = k0 √(1/(1−β)² − 1).  `GAUSSIAN`, exp(−(k0 r)²): λ = 2 k0
    √(−ln(1−β)).
    """
    distribution = fields.law[field]
    if distribution == TABULATED:
        return interpolate_quantile(fields.quantiles, field, u)
    k0 = fields.wave_number[field]
    beta = u * fields.band_fraction[field]
    if distribution == GAUSSIAN:
        return 2.0 * k0 * math.sqrt(-math.log1p(-beta))
    one_minus_beta = max(1.0 - beta, _MIN_ONE_MINUS_BETA)
    if distribution == EXPONENTIAL_AS_PRINTED:
        return k0 * beta / math.sqrt(one_minus_beta * (1.0 + beta))
    return k0 * math.sqrt(beta * (1.0 + one_minus_beta)) / one_minus_beta


@inline_only
def count_columns(fields):
    """Return the number of columns of the waves of `fields`."""
    columns = N_WAVE_LANES - 1
    for waves in fields.n_waves:
        columns += waves
    return columns // N_WAVE_LANES * N_WAVE_LANES


@inline_allocating
def allocate_realization(fields):
    """Return an uninitialized `SurfaceRealization` for realizations of `fields`."""
    return wrap_waves(np.empty((len(WAVE_ROWS), count_columns(fields))))


@inline_allocating
def wrap_waves(waves):
    """Return a `SurfaceRealization` with given waves and uninitialized bounds."""
    return SurfaceRealization(waves, np.zeros((len(BAND_ROWS), MAX_BANDS)), 0, 0.0, 0.0)


@entry_point
def sample_realization(state, fields, buffer):
    """Sample a realization.

    Parameters
    ----------
    state : uint64[1]
    fields : HeightFields
    buffer : SurfaceRealization
        Memory of the realization, see `allocate_realization`.

    Returns
    -------
    SurfaceRealization
    """
    unsorted = np.zeros(buffer.waves.shape)
    column = 0
    for field in range(fields.n_waves.size):
        scale = fields.rms_height[field] / math.sqrt(fields.n_waves[field])
        for _ in range(fields.n_waves[field]):
            unsorted[AMPLITUDE, column] = scale * math.sqrt(-2.0 * math.log(uniform(state)))
            k = wave_number_quantile(fields, field, uniform(state)) / TWO_PI
            c, s = sample_azimuth(state)
            unsorted[KX, column] = k * c
            unsorted[KY, column] = k * s
            unsorted[PHASE, column] = uniform(state)
            column += 1
    sort_by_octave(unsorted, buffer.waves)
    return compute_bounds(buffer)


@inline_allocating
def sample_realization_if_rough(state, fields, buffer):
    """Sample a realization; return None if there is no buffer because the surface is smooth."""
    if buffer is None:
        return buffer
    return sample_realization(state, fields, buffer)


@inline_only
def compute_entry_position(d, surface):
    """Return the start of a ray along d, from above, towards the origin of the mean surface."""
    if surface is None:
        return ORIGIN
    return Vector(surface.max_height * d.x / d.z, 0.0, surface.max_height)


@inline_allocating
def compute_bounds(buffer):
    """Return the `SurfaceRealization` of the waves in `buffer`, sorted by octave, with bounds."""
    waves, bands = buffer.waves, buffer.bands
    max_height, variance, mean_square_slope = 0.0, 0.0, 0.0
    for i in range(waves.shape[1]):
        a2 = waves[AMPLITUDE, i] ** 2
        max_height += waves[AMPLITUDE, i]
        variance += a2
        mean_square_slope += a2 * (waves[KX, i] ** 2 + waves[KY, i] ** 2)
    max_height = min(max_height, BOUND_SIGMA * math.sqrt(0.5 * variance))
    n_bands = split_bands(waves, bands, _MAX_FINER_SIGMA * math.sqrt(0.5 * variance))
    return SurfaceRealization(
        waves, bands, n_bands, max_height, BOUND_SIGMA * TWO_PI * math.sqrt(0.5 * mean_square_slope)
    )


@entry_point
def make_realization(waves):
    """Return the `SurfaceRealization` of given waves, float64[4, columns], sorted by octave."""
    return compute_bounds(wrap_waves(waves))


@inline
def compute_height_and_slope(waves, x, y):
    """Return the `HeightAndSlope` at a point (Eq 3)."""
    sums = sum_waves(waves, 0, waves.shape[1], x, y)
    return HeightAndSlope(
        sums.height,
        SurfaceSlope(-2.0 * TWO_PI * sums.scaled_slope_x, -2.0 * TWO_PI * sums.scaled_slope_y),
    )


@entry_point
def compute_heights_and_slopes(waves, x, y):
    """Return the `HeightAndSlope` at the points x, y, float64[points] each."""
    result = HeightAndSlope(np.empty(x.size), SurfaceSlope(np.empty(x.size), np.empty(x.size)))
    for i in range(x.size):
        point = compute_height_and_slope(waves, x[i], y[i])
        result.height[i] = point.height
        result.slope.x[i], result.slope.y[i] = point.slope.x, point.slope.y
    return result
