"""Which random streams each way of measuring has: with one seed, no two draw the same numbers.

A stream is named by seed, level and ray (`splits.kernels.math.rng`).  Each of these is the
number of the first level of one of them, which has all numbers up to the next.
"""

from __future__ import annotations

SPECTRAL = 0
SINGLE_SCATTERING = 2_000_000
DEEP_TRANSMITTANCE = 3_000_000
ANGULAR_EXPANSION = 4_000_000
ANGULAR_BINS = 5_000_000
BEAM_SPREAD = 6_000_000
NEXT_EVENT = 7_000_000
IRRADIANCE_PROFILE = 8_000_000
ANALOG = 9_000_000
END = 10_000_000
