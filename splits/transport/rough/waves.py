"""A realisation of a randomly rough surface z = Ψ(x, y): a sum of plane waves, and its bounds.

Budak & Grimailo 2020, Eq 3: a field of M waves is
σ/√M Σ √(−2 ln α') cos(λ (x cos 2πγ + y sin 2πγ) − 2πα'') with α', α'', γ uniform on (0, 1) and wave
numbers λ drawn from a law; so heights at a point are normally distributed whatever M.  Fields
superpose.  A realisation is an array of waves, rows `AMPLITUDE` (m), `KX`, `KY` (cycles per metre),
`PHASE` (cycles), which makes reducing an argument to one cycle exact.  Columns are sorted by
octaves of the wave number and filled up to a multiple of `LANES`.

Waves come in bands, the finest of which a march along a ray (`march.py`) need not look at high
above the surface: there they count by their reach alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import entry, kernel, owner, part
from splits.transport.numerics.rng import from_table, uniform, unit_circle
from splits.transport.numerics.vectors import ORIGIN, Vector
from splits.transport.rough.wave_sums import AMPLITUDE, KX, KY, LANES, PHASE, ROWS, TURN, wave_sums

PRINTED, EXPONENTIAL, GAUSSIAN, TABLE = range(4)
"""Laws of the wave number, see `wave_number`."""

BANDS = 8
"""Most bands of a realisation."""
BAND_ROWS = END, REST, SLOPE, CURVATURE = tuple(range(4))
"""Rows of the array of bands, see `Surface`."""

EXTREME = 8.0
"""Bound of a sum of waves in its standard deviations, where the sum of amplitudes is more.

For given waves, of any phases, the chance that a point is beyond is below 2 exp(−8²/2) = 3e-14:
the mean of exp(u cos 2πα) is I0(u) ≤ exp(u²/4) (Chernoff).
"""
_OCTAVES = 16
_USELESS = 4.0
"""Waves that reach higher than this many standard deviations of the surface stay in the band."""

_LEAST = 2.0**-40
"""Least 1 − β: laws without end stop at 1e12 k0, which keeps arguments below 2⁵¹ cycles."""


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
    n_waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    band_fraction: np.ndarray
    quantiles: np.ndarray


class Surface(NamedTuple):
    """A realisation and what is known of it.

    Attributes
    ----------
    waves : float64[4, columns]
        Rows `wave_sums.ROWS`.
    bands : float64[4, BANDS]
        A column per band, the finest first.  A band is all waves up to `END`; `REST` (m) is what
        the others reach; `SLOPE` and `CURVATURE` (1/m) bound the band along the leg that is being
        marched, see `splits.transport.rough.march`.
    used : int
        Bands that there are.
    reach : float
        Height (m) above and below the mean surface that no point passes.
    steepest : float
        Bound of the slopes.
    """

    waves: np.ndarray
    bands: np.ndarray
    n_bands: int
    max_height: float
    max_slope: float


class Slope(NamedTuple):
    """∂Ψ/∂x and ∂Ψ/∂y: numbers, or arrays of them."""

    x: float
    y: float


class Relief(NamedTuple):
    """Ψ (m) and its slope at a point, or at many."""

    height: float
    slope: Slope


@kernel
def wave_number(fields, field, u):
    """Return the quantile `u` of the law of λ below the band limit (1/m).

    `PRINTED`: λ = k0 β/√(1 − β²), Budak & Grimailo 2020, Eq 3.  `EXPONENTIAL`, whose correlation is
    exp(−k0 r): λ = k0 √(1/(1−β)² − 1).  `GAUSSIAN`, exp(−(k0 r)²): λ = 2 k0 √(−ln(1−β)).
    """
    law = fields.law[field]
    if law == TABLE:
        return from_table(fields.quantiles, field, u)
    k0 = fields.wave_number[field]
    beta = u * fields.band_fraction[field]
    if law == GAUSSIAN:
        return 2.0 * k0 * math.sqrt(-math.log1p(-beta))
    left = max(1.0 - beta, _LEAST)
    if law == PRINTED:
        return k0 * beta / math.sqrt(left * (1.0 + beta))
    return k0 * math.sqrt(beta * (1.0 + left)) / left


@part
def _octave(waves, column):
    """Return the octave of a wave number: half the binary exponent of its square."""
    return np.float64(waves[KX, column] ** 2 + waves[KY, column] ** 2).view(np.int64) >> 53


@owner
def _sort(unsorted, waves):
    """Copy waves in the order of their octaves, those far below the finest as one."""
    columns = waves.shape[1]
    lowest = 0
    for column in range(columns):
        lowest = max(lowest, _octave(unsorted, column) - _OCTAVES + 1)
    begin = np.zeros(_OCTAVES + 1, dtype=np.int64)
    for column in range(columns):
        begin[max(_octave(unsorted, column) - lowest, 0) + 1] += 1
    for octave in range(_OCTAVES):
        begin[octave + 1] += begin[octave]
    for column in range(columns):
        octave = max(_octave(unsorted, column) - lowest, 0)
        for row in ROWS:
            waves[row, begin[octave]] = unsorted[row, column]
        begin[octave] += 1


@part
def columns_for(fields):
    """Return the number of columns that the waves of `fields` take."""
    columns = LANES - 1
    for waves in fields.n_waves:
        columns += waves
    return columns // LANES * LANES


@owner
def room_for(fields):
    """Return a `Surface` that is nothing but room for realisations of `fields`."""
    return flat(np.empty((len(ROWS), columns_for(fields))))


@owner
def flat(waves):
    """Return a `Surface` of which nothing is known but its waves, if these."""
    return Surface(waves, np.zeros((len(BAND_ROWS), BANDS)), 0, 0.0, 0.0)


@entry
def draw_waves(state, fields, buffer):
    """Draw a realisation.

    Parameters
    ----------
    state : uint64[1]
    fields : Fields
    room : Surface
        Where the realisation will live, see `room_for`.

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
            k = wave_number(fields, field, uniform(state)) / TURN
            c, s = unit_circle(state)
            drawn[KX, column] = k * c
            drawn[KY, column] = k * s
            drawn[PHASE, column] = uniform(state)
            column += 1
    _sort(drawn, buffer.waves)
    return bounded(buffer)


@owner
def realised(state, fields, buffer):
    """Return what `draw_waves` does, None where the surface is smooth and has no room."""
    if buffer is None:
        return buffer
    return draw_waves(state, fields, buffer)


@part
def entrance(d, surface):
    """Return where a ray along d from above begins that aims at the origin of the mean surface."""
    if surface is None:
        return ORIGIN
    return Vector(surface.max_height * d.x / d.z, 0.0, surface.max_height)


@owner
def bounded(buffer):
    """Return the `Surface` of the waves in `room`, sorted by octave, with its bands filled in."""
    waves, bands = buffer.waves, buffer.bands
    reach, square, steep = 0.0, 0.0, 0.0
    for i in range(waves.shape[1]):
        a2 = waves[AMPLITUDE, i] ** 2
        reach += waves[AMPLITUDE, i]
        square += a2
        steep += a2 * (waves[KX, i] ** 2 + waves[KY, i] ** 2)
    reach = min(reach, EXTREME * math.sqrt(0.5 * square))
    count = _split(waves, bands, _USELESS * math.sqrt(0.5 * square))
    return Surface(waves, bands, count, reach, EXTREME * TURN * math.sqrt(0.5 * steep))


@part
def _split(waves, bands, max_finer_height):
    """Split waves into bands, and return how many.

    Parameters
    ----------
    waves, bands : float64 array
        See `Surface`; of bands, `END` and `REST` are set.
    useless : float
        Height (m): waves that reach higher stay in the band.
    """
    bands[:] = 0.0
    bands[END, 0] = waves.shape[1]
    count = 1
    finest = _octave(waves, waves.shape[1] - 1)
    rest, rest2 = 0.0, 0.0
    for end in range(waves.shape[1] - LANES, 0, -LANES):
        for i in range(end, end + LANES):
            rest += waves[AMPLITUDE, i]
            rest2 += waves[AMPLITUDE, i] ** 2
        higher = min(rest, EXTREME * math.sqrt(0.5 * rest2))
        if higher > max_finer_height or count == BANDS:
            break
        octave = _octave(waves, end - 1)
        # Half the wave number: a quarter of the curvature, steps of twice the length.
        if octave < finest:
            bands[END, count] = end
            bands[REST, count] = higher
            finest = octave
            count += 1
    return count


@entry
def surface_of(waves):
    """Return the `Surface` of given waves, float64[4, columns], sorted by octave."""
    return bounded(flat(waves))


@kernel
def relief_at(waves, x, y):
    """Return the `Relief` at a point (Eq 3)."""
    sums = wave_sums(waves, 0, waves.shape[1], x, y)
    return Relief(sums.height, Slope(-2.0 * TURN * sums.scaled_slope_x, -2.0 * TURN * sums.scaled_slope_y))


@entry
def reliefs_at(waves, x, y):
    """Return the `Relief` at the points x, y, float64[points] each."""
    found = Relief(np.empty(x.size), Slope(np.empty(x.size), np.empty(x.size)))
    for i in range(x.size):
        one = relief_at(waves, x[i], y[i])
        found.height[i] = one.height
        found.slope.x[i], found.slope.y[i] = one.slope.x, one.slope.y
    return found
