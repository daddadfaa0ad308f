"""Derivatives of the weight tallies with respect to absorption.

The weight of a ray is exp(−Σ α·length), so its derivative is −weight · Σ α′·length for a change α′
of the absorption coefficients; all parameters use the same path lengths.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import (
    ONE,
    ZERO,
    entry_point,
    entry_point_no_refcount,
    inline_allocating,
)
from splits.kernels.math.elementary import exp_float32
from splits.kernels.tallies.crossings import CROSSING_LENGTH, CROSSING_RAY, CROSSING_WEIGHT
from splits.kernels.tallies.exits import (
    BLOCK_SIZE,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    compute_path_weights,
    transpose_absorption,
)


@entry_point
def tally_derivatives(exits, crossings, absorption, absorption_derivatives, ground_column):
    """Tally the derivatives of the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    crossings : float64[crossings, columns]
        Records of these rays, ray by ray; `CROSSING_RAY` counts from the first ray.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m); −ln of the albedo for a ground.
    absorption_derivatives : float64[parameters, wavelengths, materials]
        Their derivatives.
    ground_column : int
        Column of the ground, see `scene.Scene`.

    Returns
    -------
    float32[blocks, 2, parameters, wavelengths]
        Derivatives of Σ weight, reflected and transmitted, of every `BLOCK_SIZE` successive rays;
        light that the ground absorbs counts as transmitted.
    """
    wavelengths, parameters = absorption.shape[0], absorption_derivatives.shape[0]
    alpha = transpose_absorption(absorption)
    derivatives = absorption_derivatives.transpose((0, 2, 1)).astype(np.float32)
    rays = exits.shape[0]
    blocks = np.zeros((-(-rays // BLOCK_SIZE), 2, parameters, wavelengths), dtype=np.float32)
    weight = np.empty(wavelengths, dtype=np.float32)
    first = 0
    for j in range(rays):
        sums, side = blocks[j // BLOCK_SIZE], int(exits[j, EXIT_SIDE])
        if side >= 0:
            lengths = exits[j, EXIT_LENGTH:]
            compute_path_weights(lengths, exits[j, EXIT_WEIGHT], alpha, weight)
            for p in range(parameters):
                _subtract_derivative(lengths, weight, derivatives[p], sums[side, p])
        totals = sums[1]
        first = _add_ground_derivatives(
            crossings, first, j, alpha, derivatives, ground_column, totals
        )
    return blocks


@entry_point_no_refcount
def _subtract_derivative(path_lengths, weight, derivatives, total):
    """Subtract weight · Σ α′·length from `total`, float32[wavelengths]."""
    for material in range(derivatives.shape[0]):
        segment = np.float32(path_lengths[material])
        if segment > ZERO:
            for i in range(weight.size):
                total[i] -= weight[i] * (derivatives[material, i] * segment)


@inline_allocating
def _add_ground_derivatives(crossings, first, ray, alpha, derivatives, ground_column, totals):
    """Add the derivatives of the weight of a ray that the ground absorbs.

    Returns
    -------
    int
        Row of the first crossing of the next ray.
    """
    weight = np.empty(alpha.shape[1], dtype=np.float32)
    reflected = np.empty_like(weight)
    while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == ray:
        lengths = crossings[first, CROSSING_LENGTH:]
        compute_path_weights(lengths, crossings[first, CROSSING_WEIGHT], alpha, weight)
        # The ground absorbs weight·(1 − a), where the albedo a = exp(−α) falls by a·α′.
        for i in range(weight.size):
            reflected[i] = weight[i] * exp_float32(-alpha[ground_column, i])
            weight[i] -= reflected[i]
        for p in range(totals.shape[0]):
            _subtract_derivative(lengths, weight, derivatives[p], totals[p])
            for i in range(weight.size):
                totals[p, i] += reflected[i] * derivatives[p, ground_column, i] * ONE
        first += 1
    return first
