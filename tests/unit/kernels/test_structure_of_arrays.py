"""Structures of arrays: layout, access to fields, and initial values."""

from typing import NamedTuple

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit
from numba.core.errors import TypingError

from splits.kernels.arithmetic import Vector, select, to_single
from splits.kernels.compiler.structure_of_arrays import StructureOfArrays, initialize
from splits.kernels.vectorized.lanes import N_LANES, STATE_SIZE, Lane

N_ELEMENTS = 8


class Pair(NamedTuple):
    """Named tuple with another one."""

    vector: Vector
    present: bool


class Item(StructureOfArrays, n_elements=N_ELEMENTS):
    """Fields of all kinds."""

    number: float = 1.5
    count: np.uint32
    pair: Pair = Pair(Vector(1.0, 2.0, 3.0), True)
    layer: int = -7


@njit
def _set_fields(words, i, number, vector):
    item = Item(words, i)
    item.number = number
    item.count = np.uint32(2**32 - 1)
    item.pair = Pair(vector, False)
    item.layer += 2


@njit
def _get_fields(words, i):
    item = Item(words, i)
    return item.number, item.count, item.pair, item.layer


@njit
def _initialize(words, i):
    initialize(Item(words, i))


def test_fields_lie_in_successive_rows():
    assert {name: field.row for name, field in Item.fields.items()} == {
        "number": 0, "count": 1, "pair": 2, "layer": 6,
    }  # fmt: skip
    assert Item.n_rows == 7 and Item.n_elements == N_ELEMENTS
    assert N_LANES * Lane.n_rows == STATE_SIZE


@NEEDS_JIT
def test_access_changes_one_element_of_the_rows_of_a_field():
    words = np.full(N_ELEMENTS * Item.n_rows, 0xDEADBEEF, dtype=np.uint32)
    _initialize(words, 3)
    assert _get_fields(words, 3)[0] == 1.5
    assert _get_fields(words, 3)[2:] == (Pair(Vector(1.0, 2.0, 3.0), True), -7)
    # The count has no initial value.
    assert _get_fields(words, 3)[1] == 0xDEADBEEF
    _set_fields(words, 3, 0.1, to_single(Vector(4.0, 5.0, 6.0)))
    expected = (np.float32(0.1), 2**32 - 1, Pair(Vector(4.0, 5.0, 6.0), False), -5)
    assert _get_fields(words, 3) == expected
    rows = words.reshape(Item.n_rows, N_ELEMENTS)
    assert rows[:, 3].view(np.float32)[[0, 2, 3, 4]].tolist() == [np.float32(0.1), 4.0, 5.0, 6.0]
    assert rows[[1, 5], 3].tolist() == [2**32 - 1, 0] and rows[6, 3].view(np.int32) == -5
    assert (np.delete(rows, 3, axis=1) == 0xDEADBEEF).all()


@NEEDS_JIT
def test_unknown_fields_are_rejected():
    @njit
    def get_unknown(words):
        return Item(words, 0).mass

    with pytest.raises(TypingError, match="mass"):
        get_unknown(np.zeros(N_ELEMENTS * Item.n_rows, dtype=np.uint32))


@NEEDS_JIT
def test_structures_of_the_same_name_have_their_own_layouts():
    def declare_structure(with_x):
        if with_x:

            class Structure(StructureOfArrays, n_elements=4):
                x: float
                y: float
        else:

            class Structure(StructureOfArrays, n_elements=8):
                y: float

        return Structure

    first, second = declare_structure(True), declare_structure(False)

    @njit
    def set_fields(words, other_words):
        first(words, 1).y = np.float32(2.0)
        second(other_words, 1).y = np.float32(2.0)

    words, other_words = np.zeros((2, 8), dtype=np.float32)
    set_fields(words, other_words)
    assert words.nonzero()[0] == 5 and other_words.nonzero()[0] == 1


@NEEDS_JIT
@pytest.mark.parametrize(
    "words",
    [
        np.zeros(N_ELEMENTS * Item.n_rows),
        np.zeros((Item.n_rows, N_ELEMENTS), dtype=np.uint32),
        np.zeros(2 * N_ELEMENTS * Item.n_rows, dtype=np.uint32)[::2],
        1.0,
    ],
    ids=["64 bits", "two dimensions", "strided", "no array"],
)
def test_other_arrays_are_rejected(words):
    with pytest.raises(TypingError, match=r"Item: .* is not a contiguous one-dimensional array"):
        _initialize(words, 0)


def test_other_fields_are_rejected():
    with pytest.raises(TypeError, match=r"float64.* is not a 32-bit number"):

        class Wide(StructureOfArrays, n_elements=4):
            x: np.float64


def test_select_chooses_numbers_and_named_tuples():
    a, b = Pair(Vector(1.0, 2.0, 3.0), True), Pair(Vector(4.0, 5.0, 6.0), False)

    @njit
    def choose(condition, x, y):
        return select(condition, x, y)

    assert choose(True, a, b) == a and choose(False, a, b) == b
    assert choose(True, 1.0, 2.0) == 1.0 and choose(False, 1.0, 2.0) == 2.0
