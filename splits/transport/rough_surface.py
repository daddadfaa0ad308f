"""A randomly rough surface z = Ψ(x, y), a sum of plane waves, and where rays cross it.

Budak & Grimailo 2020, Eq 3: a field of M waves is
σ/√M Σ √(−2 ln α') cos(λ (x cos 2πγ + y sin 2πγ) − 2πα'') with α', α'', γ uniform on (0, 1) and wave
numbers λ drawn from a law; so heights at a point are normally distributed whatever M.  Fields
superpose.  A realisation is an array of waves, rows `AMPLITUDE` (m), `KX`, `KY` (cycles per metre),
`PHASE` (cycles), which makes reducing an argument to one cycle exact.  Columns are sorted by
octaves of the wave number and filled up to a multiple of `LANES`.

Rays are marched, by steps that bounds on slope and curvature along the ray prove to be free of
crossings.  On surfaces of many scales it is the finest waves that keep steps short; so waves come
in bands, and at some height above the surface the finer ones count by their reach alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, errors, types
from numba.extending import intrinsic, overload

from splits.transport.frames import cosine_lobe, dot, mirrored, normalized
from splits.transport.fresnel import interface, refracted
from splits.transport.jit import ALIKE, entry, kernel
from splits.transport.rng import from_table, start_stream, uniform, unit_circle

LANES = 8
"""Waves that are evaluated side by side."""
AMPLITUDE, KX, KY, PHASE = range(4)
"""Rows of an array of waves."""

PRINTED, EXPONENTIAL, GAUSSIAN, TABLE = range(4)
"""Laws of the wave number, see `wave_number`."""

BANDS = 8
"""Most bands of a realisation."""
_END, _REST, _SLOPE, _CURVATURE, _REALISATION = range(5)
BOUNDS_SHAPE = (5, BANDS)
"""Shape of the array `bounds`: what is known of a realisation and of the leg being marched.

One column per band, the finest first.  A band is all waves up to `_END`; `_REST` is what the others
reach, `_SLOPE` and `_CURVATURE` bound the band along the leg.  The last row has numbers of the
realisation: how many bands, its reach, a bound of its slopes, and a count of evaluations.
"""
_COUNT, _REACH, _STEEPEST, _EVALUATIONS = range(4)

EXTREME = 8.0
"""Bound of a sum of waves in its standard deviations, where the sum of amplitudes is more.

For given waves, of any phases, the chance that a point is beyond is below 2 exp(−8²/2) = 3e-14:
the mean of exp(u cos 2πα) is I0(u) ≤ exp(u²/4) (Chernoff).
"""
_OCTAVES = 16
_USELESS = 4.0
"""Waves that reach higher than this many standard deviations of the surface stay in the band."""

GONE = -1.0
"""No crossing: the ray leaves the surface for good."""
LOST = -2.0
"""Neither a crossing nor an end after `MOST_STEPS`, as for rays that stay level."""
MOST_STEPS = 100_000_000
GRAZING = 1e-12
"""Least cosine between a direction and the facet that it leaves."""

_TURN = 2.0 * math.pi
_ROUND = 6755399441055744.0
"""1.5 · 2⁵²: a double added to it and taken off again is rounded to an integer."""
_LEAST = 2.0**-40
"""Least 1 − β: laws without end stop at 1e12 k0, which keeps arguments below 2⁵¹ cycles."""

# sin πr / r and cos πr on |r| ≤ ½ in powers of r², Chebyshev approximations: 2e-16 and 2e-15.
_SINE = (
    3.1415926535897927, -5.1677127800497855, 2.5501640398618677, -0.599264528825224,
    0.08214587881631043, -0.0073703643265304155, 0.0004659870158043378, -2.113362735205297e-05,
)  # fmt: skip
_COSINE = (
    1.0, -4.934802200544676, 4.058712126416497, -1.335262768843447, 0.23533063012953284,
    -0.025806888737002202, 0.0019295562724817132, -0.00010456655338748738, 4.149564353942586e-06,
)  # fmt: skip


class Fields(NamedTuple):
    """Superposed random fields, one entry each.

    Attributes
    ----------
    rms_height : float64[fields]
        σ (m).
    waves : int64[fields]
        M.
    law : int64[fields]
        `PRINTED`, `EXPONENTIAL`, `GAUSSIAN` or `TABLE`.
    wave_number : float64[fields]
        k0 (1/m); unused with a table.
    share : float64[fields]
        Share of the law that lies below the band limit; 1 without one.
    quantile : float64[fields, m]
        Quantile functions of λ (1/m) of fields with a table (`rng.table_probabilities`).
    """

    rms_height: np.ndarray
    waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    share: np.ndarray
    quantile: np.ndarray


# --- sums over waves --------------------------------------------------------------------------


class _Lanes:
    """A vector of `LANES` doubles in LLVM's hands, with the operators that formulas use."""

    kind = ir.VectorType(ir.DoubleType(), LANES)

    def __init__(self, builder: ir.IRBuilder, value: Any) -> None:
        constant = isinstance(value, float)
        self.builder = builder
        self.value = ir.Constant(self.kind, [value] * LANES) if constant else value

    def _values(self, operands: tuple[Any, ...]) -> list[ir.Value]:
        lanes = (x if isinstance(x, _Lanes) else _Lanes(self.builder, x) for x in operands)
        return [self.value, *(x.value for x in lanes)]

    def _with(self, instruction: str, *operands: Any) -> _Lanes:
        emit = getattr(self.builder, instruction)
        return _Lanes(self.builder, emit(*self._values(operands)))

    def _called(self, name: str, *operands: Any) -> _Lanes:
        values = self._values(operands)
        function = cgutils.get_or_insert_function(
            self.builder.module,
            ir.FunctionType(self.kind, [self.kind] * len(values)),
            f"llvm.{name}.v{LANES}f64",
        )
        return _Lanes(self.builder, self.builder.call(function, values))

    def __add__(self, other: Any) -> _Lanes:
        return self._with("fadd", other)

    def __sub__(self, other: Any) -> _Lanes:
        return self._with("fsub", other)

    def __mul__(self, other: Any) -> _Lanes:
        return self._with("fmul", other)

    def __neg__(self) -> _Lanes:
        return self._with("fneg")

    def __abs__(self) -> _Lanes:
        return self._called("fabs")

    def fused(self, factor: Any, summand: Any) -> _Lanes:
        return self._called("fmuladd", factor, summand)


def _fused(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, of vectors as `arithmetic.fused` does of numbers."""
    return a.fused(b, c) if isinstance(a, _Lanes) else a * b + c


def _summed(formula: Callable[..., tuple]) -> Callable[..., tuple[float, ...]]:
    """Return the function (waves, first, end, p, q) that sums a formula over columns of waves.

    The formula takes p, q and the rows of waves, and returns for every sum a pair of factors.  It
    serves plain Python, with whole rows, and compiled code, with vectors of `LANES` columns: left
    to itself the compiler would add wave after wave, as another order is another sum.
    """

    def plain(waves, first, end, p, q):
        return tuple(float(np.dot(*pair)) for pair in formula(p, q, *waves[:, first:end]))

    count = len(formula(*[0.0] * 6))

    @intrinsic
    def vectors(typing_context, waves, first, end, p, q):
        if not (isinstance(waves, types.Array) and (waves.ndim, waves.layout) == (2, "C")):
            raise errors.TypingError("waves must be a contiguous array of rows")
        ends, numbers = [types.intp] * 2, [types.float64] * 2
        signature = types.UniTuple(types.float64, count)(waves, *ends, *numbers)

        def generate(context, builder, signature, arguments):
            array = context.make_array(waves)(context, builder, arguments[0])
            sums = _loop(formula, count, builder, array, *arguments[1:])
            return context.make_tuple(builder, signature.return_type, sums)

        return signature, generate

    @overload(plain, jit_options=ALIKE)
    def _compiled(waves, first, end, p, q):
        return lambda waves, first, end, p, q: vectors(waves, first, end, p, q)

    return plain


def _loop(
    formula: Callable[..., tuple],
    count: int,
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
    undefined = ir.Constant(_Lanes.kind, ir.Undefined)
    everywhere = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)

    def spread(number: ir.Value) -> _Lanes:
        one = builder.insert_element(undefined, number, index(0))
        return _Lanes(builder, builder.shuffle_vector(one, undefined, everywhere))

    def row(number: int, column: ir.Value) -> _Lanes:
        place = builder.gep(waves.data, [builder.add(builder.mul(columns, size(number)), column)])
        place = builder.bitcast(place, _Lanes.kind.as_pointer())
        return _Lanes(builder, builder.load(place, align=8))

    p, q = spread(p), spread(q)
    sums = [cgutils.alloca_once(builder, _Lanes.kind) for _ in range(count)]
    for place in sums:
        builder.store(ir.Constant(_Lanes.kind, [0.0] * LANES), place)
    steps = builder.sdiv(builder.sub(end, first), size(LANES))
    with cgutils.for_range(builder, steps) as loop:
        column = builder.add(first, builder.mul(loop.index, size(LANES)))
        pairs = formula(p, q, *(row(number, column) for number in range(4)))
        for place, (left, right) in zip(sums, pairs, strict=True):
            builder.store(left.fused(right, _Lanes(builder, builder.load(place))).value, place)
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
    return (amplitude, _fused(sine * -2.0, sine, 1.0)), (kx, half), (ky, half)


def _along(dx, dy, amplitude, kx, ky, phase):
    """Factors of Σ a|q|, Σ (aq)², Σ a q², Σ (a q²)² for q = k·d in cycles per metre."""
    q = abs(_fused(kx, dx, ky * dy))
    slope = amplitude * q
    curvature = slope * q
    return (amplitude, q), (slope, slope), (slope, q), (curvature, curvature)


_wave_sums = _summed(_wave)
_sums_along = _summed(_along)


# --- realisations -----------------------------------------------------------------------------


@kernel
def wave_number(fields, field, u):
    """Return the quantile `u` of the law of λ below the band limit (1/m).

    `PRINTED`: λ = k0 β/√(1 − β²), Budak & Grimailo 2020, Eq 3.  `EXPONENTIAL`, whose correlation is
    exp(−k0 r): λ = k0 √(1/(1−β)² − 1).  `GAUSSIAN`, exp(−(k0 r)²): λ = 2 k0 √(−ln(1−β)).
    """
    law = fields.law[field]
    if law == TABLE:
        return from_table(fields.quantile, field, u)
    k0 = fields.wave_number[field]
    beta = u * fields.share[field]
    if law == GAUSSIAN:
        return 2.0 * k0 * math.sqrt(-math.log1p(-beta))
    left = max(1.0 - beta, _LEAST)
    if law == PRINTED:
        return k0 * beta / math.sqrt(left * (1.0 + beta))
    return k0 * math.sqrt(beta * (1.0 + left)) / left


@kernel
def _octave(waves, column):
    """Return the octave of a wave number: half the binary exponent of its square."""
    return np.float64(waves[KX, column] ** 2 + waves[KY, column] ** 2).view(np.int64) >> 53


@kernel
def _sort(drawn, waves):
    """Copy waves in the order of their octaves, those far below the finest as one."""
    columns = waves.shape[1]
    lowest = 0
    for column in range(columns):
        lowest = max(lowest, _octave(drawn, column) - _OCTAVES + 1)
    begin = np.zeros(_OCTAVES + 1, dtype=np.int64)
    for column in range(columns):
        begin[max(_octave(drawn, column) - lowest, 0) + 1] += 1
    for octave in range(_OCTAVES):
        begin[octave + 1] += begin[octave]
    for column in range(columns):
        octave = max(_octave(drawn, column) - lowest, 0)
        for row in range(4):
            waves[row, begin[octave]] = drawn[row, column]
        begin[octave] += 1


@kernel
def columns_for(fields):
    """Return the number of columns that the waves of `fields` take."""
    columns = LANES - 1
    for waves in fields.waves:
        columns += waves
    return columns // LANES * LANES


@entry
def draw_waves(state, fields, waves, bounds):
    """Draw a realisation.

    Parameters
    ----------
    state : uint64[1]
    fields : Fields
    waves : float64[4, columns]
        Filled; see `columns_for`.
    bounds : float64[BOUNDS_SHAPE]
        Filled with what is known of the realisation.

    Returns
    -------
    low, high : float
        Heights (m) that no point of this realisation passes.
    """
    drawn = np.zeros(waves.shape)
    column = 0
    for field in range(fields.waves.size):
        scale = fields.rms_height[field] / math.sqrt(fields.waves[field])
        for _ in range(fields.waves[field]):
            drawn[AMPLITUDE, column] = scale * math.sqrt(-2.0 * math.log(uniform(state)))
            k = wave_number(fields, field, uniform(state)) / _TURN
            c, s = unit_circle(state)
            drawn[KX, column] = k * c
            drawn[KY, column] = k * s
            drawn[PHASE, column] = uniform(state)
            column += 1
    _sort(drawn, waves)
    return set_bounds(waves, bounds)


@kernel
def set_bounds(waves, bounds):
    """Fill `bounds` for waves sorted by octave; return what `draw_waves` does."""
    columns = waves.shape[1]
    reach, square, steep = 0.0, 0.0, 0.0
    for i in range(columns):
        a2 = waves[AMPLITUDE, i] ** 2
        reach += waves[AMPLITUDE, i]
        square += a2
        steep += a2 * (waves[KX, i] ** 2 + waves[KY, i] ** 2)
    reach = min(reach, EXTREME * math.sqrt(0.5 * square))
    bounds[:] = 0.0
    bounds[_END, 0] = columns
    count = 1
    finest = _octave(waves, columns - 1)
    rest, rest2 = 0.0, 0.0
    for end in range(columns - LANES, 0, -LANES):
        for i in range(end, end + LANES):
            rest += waves[AMPLITUDE, i]
            rest2 += waves[AMPLITUDE, i] ** 2
        higher = min(rest, EXTREME * math.sqrt(0.5 * rest2))
        if higher > _USELESS * math.sqrt(0.5 * square) or count == BANDS:
            break
        octave = _octave(waves, end - 1)
        # Half the wave number: a quarter of the curvature, steps of twice the length.
        if octave < finest:
            bounds[_END, count] = end
            bounds[_REST, count] = higher
            finest = octave
            count += 1
    bounds[_REALISATION, _COUNT] = count
    bounds[_REALISATION, _REACH] = reach
    bounds[_REALISATION, _STEEPEST] = EXTREME * _TURN * math.sqrt(0.5 * steep)
    return -reach, reach


@kernel
def height_and_slope(waves, x, y):
    """Return Ψ, ∂Ψ/∂x and ∂Ψ/∂y at a point (Eq 3)."""
    height, u, v = _wave_sums(waves, 0, waves.shape[1], x, y)
    return height, -2.0 * _TURN * u, -2.0 * _TURN * v


@entry
def heights_and_slopes(waves, x, y):
    """Return `height_and_slope` at the points x, y, float64[3, points]."""
    found = np.empty((3, x.size))
    for i in range(x.size):
        found[0, i], found[1, i], found[2, i] = height_and_slope(waves, x[i], y[i])
    return found


# --- rays -------------------------------------------------------------------------------------


@kernel
def normal_of(slope_x, slope_y):
    """Return the upward unit normal of a facet with these slopes."""
    return normalized(-slope_x, -slope_y, 1.0)


@kernel
def cleared(dx, dy, dz, nx, ny, nz):
    """Return the direction d that leaves a facet to the side of n, turned off it if need be.

    Rounding may leave a grazing direction on the wrong side.  The march takes the same slopes and
    hence sees the ray go off the surface too: the cosine kept is far above their rounding.
    """
    lift = GRAZING - dot(dx, dy, dz, nx, ny, nz)
    if lift > 0.0:
        lift += GRAZING
        return normalized(dx + lift * nx, dy + lift * ny, dz + lift * nz)
    return dx, dy, dz


@kernel
def tolerance(bounds, x, y, s):
    """Return the height (m) below which a ray that comes down has hit, after s metres to (x, y).

    Above the rounding of heights, and of positions along steep surfaces far from the origin.  The
    march takes no height for less, which keeps its steps from vanishing.
    """
    numbers = bounds[_REALISATION]
    far = abs(x) + abs(y) + s
    return 1e-12 * numbers[_REACH] + 1e-15 * far * (1.0 + numbers[_STEEPEST])


@kernel
def set_leg(waves, bounds, dx, dy):
    """Bound slope and curvature along a direction, for every band."""
    total, total2, curved, curved2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    for band in range(int(bounds[_REALISATION, _COUNT]) - 1, -1, -1):
        end = int(bounds[_END, band])
        slope, slope2, curvature, curvature2 = _sums_along(waves, begin, end, dx, dy)
        total += slope
        total2 += slope2
        curved += curvature
        curved2 += curvature2
        bounds[_SLOPE, band] = _TURN * min(total, EXTREME * math.sqrt(0.5 * total2))
        bounds[_CURVATURE, band] = _TURN**2 * min(curved, EXTREME * math.sqrt(0.5 * curved2))
        begin = end


@kernel
def safe_step(gap, rate, slope, curvature, climb):
    """Return how far a ray gets without meeting the surface, inf if it never will.

    Parameters
    ----------
    gap, rate : float
        Height above the surface, G > 0, and its change G' per metre.
    slope, curvature : float
        Bounds along the ray.
    climb : float
        Vertical part of the direction, away from the surface.
    """
    fall = slope - climb
    if fall <= 0.0:
        return math.inf
    # G + G's − C s²/2 = 0, without cancellation.
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate > 0.0:
        bent = (rate + root) / max(curvature, 1e-300)
    else:
        bent = 2.0 * gap / max(root - rate, 1e-300)
    return max(bent, gap / fall)


@entry
def first_crossing(waves, bounds, x, y, z, dx, dy, dz, side, low, high, farthest=math.inf):
    """Return where a ray first meets the surface.

    A ray that is G above the surface, while G changes by G' per metre, cannot meet it within
    `safe_step`; near a crossing these steps converge like Newton's, and from the ray's side.  All
    that is missed are dips below the surface by less than `tolerance`, and what lies beyond
    `EXTREME`.  A ray that stands on the surface must leave it, see `cleared`.

    Parameters
    ----------
    waves, bounds : arrays
        A realisation, see `draw_waves`.
    x, y, z : float
        Beginning of the ray.
    dx, dy, dz : float
        Its direction.
    side : float
        1 above the surface, −1 below.
    low, high : float
        Heights that the surface does not pass.
    farthest : float
        Distance beyond which crossings do not matter.

    Returns
    -------
    distance : float
        Metres; `GONE` or `LOST` if there is no crossing, or none that matters.
    slope_x, slope_y : float
        Slopes of the surface there.
    """
    climb = side * dz
    edge = high if side > 0.0 else -low
    s = 0.0
    if side * z > edge:
        if climb >= 0.0:
            return GONE, 0.0, 0.0
        s = (side * z - edge) / -climb
        if s > farthest:
            return GONE, 0.0, 0.0
    set_leg(waves, bounds, dx, dy)
    bands = int(bounds[_REALISATION, _COUNT])
    for _ in range(MOST_STEPS):
        at_x, at_y, at_z = x + s * dx, y + s * dy, z + s * dz
        if climb >= 0.0 and side * at_z > edge:
            return GONE, 0.0, 0.0
        bounds[_REALISATION, _EVALUATIONS] += 1.0
        height, slope_x, slope_y, step = 0.0, 0.0, 0.0, 0.0
        begin = 0
        for band in range(bands - 1, -1, -1):
            end = int(bounds[_END, band])
            more, u, v = _wave_sums(waves, begin, end, at_x, at_y)
            begin = end
            height += more
            slope_x -= 2.0 * _TURN * u
            slope_y -= 2.0 * _TURN * v
            gap = side * (at_z - height) - bounds[_REST, band]
            rate = side * (dz - slope_x * dx - slope_y * dy)
            if band == 0:
                little = tolerance(bounds, at_x, at_y, s)
                if gap <= little and rate < 0.0:
                    return s, slope_x, slope_y
                gap = max(gap, little)
            if gap > 0.0:
                free = safe_step(gap, rate, bounds[_SLOPE, band], bounds[_CURVATURE, band], climb)
                step = max(step, free)
                if gap > bounds[_REST, band]:
                    break
        s += step
        if s > farthest or s == math.inf:
            return GONE, 0.0, 0.0
    return LOST, 0.0, 0.0


# --- crossings to count -----------------------------------------------------------------------

MOST_HITS = 50
CROSSINGS, LEAKS, LOSSES, LEGS, EVALUATIONS = range(5)


@kernel
def _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, length):
    """Return how many of four points of a leg are on the wrong side of the surface."""
    found = 0
    for i in range(4):
        # Three anywhere, and one where a step too long at the end of the march would show.
        s = length * (uniform(state) if i else 1.0 - 1e-9)
        px, py, pz = x + s * dx, y + s * dy, z + s * dz
        height, _, _ = height_and_slope(waves, px, py)
        if side * (pz - height) < -4.0 * tolerance(bounds, px, py, s):
            found += 1
    return found


@entry
def crossings(seed, first, rays, fields, index, cos_incidence):
    """Send rays through surfaces of their own and count what must not be.

    Every ray comes from above, and is reflected or refracted at the facets that it meets until it
    leaves upwards or has had `MOST_HITS`.  One that leaves downwards comes back from below, as
    diffuse light does.

    Parameters
    ----------
    seed, first, rays : int
        Streams of the rays.
    fields : Fields
    index : float
        Refractive index below the surface, with 1 above.
    cos_incidence : float

    Returns
    -------
    counts : int64[5]
        `CROSSINGS`; `LEAKS`, points of legs that are on the wrong side of the surface; `LOSSES`,
        rays that were lost; `LEGS`; `EVALUATIONS` of the surface in the search for crossings.
    hits : int64[MOST_HITS + 1]
        Rays by the number of their hits.
    """
    counts = np.zeros(5, dtype=np.int64)
    hits = np.zeros(MOST_HITS + 1, dtype=np.int64)
    state = np.zeros(1, dtype=np.uint64)
    waves = np.empty((4, columns_for(fields)))
    bounds = np.empty(BOUNDS_SHAPE)
    for ray in range(first, first + rays):
        start_stream(state, seed, 0, ray)
        low, high = draw_waves(state, fields, waves, bounds)
        side = 1.0
        x, y, z = 0.0, 0.0, high
        dx, dy, dz = math.sqrt(1.0 - cos_incidence * cos_incidence), 0.0, -cos_incidence
        hit = 0
        while hit < MOST_HITS:
            s, slope_x, slope_y = first_crossing(
                waves, bounds, x, y, z, dx, dy, dz, side, low, high
            )
            counts[LEGS] += 1
            if s == LOST:
                counts[LOSSES] += 1
                break
            if s == GONE:
                rest = high - side * z
                if rest > 0.0 and side * dz > 0.0:
                    s = rest / (side * dz)
                    counts[LEAKS] += _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, s)
                if side > 0.0:
                    break
                dx, dy, dz = cosine_lobe(state, 0.0, 0.0, 1.0)
                z = 2.0 * low
                continue
            counts[LEAKS] += _leaks(state, waves, bounds, x, y, z, dx, dy, dz, side, s)
            x, y, z = x + s * dx, y + s * dy, z + s * dz
            hit += 1
            nx, ny, nz = normal_of(slope_x, slope_y)
            nx, ny, nz = side * nx, side * ny, side * nz
            cos_i = max(-dot(dx, dy, dz, nx, ny, nz), GRAZING)
            n1, n2 = (1.0, index) if side > 0.0 else (index, 1.0)
            reflectance, ratio, cos_t = interface(n1, n2, 0.0, cos_i)
            if uniform(state) < reflectance:
                dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
                dx, dy, dz = cleared(dx, dy, dz, nx, ny, nz)
            else:
                dx, dy, dz = refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t)
                dx, dy, dz = cleared(dx, dy, dz, -nx, -ny, -nz)
                side = -side
        counts[CROSSINGS] += hit
        hits[hit] += 1
        counts[EVALUATIONS] += int(bounds[_REALISATION, _EVALUATIONS])
    return counts, hits
