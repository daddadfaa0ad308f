"""A realisation of a randomly rough surface z = Ψ(x, y): a sum of plane waves, and its bounds.

Budak & Grimailo 2020, Eq 3: a field of M waves is
σ/√M Σ √(−2 ln α') cos(λ (x cos 2πγ + y sin 2πγ) − 2πα'') with α', α'', γ uniform on (0, 1) and wave
numbers λ drawn from a law; so heights at a point are normally distributed whatever M.  Fields
superpose.  A realisation is an array of waves, rows `AMPLITUDE` (m), `KX`, `KY` (cycles per metre),
`PHASE` (cycles), which makes reducing an argument to one cycle exact.  Columns are sorted by
octaves of the wave number and filled up to a multiple of `N_WAVE_LANES`.

Waves come in bands, the finest of which a march along a ray (`march.py`) need not look at high
above the surface: there they count by their reach alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline, inline_allocating, inline_only
from splits.kernels.math.rng import interpolate_quantile, sample_azimuth, uniform
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.rough_surface.wave_sums import (
    AMPLITUDE,
    KX,
    KY,
    N_WAVE_LANES,
    PHASE,
    TWO_PI,
    WAVE_ROWS,
    sum_waves,
)

EXPONENTIAL_AS_PRINTED, EXPONENTIAL, GAUSSIAN, TABULATED = range(4)
"""Laws of the wave number, see `wave_number_quantile`."""

MAX_BANDS = 8
"""Most bands of a realisation."""
BAND_ROWS = BAND_END, FINER_HEIGHT, MAX_SLOPE, MAX_CURVATURE = tuple(range(4))
"""Rows of the array of bands, see `SurfaceRealization`."""

BOUND_SIGMA = 8.0
"""Bound of a sum of waves in its standard deviations, where the sum of amplitudes is more.

For given waves, of any phases, the chance that a point is beyond is below 2 exp(−8²/2) = 3e-14:
the mean of exp(u cos 2πα) is I0(u) ≤ exp(u²/4) (Chernoff).
"""
_N_OCTAVES = 16
_MAX_FINER_SIGMA = 4.0
"""Waves that reach higher than this many standard deviations of the surface stay in the band."""

_MIN_ONE_MINUS_BETA = 2.0**-40
"""Least 1 − β: laws without end stop at 1e12 k0, which keeps arguments below 2⁵¹ cycles."""


class HeightFields(NamedTuple):
    """Superposed random fields, one entry each.

    Attributes
    ----------
    rms_height : float64[fields]
        σ (m).
    n_waves : int64[fields]
        M.
    law : int64[fields]
        `EXPONENTIAL_AS_PRINTED`, `EXPONENTIAL`, `GAUSSIAN` or `TABULATED`.
    wave_number : float64[fields]
        k0 (1/m); unused with a table.
    band_fraction : float64[fields]
        Share of the law that lies below the band limit; 1 without one.
    quantiles : float64[fields, m]
        Quantile functions of λ (1/m) of fields with a table (`rng.table_probabilities`).
    """

    rms_height: np.ndarray
    n_waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    band_fraction: np.ndarray
    quantiles: np.ndarray


class SurfaceRealization(NamedTuple):
    """A realisation and what is known of it.

    Attributes
    ----------
    waves : float64[4, columns]
        Rows `wave_sums.WAVE_ROWS`.
    bands : float64[4, BANDS]
        A column per band, the finest first.  A band is all waves up to `BAND_END`; `FINER_HEIGHT` (m) is what
        the others reach; `MAX_SLOPE` and `MAX_CURVATURE` (1/m) bound the band along the leg that is being
        marched, see `splits.kernels.rough_surface.intersection`.
    n_bands : int
        Bands that there are.
    max_height : float
        Height (m) above and below the mean surface that no point passes.
    max_slope : float
        Bound of the slopes.
    """

    waves: np.ndarray
    bands: np.ndarray
    n_bands: int
    max_height: float
    max_slope: float


class SurfaceSlope(NamedTuple):
    """∂Ψ/∂x and ∂Ψ/∂y: numbers, or arrays of them."""

    x: float
    y: float


class HeightAndSlope(NamedTuple):
    """Ψ (m) and its slope at a point, or at many."""

    height: float
    slope: SurfaceSlope


@inline
def wave_number_quantile(fields, field, u):
    """Return the quantile `u` of the law of λ below the band limit (1/m).

    `EXPONENTIAL_AS_PRINTED`: λ = k0 β/√(1 − β²), Budak & Grimailo 2020, Eq 3.  `EXPONENTIAL`, whose correlation is
    exp(−k0 r): λ = k0 √(1/(1−β)² − 1).  `GAUSSIAN`, exp(−(k0 r)²): λ = 2 k0 √(−ln(1−β)).
    """
    law = fields.law[field]
    if law == TABULATED:
        return interpolate_quantile(fields.quantiles, field, u)
    k0 = fields.wave_number[field]
    beta = u * fields.band_fraction[field]
    if law == GAUSSIAN:
        return 2.0 * k0 * math.sqrt(-math.log1p(-beta))
    left = max(1.0 - beta, _MIN_ONE_MINUS_BETA)
    if law == EXPONENTIAL_AS_PRINTED:
        return k0 * beta / math.sqrt(left * (1.0 + beta))
    return k0 * math.sqrt(beta * (1.0 + left)) / left


@inline_only
def _compute_octave(waves, column):
    """Return the octave of a wave number: half the binary exponent of its square."""
    return np.float64(waves[KX, column] ** 2 + waves[KY, column] ** 2).view(np.int64) >> 53


@inline_allocating
def _sort_by_octave(unsorted, waves):
    """Copy waves in the order of their octaves, those far below the finest as one."""
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
def count_columns(fields):
    """Return the number of columns that the waves of `fields` take."""
    columns = N_WAVE_LANES - 1
    for waves in fields.n_waves:
        columns += waves
    return columns // N_WAVE_LANES * N_WAVE_LANES


@inline_allocating
def allocate_realization(fields):
    """Return a `SurfaceRealization` that is nothing but room for realisations of `fields`."""
    return wrap_waves(np.empty((len(WAVE_ROWS), count_columns(fields))))


@inline_allocating
def wrap_waves(waves):
    """Return a `SurfaceRealization` of which nothing is known but its waves, if these."""
    return SurfaceRealization(waves, np.zeros((len(BAND_ROWS), MAX_BANDS)), 0, 0.0, 0.0)


@entry_point
def sample_realization(state, fields, buffer):
    """Draw a realisation.

    Parameters
    ----------
    state : uint64[1]
    fields : HeightFields
    buffer : SurfaceRealization
        Where the realisation will live, see `allocate_realization`.

    Returns
    -------
    Surface
    """
    drawn = np.zeros(buffer.waves.shape)
    column = 0
    for field in range(fields.n_waves.size):
        scale = fields.rms_height[field] / math.sqrt(fields.n_waves[field])
        for _ in range(fields.n_waves[field]):
            drawn[AMPLITUDE, column] = scale * math.sqrt(-2.0 * math.log(uniform(state)))
            k = wave_number_quantile(fields, field, uniform(state)) / TWO_PI
            c, s = sample_azimuth(state)
            drawn[KX, column] = k * c
            drawn[KY, column] = k * s
            drawn[PHASE, column] = uniform(state)
            column += 1
    _sort_by_octave(drawn, buffer.waves)
    return compute_bounds(buffer)


@inline_allocating
def sample_realization_if_rough(state, fields, buffer):
    """Return what `sample_realization` does, None where the surface is smooth and has no room."""
    if buffer is None:
        return buffer
    return sample_realization(state, fields, buffer)


@inline_only
def compute_entry_position(d, surface):
    """Return where a ray along d from above begins that aims at the origin of the mean surface."""
    if surface is None:
        return ORIGIN
    return Vector(surface.max_height * d.x / d.z, 0.0, surface.max_height)


@inline_allocating
def compute_bounds(buffer):
    """Return the `SurfaceRealization` of the waves in `buffer`, sorted by octave, with its bands filled in."""
    waves, bands = buffer.waves, buffer.bands
    reach, square, steep = 0.0, 0.0, 0.0
    for i in range(waves.shape[1]):
        a2 = waves[AMPLITUDE, i] ** 2
        reach += waves[AMPLITUDE, i]
        square += a2
        steep += a2 * (waves[KX, i] ** 2 + waves[KY, i] ** 2)
    reach = min(reach, BOUND_SIGMA * math.sqrt(0.5 * square))
    count = _split_bands(waves, bands, _MAX_FINER_SIGMA * math.sqrt(0.5 * square))
    return SurfaceRealization(
        waves, bands, count, reach, BOUND_SIGMA * TWO_PI * math.sqrt(0.5 * steep)
    )


@inline_only
def _split_bands(waves, bands, max_finer_height):
    """Split waves into bands, and return how many.

    Parameters
    ----------
    waves, bands : float64 array
        See `SurfaceRealization`; of bands, `BAND_END` and `FINER_HEIGHT` are set.
    max_finer_height : float
        Height (m): waves that reach higher stay in the band.
    """
    bands[:] = 0.0
    bands[BAND_END, 0] = waves.shape[1]
    count = 1
    finest = _compute_octave(waves, waves.shape[1] - 1)
    rest, rest2 = 0.0, 0.0
    for end in range(waves.shape[1] - N_WAVE_LANES, 0, -N_WAVE_LANES):
        for i in range(end, end + N_WAVE_LANES):
            rest += waves[AMPLITUDE, i]
            rest2 += waves[AMPLITUDE, i] ** 2
        higher = min(rest, BOUND_SIGMA * math.sqrt(0.5 * rest2))
        if higher > max_finer_height or count == MAX_BANDS:
            break
        octave = _compute_octave(waves, end - 1)
        # Half the wave number: a quarter of the curvature, steps of twice the length.
        if octave < finest:
            bands[BAND_END, count] = end
            bands[FINER_HEIGHT, count] = higher
            finest = octave
            count += 1
    return count


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
    found = HeightAndSlope(np.empty(x.size), SurfaceSlope(np.empty(x.size), np.empty(x.size)))
    for i in range(x.size):
        one = compute_height_and_slope(waves, x[i], y[i])
        found.height[i] = one.height
        found.slope.x[i], found.slope.y[i] = one.slope.x, one.slope.y
    return found
