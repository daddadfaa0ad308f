"""Exits of rays, and spectral tallies of their weights.

Kernels record where and with which path lengths a ray left, independent of wavelength.  The path
lengths in each material then give its weight at every wavelength (SPLITSnow Eqs 5-6, with the
exponential as the survival probability).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.kernels.arithmetic import exp_float32, store_vector
from splits.kernels.compiler.jit import (
    ONE,
    ZERO,
    entry_point,
    entry_point_no_refcount,
    inline,
    inline_allocating,
)
from splits.kernels.records import (
    BLOCK_SIZE,
    CROSSING_CODE,
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    N_BATCHES,
    WeightSums,
)

# --------------------------------------------------------------------------------------------------
# Records of rays that cross layer boundaries or hit the ground, with their path lengths.
#
# Crossings of boundaries between layers are recorded if `scene.Scene.record_crossings` is set, and
# hits of a reflecting ground unless absorption is analog.  The records of a ray are in the order of
# time, those of different rays in any order.

_INITIAL_CAPACITY = 64
_N_RECORDED, _CURRENT_RAY = 0, 1


class CrossingBuffer(NamedTuple):
    """Growing array of crossing records.

    Attributes
    ----------
    rows : float64[capacity, columns]
    state : int64[2]
        Rows in use, and the current ray.
    """

    rows: np.ndarray
    state: np.ndarray


@inline_allocating
def allocate_crossings(n_lengths):
    """Return an empty buffer of crossing records with `n_lengths` path lengths."""
    rows = np.empty((_INITIAL_CAPACITY, CROSSING_LENGTH + n_lengths))
    return CrossingBuffer(rows, np.zeros(2, dtype=np.int64))


@inline_allocating
def get_recorded(buffer):
    """Return the crossing records, float64[crossings, columns]."""
    return buffer.rows[: buffer.state[_N_RECORDED]]


@inline
def copy_into_row(row, first, values):
    """Copy values into a row from a column on.

    The equivalent `row[first:] = values` takes seconds to compile.
    """
    for i in range(values.size):
        row[first + i] = values[i]


@inline
def count_recorded(buffer):
    """Return the number of crossing records."""
    return buffer.state[_N_RECORDED]


@inline
def has_capacity(buffer, n_new):
    """Return whether the buffer has capacity for `n_new` more records."""
    return count_recorded(buffer) + n_new <= buffer.rows.shape[0]


@inline_allocating
def enlarge_buffer(buffer, n_kept, n_new):
    """Return a buffer of twice the capacity, and `n_new`, with the first `n_kept` records."""
    rows = np.empty((2 * buffer.rows.shape[0] + n_new, buffer.rows.shape[1]))
    for i in range(n_kept):
        copy_into_row(rows[i], 0, buffer.rows[i])
    buffer.state[_N_RECORDED] = n_kept
    return CrossingBuffer(rows, buffer.state)


@inline
def set_current_ray(buffer, ray):
    """Set the ray of the records that follow."""
    buffer.state[_CURRENT_RAY] = ray


@inline
def encode_crossing(layer, upward):
    """Return the code of a crossing out of a layer: twice the boundary, plus 1 upwards.

    Boundaries are numbered from 0 at the top; the ground is at the lowest one.
    """
    return 2 * layer + 1 if upward else 2 * (layer + 1)


@inline
def append_crossing(buffer, code, weight, path_lengths):
    """Record a boundary crossing.  The caller guarantees capacity.

    Parameters
    ----------
    buffer : CrossingBuffer
    code : int
    weight : float
    path_lengths : float64[columns]
        Path lengths so far (m).
    """
    row = buffer.rows[buffer.state[_N_RECORDED]]
    row[CROSSING_RAY], row[CROSSING_CODE] = buffer.state[_CURRENT_RAY], code
    row[CROSSING_WEIGHT] = weight
    copy_into_row(row, CROSSING_LENGTH, path_lengths)
    buffer.state[_N_RECORDED] += 1


# --------------------------------------------------------------------------------------------------
# Exits of rays, and spectral tallies of their weights.


@inline
def record_exit(row, reflected, position, direction, weight, order):
    """Write the exit of a ray into its row, except for the path lengths."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    store_vector(direction, row, EXIT_DIRECTION)
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = position.x, position.y


@entry_point
def tally_weights(exits, crossings, absorption, weighted, ground_column):
    """Tally the weights of rays, in the order of their rows.

    Parameters
    ----------
    exits : float64[rays, columns]
    crossings : float64[crossings, columns]
        Records of these rays, ray by ray; `CROSSING_RAY` counts from the first ray.
    absorption : float64[wavelengths, materials]
        Absorption coefficients (1/m).
    weighted : bool
        False counts every exit as 1: absorption was sampled during tracing.
    ground_column : int
        Column of the ground, see `scene.Scene`.  Light that the ground absorbs counts as
        transmitted.

    Returns
    -------
    WeightSums
    """
    wavelengths = absorption.shape[0]
    moments = np.zeros((3, 3, wavelengths))
    rays = exits.shape[0]
    blocks = np.zeros((min(-(-rays // BLOCK_SIZE), N_BATCHES), 2, wavelengths), dtype=np.float32)
    previous = np.zeros((2, wavelengths))
    min_weight = np.full(wavelengths, np.inf)
    alpha = transpose_absorption(absorption)
    if not weighted:
        alpha[:] = ZERO
    sides = np.zeros((2, wavelengths), dtype=np.float32)
    first = 0
    for j in range(rays):
        row = exits[j]
        side, lengths, weight = int(row[EXIT_SIDE]), row[EXIT_LENGTH:], row[EXIT_WEIGHT]
        reaches_ground = first < crossings.shape[0] and crossings[first, CROSSING_RAY] == j
        if ground_column < 0 or (side <= 0 and not reaches_ground):
            # Fast path for rays that never reached a ground, most rays in deep media.
            if side < 0:
                min_weight[:] = 0.0
            else:
                compute_path_weights(lengths, weight, alpha, sides[side])
                score_moments(moments[side], sides[side])
                if ground_column >= 0:
                    score_moments(moments[2], sides[side])
                update_minimum(min_weight, sides[side])
        else:
            sides[:] = ZERO
            if side >= 0:
                compute_path_weights(lengths, weight, alpha, sides[side])
            first = _add_ground_absorption(crossings, first, j, alpha, ground_column, sides[1])
            score_moments(moments[0], sides[0])
            score_moments(moments[1], sides[1])
            for i in range(wavelengths):
                sides[0, i] += sides[1, i]
            score_moments(moments[2], sides[0])
            update_minimum(min_weight, sides[0])
        # What the block has added to the totals: a difference in double precision.
        if (j + 1) % BLOCK_SIZE == 0 or j + 1 == rays:
            for side in range(2):
                for i in range(wavelengths):
                    new = moments[side, 0, i] - previous[side, i]
                    blocks[j // BLOCK_SIZE % N_BATCHES, side, i] += new
                    previous[side, i] = moments[side, 0, i]
    if ground_column < 0:
        # Without a ground a ray leaves on one side only.
        for i in range(wavelengths):
            moments[2, 0, i] = moments[0, 0, i] + moments[1, 0, i]
            moments[2, 1, i] = moments[0, 1, i] + moments[1, 1, i]
            moments[2, 2, i] = max(moments[0, 2, i], moments[1, 2, i])
    return WeightSums(moments, min_weight, blocks)


@inline_allocating
def transpose_absorption(absorption):
    """Return the coefficients as float32[materials, wavelengths].

    With contiguous wavelengths in single precision, the exponential is vectorized.
    """
    alpha = np.empty((absorption.shape[1], absorption.shape[0]), dtype=np.float32)
    for material in range(absorption.shape[1]):
        for i in range(absorption.shape[0]):
            alpha[material, i] = absorption[i, material]
    return alpha


@inline
def compute_path_weight(path_lengths, roulette_weight, absorption, wavelength):
    """Return the weight of a ray at one wavelength in double precision (SPLITSnow Eqs 5-6)."""
    depth = 0.0
    for material in range(absorption.shape[1]):
        depth += absorption[wavelength, material] * path_lengths[material]
    return roulette_weight * math.exp(-depth)


@entry_point_no_refcount
def compute_path_weights(path_lengths, roulette_weight, alpha, weight):
    """Write the weight of a ray at every wavelength, factor · exp(−Σ α·length), into `weight`.

    In single precision, so that the exponentials of several wavelengths are vectorized.
    """
    weight[:] = ZERO
    for material in range(alpha.shape[0]):
        segment = np.float32(path_lengths[material])
        if segment > ZERO:
            for i in range(weight.size):
                weight[i] += alpha[material, i] * segment
    factor = np.float32(roulette_weight)
    for i in range(weight.size):
        weight[i] = factor * exp_float32(-weight[i])


@inline_allocating
def _add_ground_absorption(crossings, first, ray, alpha, ground_column, total):
    """Add the weight of a ray that the ground absorbs to `total`.

    Returns
    -------
    int
        Row of the first crossing of the next ray.
    """
    weight = np.empty_like(total)
    while first < crossings.shape[0] and crossings[first, CROSSING_RAY] == ray:
        row = crossings[first]
        compute_path_weights(row[CROSSING_LENGTH:], row[CROSSING_WEIGHT], alpha, weight)
        # At each hit the ground absorbs weight·(1 − a), with its albedo a = exp(−α).
        for i in range(total.size):
            total[i] += weight[i] * (ONE - exp_float32(-alpha[ground_column, i]))
        first += 1
    return first


@entry_point_no_refcount
def score_moments(moments, weight):
    """Add the weights of a ray, float32[wavelengths], to the moments."""
    total, square, largest = moments[0], moments[1], moments[2]
    for i in range(weight.size):
        w = weight[i] * ONE
        total[i] += w
        square[i] += w * w
        largest[i] = max(largest[i], w)


@inline
def update_minimum(min_weight, weight):
    """Update the smallest weights with those of a ray."""
    for i in range(weight.size):
        min_weight[i] = min(min_weight[i], weight[i] * ONE)


# --------------------------------------------------------------------------------------------------
# Derivatives of the weight tallies with respect to absorption.
#
# The weight of a ray is exp(−Σ α·length), so its derivative is −weight · Σ α′·length for a change
# α′ of the absorption coefficients; all parameters use the same path lengths.


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
