"""Counter-based random numbers: independent numbers for every (seed, stream, ray).

The random numbers of a ray depend only on these three integers, so results are bit-identical for
any number of threads and any split of the rays over jobs.  The generator is SplitMix64
(Steele, Lea & Flood 2014, OOPSLA, doi:10.1145/2660193.2660195): a Weyl counter followed by a
64-bit finalizer.  The initial counter is a hash of (seed, stream, ray).

The state of the generator is a ``uint64`` array of one element, advanced in place.
"""

from __future__ import annotations

import math

import numpy as np

from splits.kernels.arithmetic import Angle
from splits.kernels.compiler.jit import inline

GOLDEN_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S12 = np.uint64(12)
_TO_UNIT = 2.0**-52


@inline
def mix64(z):
    """Return the SplitMix64 finalizer of the ``uint64`` `z`, a bijection of 64-bit integers."""
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@inline
def compute_stream_start(seed, stream, ray):
    """Return the initial counter of a ray."""
    key = mix64(np.uint64(seed) + GOLDEN_GAMMA)
    key = mix64(key ^ (np.uint64(stream) * _MIX1 + GOLDEN_GAMMA))
    return mix64(key ^ (np.uint64(ray) * GOLDEN_GAMMA + _MIX2))


@inline
def start_stream(state, seed, stream, ray):
    """Set `state` (``uint64[1]``) to the initial counter of a ray."""
    state[0] = compute_stream_start(seed, stream, ray)


@inline
def uniform(state):
    """Return the next random number of the ray, uniform on the open interval (0, 1).

    It has 52 random bits and lies at the centre of its interval.  The sum below is exact, so that
    neither 0 nor 1 occurs, the logarithm is finite, and no free path exceeds 37 mean free paths.
    """
    state[0] += GOLDEN_GAMMA
    return (float(mix64(state[0]) >> _S12) + 0.5) * _TO_UNIT


@inline
def sample_half_normal(state):
    """Sample |X| for a standard normal X (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(state)))
    return radius * abs(math.cos(0.5 * math.pi * uniform(state)))


@inline
def sample_azimuth(state):
    """Sample an angle uniform on the circle, by rejection from the disc."""
    while True:
        x = 2.0 * uniform(state) - 1.0
        y = 2.0 * uniform(state) - 1.0
        q = x * x + y * y
        if 1e-12 < q <= 1.0:
            scale = 1.0 / math.sqrt(q)
            return Angle(x * scale, y * scale)


@inline
def interpolate_quantile(table, row, u):
    """Return the quantile of a tabulated distribution.

    Parameters
    ----------
    table : float64[rows, m]
        Quantile functions at the probabilities of `make_table_probabilities`, interpolated
        linearly.
    row : int
        Row of the distribution; a table with a single row holds for all.
    u : float
        Probability in (0, 1).
    """
    x = math.sqrt(0.5 * u) if u < 0.5 else 1.0 - math.sqrt(0.5 * (1.0 - u))
    x *= table.shape[1] - 1
    row = min(row, table.shape[0] - 1)
    i = min(int(x), table.shape[1] - 2)
    return table[row, i] + (x - i) * (table[row, i + 1] - table[row, i])


@inline
def sample_discrete(cdf, u):
    """Return the first index whose cumulative probability exceeds u."""
    i = 0
    while u >= cdf[i] and i < cdf.size - 1:
        i += 1
    return i
