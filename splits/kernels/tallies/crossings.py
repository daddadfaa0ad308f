"""Records of rays that cross layer boundaries or hit the ground, with their path lengths.

Crossings of boundaries between layers are recorded if `scene.Scene.record_crossings` is set, and
hits of a reflecting ground unless absorption is analog.  The records of a ray are in the order of
time, those of different rays in any order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline, inline_allocating

CROSSING_RAY = 0
"""Column of the ray, as its row in the exits."""
CROSSING_CODE = 1
"""Column of the code, see `encode_crossing`."""
CROSSING_WEIGHT = 2
"""Column of the statistical weight without absorption in materials."""
CROSSING_LENGTH = 3
"""First of the columns of path lengths (m), one per material, and of the number of ground hits."""
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
