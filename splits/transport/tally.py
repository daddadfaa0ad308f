"""From rays that left to sums of weights over wavelengths.

Kernels record where and with which path lengths a ray left, and know no wavelength; the lengths
in each material then give its weight at every wavelength (SPLITSnow Eqs 5-6, the exponential read
as the probability to pass).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.elementary import exponential
from splits.transport.jit import ONE, ZERO, entry, kernel

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain that fits was found, or no way on at a surface; never expected, counted so that it
cannot pass unseen."""
TRAVELS = 4

EXIT_SIDE = 0
"""Column of the side: 0 reflected, 1 transmitted, −1 for rays that did not leave."""
EXIT_WEIGHT = 1
"""Column of the inverse probability of having survived roulette."""
EXIT_ORDER = 2
"""Column of the order of scattering: grains met; NaN where a kernel does not count them."""
EXIT_DIRECTION = 3
"""First of three columns: direction outside the slab."""
EXIT_POSITION = 6
"""First of two columns: horizontal position (m); NaN where a kernel does not track it."""
EXIT_LENGTH = 8
"""First of the columns of path lengths (m), one per material."""

BLOCK = 8
"""Successive rays whose sums are kept apart: how blocks scatter tells how errors go together."""


class Traced(NamedTuple):
    """How many legs a batch of rays took, and whether it ended early as a ray was lost."""

    legs: int
    lost: bool


def exit_rows(rays: int, materials: int, more: int = 0) -> np.ndarray:
    """Return room for so many rays, float64[rays, columns]: a row each, none having left.

    Parameters
    ----------
    rays, materials : int
    more : int, optional
        Columns after those of the materials, for what else a kernel has to tell.
    """
    rows = np.full((rays, EXIT_LENGTH + materials + more), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


@kernel
def record(row, reflected, place, d, weight, order):
    """Write where and how a ray left into its row; path lengths are left to the caller."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1], row[EXIT_DIRECTION + 2] = d.x, d.y, d.z
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = place.x, place.y


@entry
def tally(exits, absorption, weighted):
    """Add up the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    weighted : bool
        False counts every ray that left as 1: absorption was decided on the way.

    Returns
    -------
    moments : float64[2, 3, wavelengths]
        Over rays, [reflected, transmitted][Σ weight, Σ weight², largest weight].
    least : float64[wavelengths]
        Smallest weight with which any ray left; 0 once one did not.
    blocks : float32[blocks, 2, wavelengths]
        Σ weight of every `BLOCK` successive rays, the last of which may be fewer.
    """
    wavelengths = absorption.shape[0]
    moments = np.zeros((2, 3, wavelengths))
    rays = exits.shape[0]
    blocks = np.empty((-(-rays // BLOCK), 2, wavelengths), dtype=np.float32)
    before = np.zeros((2, wavelengths))
    least = np.full(wavelengths, np.inf)
    # Wavelengths run fastest, in single precision: the exponential is then vectorised.
    alpha = np.empty((absorption.shape[1], wavelengths), dtype=np.float32)
    for material in range(absorption.shape[1]):
        for i in range(wavelengths):
            alpha[material, i] = absorption[i, material]
    depth = np.empty(wavelengths, dtype=np.float32)
    for j in range(rays):
        side = int(exits[j, EXIT_SIDE])
        if side < 0:
            least[:] = 0.0
        else:
            factor = np.float32(exits[j, EXIT_WEIGHT])
            depth[:] = ZERO
            if weighted:
                for material in range(absorption.shape[1]):
                    leg = np.float32(exits[j, EXIT_LENGTH + material])
                    if leg > ZERO:
                        for i in range(wavelengths):
                            depth[i] += alpha[material, i] * leg
            add(moments[side], least, depth, factor)
        if (j + 1) % BLOCK == 0 or j + 1 == rays:
            for side in range(2):
                for i in range(wavelengths):
                    blocks[j // BLOCK, side, i] = moments[side, 0, i] - before[side, i]
                    before[side, i] = moments[side, 0, i]
    return moments, least, blocks


@entry
def add(moments, least, depth, factor):
    """Add one ray of weight factor·exp(−depth) to one side's moments and to the least weights."""
    total, square, largest = moments[0], moments[1], moments[2]
    for i in range(depth.size):
        w = factor * exponential(-depth[i]) * ONE
        total[i] += w
        square[i] += w * w
        largest[i] = max(largest[i], w)
        least[i] = min(least[i], w)
