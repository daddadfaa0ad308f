"""Notes of rays on their way: where they pass a face, or meet the ground, and what they carry.

A scene says whether faces between layers are listened to (`scene.Scene.listens`); the ground always
is.  Notes are taken in the order of time, those of different rays in any order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import inline, inline_allocating

CROSSING_RAY = 0
"""Column of the row of exits of the ray that a note is of."""
CROSSING_EVENT = 1
"""Column of what happened, see `encode_crossing`."""
CROSSING_WEIGHT = 2
"""Column of the inverse probability of having survived roulette."""
CROSSING_LENGTH = 3
"""First of the columns of lengths so far (m), one per material, and meetings with the ground."""
_INITIAL_CAPACITY = 64
_N_RECORDED, _CURRENT_RAY = 0, 1


class CrossingBank(NamedTuple):
    """Room for notes.

    Attributes
    ----------
    rows : float64[room, columns]
    state : int64[2]
        Rows in use, and the ray that is now on its way.
    """

    rows: np.ndarray
    state: np.ndarray


@inline_allocating
def allocate_bank(n_lengths):
    """Return room for notes of so many lengths, none taken."""
    return CrossingBank(
        np.empty((_INITIAL_CAPACITY, CROSSING_LENGTH + n_lengths)), np.zeros(2, dtype=np.int64)
    )


@inline_allocating
def get_recorded(bank):
    """Return the notes taken, float64[notes, columns]."""
    return bank.rows[: bank.state[_N_RECORDED]]


@inline
def copy_into_row(row, first, values):
    """Write values into a row from a column on: `row[first:] = values` takes seconds to compile."""
    for i in range(values.size):
        row[first + i] = values[i]


@inline
def has_capacity(bank, n_new):
    """Tell whether there is room for so many more."""
    return bank.state[_N_RECORDED] + n_new <= bank.rows.shape[0]


@inline_allocating
def ensure_capacity(bank, n_new):
    """Return notes with room for so many more."""
    if has_capacity(bank, n_new):
        return bank
    count = bank.state[_N_RECORDED]
    rows = np.empty((2 * (count + n_new), bank.rows.shape[1]))
    for i in range(count):
        copy_into_row(rows[i], 0, bank.rows[i])
    return CrossingBank(rows, bank.state)


@inline
def set_current_ray(bank, ray):
    """Let the notes that follow be of a ray."""
    bank.state[_CURRENT_RAY] = ray


@inline
def encode_crossing(boundary, upward):
    """Return the event of passing a face, 0 at the top; the ground is met at the lowest one."""
    return 2 * boundary + (1 if upward else 0)


@inline
def append_crossing(bank, event, weight, path_lengths):
    """Take a note, for which there must be room.

    Parameters
    ----------
    bank : CrossingBank
    event : int
    weight : float
    path_lengths : float64[columns]
        Lengths so far.
    """
    row = bank.rows[bank.state[_N_RECORDED]]
    row[CROSSING_RAY], row[CROSSING_EVENT], row[CROSSING_WEIGHT] = (
        bank.state[_CURRENT_RAY],
        event,
        weight,
    )
    copy_into_row(row, CROSSING_LENGTH, path_lengths)
    bank.state[_N_RECORDED] += 1
