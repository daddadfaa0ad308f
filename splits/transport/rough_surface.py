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
from typing import NamedTuple

import numpy as np

from splits.transport.frames import dot, normalized
from splits.transport.jit import entry, kernel
from splits.transport.rng import from_table, uniform, unit_circle
from splits.transport.wave_sums import (
    AMPLITUDE,
    KX,
    KY,
    LANES,
    PHASE,
    TURN,
    sums_along,
    wave_sums,
)

PRINTED, EXPONENTIAL, GAUSSIAN, TABLE = range(4)
"""Laws of the wave number, see `wave_number`."""

BANDS = 8
"""Most bands of a realisation."""
_END, _REST, _SLOPE, _CURVATURE, REALISATION = range(5)
BOUNDS_SHAPE = (5, BANDS)
"""Shape of the array `bounds`: what is known of a realisation and of the leg being marched.

One column per band, the finest first.  A band is all waves up to `_END`; `_REST` is what the others
reach, `_SLOPE` and `_CURVATURE` bound the band along the leg.  The last row has numbers of the
realisation: how many bands, its reach, a bound of its slopes, and a count of evaluations.
"""
_COUNT, _REACH, _STEEPEST, EVALUATED = range(4)

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
    waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    share: np.ndarray
    quantile: np.ndarray


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
            k = wave_number(fields, field, uniform(state)) / TURN
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
    bounds[REALISATION, _COUNT] = count
    bounds[REALISATION, _REACH] = reach
    bounds[REALISATION, _STEEPEST] = EXTREME * TURN * math.sqrt(0.5 * steep)
    return -reach, reach


@kernel
def height_and_slope(waves, x, y):
    """Return Ψ, ∂Ψ/∂x and ∂Ψ/∂y at a point (Eq 3)."""
    height, u, v = wave_sums(waves, 0, waves.shape[1], x, y)
    return height, -2.0 * TURN * u, -2.0 * TURN * v


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
    numbers = bounds[REALISATION]
    far = abs(x) + abs(y) + s
    return 1e-12 * numbers[_REACH] + 1e-15 * far * (1.0 + numbers[_STEEPEST])


@kernel
def set_leg(waves, bounds, dx, dy):
    """Bound slope and curvature along a direction, for every band."""
    total, total2, curved, curved2 = 0.0, 0.0, 0.0, 0.0
    begin = 0
    for band in range(int(bounds[REALISATION, _COUNT]) - 1, -1, -1):
        end = int(bounds[_END, band])
        slope, slope2, curvature, curvature2 = sums_along(waves, begin, end, dx, dy)
        total += slope
        total2 += slope2
        curved += curvature
        curved2 += curvature2
        bounds[_SLOPE, band] = TURN * min(total, EXTREME * math.sqrt(0.5 * total2))
        bounds[_CURVATURE, band] = TURN**2 * min(curved, EXTREME * math.sqrt(0.5 * curved2))
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
    bands = int(bounds[REALISATION, _COUNT])
    for _ in range(MOST_STEPS):
        at_x, at_y, at_z = x + s * dx, y + s * dy, z + s * dz
        if climb >= 0.0 and side * at_z > edge:
            return GONE, 0.0, 0.0
        bounds[REALISATION, EVALUATED] += 1.0
        height, slope_x, slope_y, step = 0.0, 0.0, 0.0, 0.0
        begin = 0
        for band in range(bands - 1, -1, -1):
            end = int(bounds[_END, band])
            more, u, v = wave_sums(waves, begin, end, at_x, at_y)
            begin = end
            height += more
            slope_x -= 2.0 * TURN * u
            slope_y -= 2.0 * TURN * v
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
