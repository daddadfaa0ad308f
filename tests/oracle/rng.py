"""Counter-based random numbers: one independent stream per (seed, ensemble, ray).

The numbers of a ray depend only on those three integers, so results are bit-identical for any
number of threads and any division of the rays into batches or jobs.  The generator is SplitMix64
(Steele, Lea & Flood 2014, OOPSLA, doi:10.1145/2660193.2660195): a Weyl counter followed by a
64-bit finaliser; the start of the counter is itself a hash of (seed, ensemble, ray).

The state of a stream is a ``uint64`` array of one element, advanced in place by each number.
"""

import math

import numpy as np

from oracle.jit import kernel

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S12 = np.uint64(12)
_TO_UNIT = 2.0**-52


@kernel
def mix64(z):
    """Return the SplitMix64 finaliser of the ``uint64`` `z`, a bijection of 64-bit integers."""
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@kernel
def start_stream(state, seed, ensemble, ray):
    """Set `state` (``uint64[1]``) to the beginning of the stream of one ray."""
    key = mix64(np.uint64(seed) + GOLDEN)
    key = mix64(key ^ (np.uint64(ensemble) * _MIX1 + GOLDEN))
    state[0] = mix64(key ^ (np.uint64(ray) * GOLDEN + _MIX2))


@kernel
def uniform(state):
    """Return the next number of the stream, uniform on the open interval (0, 1).

    52 random bits, centred in their intervals: the sum below is exact, so that neither 0 nor 1 can
    occur and the logarithm is finite.  A free path has at most 36 mean free paths.
    """
    state[0] += GOLDEN
    return (float(mix64(state[0]) >> _S12) + 0.5) * _TO_UNIT


@kernel
def half_normal(state):
    """Return |X| for a standard normal X (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(state)))
    return radius * abs(math.cos(0.5 * math.pi * uniform(state)))


@kernel
def unit_circle(state):
    """Return (cos, sin) of an angle uniform on the circle, by rejection from the disc."""
    while True:
        x = 2.0 * uniform(state) - 1.0
        y = 2.0 * uniform(state) - 1.0
        q = x * x + y * y
        if 1e-12 < q <= 1.0:
            scale = 1.0 / math.sqrt(q)
            return x * scale, y * scale


@kernel
def sample_table(table, row, u):
    """Return the quantile `u` of the distribution tabulated in a row, or the only row.

    Parameters
    ----------
    table : float64[rows, m]
        Quantile functions at the probabilities of `table_probabilities`, joined linearly.
    row : int
    u : float
        Probability in (0, 1).
    """
    x = math.sqrt(0.5 * u) if u < 0.5 else 1.0 - math.sqrt(0.5 * (1.0 - u))
    x *= table.shape[1] - 1
    row = min(row, table.shape[0] - 1)
    i = min(int(x), table.shape[1] - 2)
    return table[row, i] + (x - i) * (table[row, i + 1] - table[row, i])


@kernel
def sample_type(cdf, u):
    """Return the first type whose cumulative probability exceeds u."""
    i = 0
    while u >= cdf[i] and i < cdf.size - 1:
        i += 1
    return i


def table_probabilities(points):
    """Return the probabilities of a quantile table, float64[points], dense at both ends.

    u = 2x² below one half and its mirror image above, x equidistant: the outermost interval of
    1025 points has a probability of 2e-6, so that tails of distributions are resolved.
    """
    x = np.linspace(0.0, 1.0, points)
    return np.where(x < 0.5, 2.0 * x**2, 1.0 - 2.0 * (1.0 - x) ** 2)
