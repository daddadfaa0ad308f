"""Random-number streams of the instruments: with one seed, no two use the same numbers.

A stream is identified by seed, stream number and ray (`splits.kernels.math.rng`).  Each stratum of
a tally has a stream number.  Each constant is the first of an instrument, which owns all numbers up
to the next.
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
