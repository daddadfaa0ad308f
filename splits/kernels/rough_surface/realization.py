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
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline, inline_allocating, inline_only
from splits.kernels.math.rng import interpolate_quantile, sample_azimuth, uniform
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.rough_surface.bands import (
    BAND_ROWS,
    BOUND_SIGMA,
    MAX_BANDS,
    sort_by_octave,
    split_bands,
)
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
"""Distributions of the wave number, see `wave_number_quantile`."""

_MAX_FINER_SIGMA = 4.0
"""Largest height of the waves outside a band, in standard deviations of the surface."""

_MIN_ONE_MINUS_BETA = 2.0**-40
"""Smallest 1 − β: unbounded distributions are cut off at 1e12 k0, which keeps arguments below 2⁵¹
cycles."""


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
        Cumulative probability of the distribution at the band limit; 1 without one.
    quantiles : float64[fields, m]
        Quantile functions of λ (1/m) of fields with a table
        (`rng.make_table_probabilities`).
    """

    rms_height: np.ndarray
    n_waves: np.ndarray
    law: np.ndarray
    wave_number: np.ndarray
    band_fraction: np.ndarray
    quantiles: np.ndarray


class SurfaceRealization(NamedTuple):
    """Realization of a rough surface, with its bounds.

    Attributes
    ----------
    waves : float64[4, columns]
        Rows `wave_sums.WAVE_ROWS`.
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
