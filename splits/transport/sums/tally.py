"""From rays that left to sums of weights over wavelengths.

Kernels record where and with which path lengths a ray left, and know no wavelength; the lengths
in each material then give its weight at every wavelength (SPLITSnow Eqs 5-6, the exponential read
as the probability to pass).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import ONE, ZERO, borrower, entry, kernel, owner
from splits.transport.numerics.elementary import exponential
from splits.transport.sums.notes import NOTE_LENGTH, NOTE_RAY, NOTE_WEIGHT

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain that fits was found, or no way on at a surface; never expected, counted so that it
cannot pass unseen."""
TRAVELS = 4
BELOW = 5
"""Left below, towards a ground that sends light back."""

EXIT_SIDE = 0
"""Column of the side: 0 reflected, 1 transmitted, −1 for rays that did not leave."""
EXIT_WEIGHT = 1
"""Column of the inverse probability of having survived roulette."""
EXIT_ORDER = 2
"""Column of the order of scattering: grains, particles, facets of a rough surface met; NaN where a
kernel does not count them."""
EXIT_DIRECTION = 3
"""First of three columns: direction outside the slab."""
EXIT_POSITION = 6
"""First of two columns: horizontal position (m); NaN where a kernel does not track it."""
EXIT_LENGTH = 8
"""First of the columns of path lengths (m), one per material."""

BLOCK = 8
"""Successive rays whose sums are kept apart: how blocks scatter tells how errors go together."""
GROUPS = 32
"""Groups of rays whose means are told apart.  Blocks of successive rays take turns, so that the
smallest first round of a level reaches all.  A standard error from 32 groups is known to 13 %."""


class Traced(NamedTuple):
    """How many legs a batch of rays took, and whether it ended early as a ray was lost."""

    n_segments: int
    lost: bool


class Told(NamedTuple):
    """What a batch of rays cost, and what is noted of them.

    Attributes
    ----------
    legs : int or int64[items]
    lost : bool
        The batch ended early, as a ray was lost.
    notes : float64[notes, columns]
        See `splits.transport.sums.notes`.
    """

    n_segments: int
    lost: bool
    crossings: np.ndarray


def exit_rows(n_rays: int, n_materials: int, n_extra_columns: int = 0) -> np.ndarray:
    """Return room for so many rays, float64[rays, columns]: a row each, none having left.

    Parameters
    ----------
    rays, materials : int
    more : int, optional
        Columns after those of the materials, for what else a kernel has to tell.
    """
    rows = np.full((n_rays, EXIT_LENGTH + n_materials + n_extra_columns), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


@kernel
def record(row, reflected, position, direction, weight, order):
    """Write where and how a ray left into its row; path lengths are left to the caller."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1], row[EXIT_DIRECTION + 2] = direction.x, direction.y, direction.z
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = position.x, position.y


@entry
def tally(exits, crossings, absorption, weighted, ground_column):
    """Add up the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    notes : float64[notes, columns]
        Of these rays, ray by ray, `NOTE_RAY` counting from the first of them.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    weighted : bool
        False counts every ray that left as 1: absorption was decided on the way.
    ground : int
        Column of the ground, see `scene.Scene`.  What it keeps of the light that reaches it counts
        as transmitted.

    Returns
    -------
    moments : float64[3, 3, wavelengths]
        Over rays, [reflected, transmitted, both][Σ weight, Σ weight², largest weight].
    least : float64[wavelengths]
        Smallest weight with which any ray left; 0 once one did not.
    blocks : float32[blocks, 2, wavelengths]
        Σ weight of every `BLOCK` successive rays, the last of which may be fewer.  More than
        `GROUPS` blocks take turns.
    """
    wavelengths = absorption.shape[0]
    moments = np.zeros((3, 3, wavelengths))
    rays = exits.shape[0]
    blocks = np.zeros((min(-(-rays // BLOCK), GROUPS), 2, wavelengths), dtype=np.float32)
    before = np.zeros((2, wavelengths))
    least = np.full(wavelengths, np.inf)
    alpha = _alpha(absorption, weighted)
    sides = np.zeros((2, wavelengths), dtype=np.float32)
    first = 0
    for j in range(rays):
        side = int(exits[j, EXIT_SIDE])
        if ground_column < 0:
            if side < 0:
                least[:] = 0.0
            else:
                weigh(exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[side])
                add(moments[side], sides[side])
                least_of(least, sides[side])
        elif side <= 0 and not (first < crossings.shape[0] and crossings[first, NOTE_RAY] == j):
            # Nothing of it came near the ground, as is so for most rays in deep packs.
            if side < 0:
                least[:] = 0.0
            else:
                weigh(exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[0])
                add(moments[0], sides[0])
                add(moments[2], sides[0])
                least_of(least, sides[0])
        else:
            sides[:] = ZERO
            if side >= 0:
                weigh(exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[side])
            first = _kept(crossings, first, j, alpha, ground_column, sides[1])
            add(moments[0], sides[0])
            add(moments[1], sides[1])
            for i in range(wavelengths):
                sides[0, i] += sides[1, i]
            add(moments[2], sides[0])
            least_of(least, sides[0])
        if (j + 1) % BLOCK == 0 or j + 1 == rays:
            for side in range(2):
                for i in range(wavelengths):
                    more = moments[side, 0, i] - before[side, i]
                    blocks[j // BLOCK % GROUPS, side, i] += more
                    before[side, i] = moments[side, 0, i]
    if ground_column < 0:
        # A ray leaves on one side only.
        for i in range(wavelengths):
            moments[2, 0, i] = moments[0, 0, i] + moments[1, 0, i]
            moments[2, 1, i] = moments[0, 1, i] + moments[1, 1, i]
            moments[2, 2, i] = max(moments[0, 2, i], moments[1, 2, i])
    return moments, least, blocks


@owner
def _alpha(absorption, weighted):
    """Return coefficients, float32[materials, wavelengths]; zeros where weights do not fall.

    Wavelengths run fastest, in single precision: the exponential is then vectorised.
    """
    alpha = np.zeros((absorption.shape[1], absorption.shape[0]), dtype=np.float32)
    if weighted:
        for material in range(absorption.shape[1]):
            for i in range(absorption.shape[0]):
                alpha[material, i] = absorption[i, material]
    return alpha


@borrower
def weigh(path_lengths, roulette_weight, alpha, weight):
    """Write factor·exp(−Σ α·length) of every wavelength into `weight`, float32[wavelengths]."""
    weight[:] = ZERO
    for material in range(alpha.shape[0]):
        leg = np.float32(path_lengths[material])
        if leg > ZERO:
            for i in range(weight.size):
                weight[i] += alpha[material, i] * leg
    light = np.float32(roulette_weight)
    for i in range(weight.size):
        weight[i] = light * exponential(-weight[i])


@owner
def _kept(crossings, first, ray, alpha, ground_column, total):
    """Add to `total` what the ground keeps of a ray, and return its first note's successor."""
    weight = np.empty_like(total)
    while first < crossings.shape[0] and crossings[first, NOTE_RAY] == ray:
        weigh(crossings[first, NOTE_LENGTH:], crossings[first, NOTE_WEIGHT], alpha, weight)
        for i in range(total.size):
            total[i] += weight[i] * (ONE - exponential(-alpha[ground_column, i]))
        first += 1
    return first


@borrower
def add(moments, weight):
    """Add one ray's weights, float32[wavelengths], to moments."""
    total, square, largest = moments[0], moments[1], moments[2]
    for i in range(weight.size):
        w = weight[i] * ONE
        total[i] += w
        square[i] += w * w
        largest[i] = max(largest[i], w)


@kernel
def least_of(minimum, weight):
    """Lower the least weights to those of one more ray."""
    for i in range(weight.size):
        minimum[i] = min(minimum[i], weight[i] * ONE)
