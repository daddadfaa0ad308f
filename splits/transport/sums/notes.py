"""Notes of rays on their way: where they pass a face, or meet the ground, and what they carry.

A scene says whether faces between layers are listened to (`scene.Scene.listens`); the ground always
is.  Notes are taken in the order of time, those of different rays in any order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import kernel, owner

NOTE_RAY = 0
"""Column of the row of exits of the ray that a note is of."""
NOTE_EVENT = 1
"""Column of what happened, see `passage`."""
NOTE_WEIGHT = 2
"""Column of the inverse probability of having survived roulette."""
NOTE_LENGTH = 3
"""First of the columns of lengths so far (m), one per material, and meetings with the ground."""
_FIRST_NOTES = 64
_TAKEN, _RAY = 0, 1


class Notes(NamedTuple):
    """Room for notes.

    Attributes
    ----------
    rows : float64[room, columns]
    state : int64[2]
        Rows in use, and the ray that is now on its way.
    """

    rows: np.ndarray
    state: np.ndarray


@owner
def no_notes(n_lengths):
    """Return room for notes of so many lengths, none taken."""
    return Notes(np.empty((_FIRST_NOTES, NOTE_LENGTH + n_lengths)), np.zeros(2, dtype=np.int64))


@owner
def taken(bank):
    """Return the notes taken, float64[notes, columns]."""
    return bank.rows[: bank.state[_TAKEN]]


@kernel
def write(row, first, values):
    """Write values into a row from a column on: `row[first:] = values` takes seconds to compile."""
    for i in range(values.size):
        row[first + i] = values[i]


@kernel
def has_room(bank, n_new):
    """Tell whether there is room for so many more."""
    return bank.state[_TAKEN] + n_new <= bank.rows.shape[0]


@owner
def room_for(bank, n_new):
    """Return notes with room for so many more."""
    if has_room(bank, n_new):
        return bank
    count = bank.state[_TAKEN]
    rows = np.empty((2 * (count + n_new), bank.rows.shape[1]))
    for i in range(count):
        write(rows[i], 0, bank.rows[i])
    return Notes(rows, bank.state)


@kernel
def of_ray(bank, ray):
    """Let the notes that follow be of a ray."""
    bank.state[_RAY] = ray


@kernel
def passage(boundary, upward):
    """Return the event of passing a face, 0 at the top; the ground is met at the lowest one."""
    return 2 * boundary + (1 if upward else 0)


@kernel
def note(bank, event, weight, path_lengths):
    """Take a note, for which there must be room.

    Parameters
    ----------
    notes : Notes
    event : int
    weight : float
    length : float64[columns]
        Lengths so far.
    """
    row = bank.rows[bank.state[_TAKEN]]
    row[NOTE_RAY], row[NOTE_EVENT], row[NOTE_WEIGHT] = bank.state[_RAY], event, weight
    write(row, NOTE_LENGTH, path_lengths)
    bank.state[_TAKEN] += 1
