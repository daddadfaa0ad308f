"""From rays that left to sums of weights over wavelengths.

Kernels record where and with which path lengths a ray left, and know no wavelength; the lengths
in each material then give its weight at every wavelength (SPLITSnow Eqs 5-6, the exponential read
as the probability to pass).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import (
    ONE,
    ZERO,
    entry_point,
    entry_point_no_refcount,
    inline,
    inline_allocating,
)
from splits.kernels.math.elementary import exp_float32
from splits.kernels.tallies.crossings import CROSSING_LENGTH, CROSSING_RAY, CROSSING_WEIGHT

ABSORBED = 0
REFLECTED = 1
TRANSMITTED = 2
LOST = 3
"""No grain that fits was found, or no way on at a surface; never expected, counted so that it
cannot pass unseen."""
ALIVE = 4
TO_GROUND = 5
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

BLOCK_SIZE = 8
"""Successive rays whose sums are kept apart: how blocks scatter tells how errors go together."""
N_BATCHES = 32
"""Groups of rays whose means are told apart.  Blocks of successive rays take turns, so that the
smallest first round of a level reaches all.  A standard error from 32 groups is known to 13 %."""


class BatchStats(NamedTuple):
    """How many legs a batch of rays took, and whether it ended early as a ray was lost."""

    n_segments: int
    lost: bool


class BatchResult(NamedTuple):
    """What a batch of rays cost, and what is noted of them.

    Attributes
    ----------
    n_segments : int or int64[items]
    lost : bool
        The batch ended early, as a ray was lost.
    crossings : float64[notes, columns]
        See `splits.kernels.tallies.crossings`.
    """

    n_segments: int
    lost: bool
    crossings: np.ndarray


def allocate_exits(n_rays: int, n_materials: int, n_extra_columns: int = 0) -> np.ndarray:
    """Return room for so many rays, float64[rays, columns]: a row each, none having left.

    Parameters
    ----------
    n_rays, n_materials : int
    n_extra_columns : int, optional
        Columns after those of the materials, for what else a kernel has to tell.
    """
    rows = np.full((n_rays, EXIT_LENGTH + n_materials + n_extra_columns), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


@inline
def record_exit(row, reflected, position, direction, weight, order):
    """Write where and how a ray left into its row; path lengths are left to the caller."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1], row[EXIT_DIRECTION + 2] = (
        direction.x,
        direction.y,
        direction.z,
    )
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = position.x, position.y


@entry_point
def tally_weights(exits, crossings, absorption, weighted, ground_column):
    """Add up the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    crossings : float64[notes, columns]
        Of these rays, ray by ray, `CROSSING_RAY` counting from the first of them.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    weighted : bool
        False counts every ray that left as 1: absorption was decided on the way.
    ground_column : int
        Column of the ground, see `scene.Scene`.  What it keeps of the light that reaches it counts
        as transmitted.

    Returns
    -------
    moments : float64[3, 3, wavelengths]
        Over rays, [reflected, transmitted, both][Σ weight, Σ weight², largest weight].
    least : float64[wavelengths]
        Smallest weight with which any ray left; 0 once one did not.
    blocks : float32[blocks, 2, wavelengths]
        Σ weight of every `BLOCK_SIZE` successive rays, the last of which may be fewer.  More than
        `N_BATCHES` blocks take turns.
    """
    wavelengths = absorption.shape[0]
    moments = np.zeros((3, 3, wavelengths))
    rays = exits.shape[0]
    blocks = np.zeros((min(-(-rays // BLOCK_SIZE), N_BATCHES), 2, wavelengths), dtype=np.float32)
    before = np.zeros((2, wavelengths))
    least = np.full(wavelengths, np.inf)
    alpha = _transpose_absorption(absorption, weighted)
    sides = np.zeros((2, wavelengths), dtype=np.float32)
    first = 0
    for j in range(rays):
        side = int(exits[j, EXIT_SIDE])
        if ground_column < 0:
            if side < 0:
                least[:] = 0.0
            else:
                compute_path_weights(
                    exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[side]
                )
                score_moments(moments[side], sides[side])
                update_minimum(least, sides[side])
        elif side <= 0 and not (first < crossings.shape[0] and crossings[first, CROSSING_RAY] == j):
            # Nothing of it came near the ground, as is so for most rays in deep packs.
            if side < 0:
                least[:] = 0.0
            else:
                compute_path_weights(exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[0])
                score_moments(moments[0], sides[0])
                score_moments(moments[2], sides[0])
                update_minimum(least, sides[0])
        else:
            sides[:] = ZERO
            if side >= 0:
                compute_path_weights(
                    exits[j, EXIT_LENGTH:], exits[j, EXIT_WEIGHT], alpha, sides[side]
                )
            first = _add_ground_absorption(crossings, first, j, alpha, ground_column, sides[1])
            score_moments(moments[0], sides[0])
            score_moments(moments[1], sides[1])
            for i in range(wavelengths):
                sides[0, i] += sides[1, i]
            score_moments(moments[2], sides[0])
            update_minimum(least, sides[0])
        if (j + 1) % BLOCK_SIZE == 0 or j + 1 == rays:
            for side in range(2):
                for i in range(wavelengths):
                    more = moments[side, 0, i] - before[side, i]
                    blocks[j // BLOCK_SIZE % N_BATCHES, side, i] += more
                    before[side, i] = moments[side, 0, i]
    if ground_column < 0:
        # A ray leaves on one side only.
        for i in range(wavelengths):
            moments[2, 0, i] = moments[0, 0, i] + moments[1, 0, i]
            moments[2, 1, i] = moments[0, 1, i] + moments[1, 1, i]
            moments[2, 2, i] = max(moments[0, 2, i], moments[1, 2, i])
    return moments, least, blocks


@inline_allocating
def _transpose_absorption(absorption, weighted):
    """Return coefficients, float32[materials, wavelengths]; zeros where weights do not fall.

    Wavelengths run fastest, in single precision: the exponential is then vectorised.
    """
    alpha = np.zeros((absorption.shape[1], absorption.shape[0]), dtype=np.float32)
    if weighted:
        for material in range(absorption.shape[1]):
            for i in range(absorption.shape[0]):
                alpha[material, i] = absorption[i, material]
    return alpha


@entry_point_no_refcount
def compute_path_weights(path_lengths, roulette_weight, alpha, weight):
    """Write factor·exp(−Σ α·length) of every wavelength into `compute_path_weightst`, float32[wavelengths]."""
    weight[:] = ZERO
    for material in range(alpha.shape[0]):
        leg = np.float32(path_lengths[material])
        if leg > ZERO:
            for i in range(weight.size):
                weight[i] += alpha[material, i] * leg
    light = np.float32(roulette_weight)
    for i in range(weight.size):
        weight[i] = light * exp_float32(-weight[i])


@inline_allocating
def _add_ground_absorption(crossings, first, ray, alpha, ground_column, total):
    """Add to `total` what the ground keeps of a ray, and return its first note's successor."""
    weight = np.empty_like(total)
    while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == ray:
        compute_path_weights(
            crossings[first, CROSSING_LENGTH:], crossings[first, CROSSING_WEIGHT], alpha, weight
        )
        for i in range(total.size):
            total[i] += weight[i] * (ONE - exp_float32(-alpha[ground_column, i]))
        first += 1
    return first


@entry_point_no_refcount
def score_moments(moments, weight):
    """Add one ray's weights, float32[wavelengths], to moments."""
    total, square, largest = moments[0], moments[1], moments[2]
    for i in range(weight.size):
        w = weight[i] * ONE
        total[i] += w
        square[i] += w * w
        largest[i] = max(largest[i], w)


@inline
def update_minimum(minimum, weight):
    """Lower the least weights to those of one more ray."""
    for i in range(weight.size):
        minimum[i] = min(minimum[i], weight[i] * ONE)
