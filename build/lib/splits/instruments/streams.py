"""Which random streams each way of measuring has: with one seed, no two draw the same numbers.

A stream is named by seed, level and ray (`splits.transport.numerics.rng`).  Each of these is the
number of the first level of one of them, which has all numbers up to the next.
"""

from __future__ import annotations

SPECTRAL = 0
SINGLE_SCATTERING = 2_000_000
DEEP = 3_000_000
DIRECTIONAL = 4_000_000
CELLS = 5_000_000
SPREAD = 6_000_000
LOCAL = 7_000_000
PLANES = 8_000_000
ANALOG = 9_000_000
END = 10_000_000
