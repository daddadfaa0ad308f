"""Absorption along a leg: a coin toss, or a length to be turned into weights later.

A weighted ray plays Russian roulette once it has become light for every wavelength that listens
to it, so that opaque grains end it early and nothing is lost on average.
"""

from __future__ import annotations

import math

from oracle.jit import kernel
from oracle.rng import uniform

DEPTH = 0
"""Least optical depth passed so far, over the wavelengths served."""
LIMIT = 1
"""Optical depth at which roulette is played next."""
WEIGHT = 2
"""Inverse probability of having survived roulette."""

ROULETTE_BELOW = 0.1
ROULETTE_SURVIVAL = 0.3
FIRST_ROULETTE = -math.log(ROULETTE_BELOW)
NEXT_ROULETTE = -math.log(ROULETTE_SURVIVAL)


@kernel
def start_purse(purse):
    """Set `purse` (float64[3]) for a fresh ray."""
    purse[DEPTH] = 0.0
    purse[LIMIT] = FIRST_ROULETTE
    purse[WEIGHT] = 1.0


@kernel
def survives(state, leg, material, optics, rules, length, purse):
    """Take a leg through a material, and tell whether the ray goes on.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability to
    pass.  Weighted rays add the leg to `length`, and end only by roulette.

    Parameters
    ----------
    state : uint64[1]
    leg : float
        Metres.
    material : int
    optics, rules
        See `splits.kernels.grains.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place.
    purse : float64[3]
        `DEPTH`, `LIMIT` and `WEIGHT`, advanced in place.
    """
    length[material] += leg
    depth = optics.absorption[material] * leg
    if rules.analog:
        return depth == 0.0 or uniform(state) < math.exp(-depth)
    purse[DEPTH] += depth
    while purse[DEPTH] > purse[LIMIT]:
        if uniform(state) > ROULETTE_SURVIVAL:
            return False
        purse[LIMIT] += NEXT_ROULETTE
        purse[WEIGHT] /= ROULETTE_SURVIVAL
    return True
