"""Octaves and bands of the waves of a rough surface.

A band contains all waves up to a wave number, so that the finest band contains all waves.
"""

from __future__ import annotations

import math

import numpy as np

from splits.kernels.compiler.jit import inline_allocating, inline_only
from splits.kernels.rough_surface.wave_sums import AMPLITUDE, KX, KY, N_WAVE_LANES, WAVE_ROWS

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
