"""Absorption along a path segment: analog, or path lengths that become weights later.

A weighted ray is subject to Russian roulette once its weight is low at every wavelength that it
serves, so that paths in opaque grains end early.  The estimate stays unbiased.
"""

import math

from oracle.jit import kernel
from oracle.rng import uniform

OPTICAL_DEPTH = 0
"""Least optical depth of the path so far, over the wavelengths served."""
NEXT_ROULETTE_DEPTH = 1
"""Optical depth at which roulette is played next."""
WEIGHT = 2
"""Inverse probability of having survived roulette."""

ROULETTE_THRESHOLD = 0.1
SURVIVAL_PROBABILITY = 0.3
FIRST_ROULETTE_DEPTH = -math.log(ROULETTE_THRESHOLD)
NEXT_ROULETTE_STEP = -math.log(SURVIVAL_PROBABILITY)


@kernel
def start_roulette(roulette_state):
    """Set `roulette_state` (float64[3]) for a new ray."""
    roulette_state[OPTICAL_DEPTH] = 0.0
    roulette_state[NEXT_ROULETTE_DEPTH] = FIRST_ROULETTE_DEPTH
    roulette_state[WEIGHT] = 1.0


@kernel
def attenuate_segment(state, distance, material, optics, rules, length, roulette_state):
    """Attenuate a ray along a segment through a material, and return whether it survives.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability of
    transmission.  Weighted rays add the segment to `length`, and end only by roulette.

    Parameters
    ----------
    state : uint64[1]
    distance : float
        Length of the segment (m).
    material : int
    optics, rules
        See `splits.kernels.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place.
    roulette_state : float64[3]
        `OPTICAL_DEPTH`, `NEXT_ROULETTE_DEPTH` and `WEIGHT`, advanced in place.
    """
    length[material] += distance
    depth = optics.absorption[material] * distance
    if rules.analog:
        return depth == 0.0 or uniform(state) < math.exp(-depth)
    roulette_state[OPTICAL_DEPTH] += depth
    while roulette_state[OPTICAL_DEPTH] > roulette_state[NEXT_ROULETTE_DEPTH]:
        if uniform(state) > SURVIVAL_PROBABILITY:
            return False
        roulette_state[NEXT_ROULETTE_DEPTH] += NEXT_ROULETTE_STEP
        roulette_state[WEIGHT] /= SURVIVAL_PROBABILITY
    return True
