"""Compiler of the kernels: inlining, absent fields, reference counts, structures of arrays."""

import sys
import warnings
from typing import Any, NamedTuple

import numba
import numba.core.codegen
import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit
from numba.core.errors import TypingError
from numba.core.runtime import _nrt_python, rtsys
from numba.extending import overload
from scenes import compute_optics, make_medium_scene

import splits
from splits.kernels.arithmetic import select, to_single
from splits.kernels.compiler import cache
from splits.kernels.compiler.jit import (
    RefcountCheckedCompiler,
    entry_point,
    inline,
    inline_allocating,
    inline_only,
    make_deferred_options,
    replace,
)
from splits.kernels.compiler.structure_of_arrays import StructureOfArrays, initialize
from splits.kernels.records import allocate_exits
from splits.kernels.scene import Vector
from splits.kernels.transport import history
from splits.kernels.vectorized.lanes import N_LANES, STATE_SIZE, Lane


@inline
def square(x):
    """Return x²."""
    return x * x


@inline_only
def cube(x):
    """Return x³."""
    return x * square(x)


def compute_total(x):
    """Return x² + x³."""
    return square(x) + cube(x)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "find_cache_folder", lambda: tmp_path)
    return tmp_path


@NEEDS_JIT
def test_only_entry_points_are_compiled_and_cached(folder):
    assert entry_point(compute_total)(3.0) == 36.0
    (cached,) = folder.rglob("*.nbc")
    assert "total" in cached.name
    # A cached function includes all functions that it calls.
    reloaded = entry_point(compute_total)
    assert reloaded(3.0) == 36.0 and sum(reloaded.stats.cache_hits.values()) == 1


@NEEDS_JIT
def test_inline_functions_are_compiled_and_inline_only_are_not(folder):
    assert square(3) == 9 and len(square.dispatcher.signatures) == 1
    assert cube(3) == 27 and not hasattr(cube, "dispatcher")
    assert square.__doc__ == "Return x²."


class InnerRecord(NamedTuple):
    """A record with an optional field."""

    part: float | None


class OuterRecord(NamedTuple):
    """A record that contains another one and an optional field."""

    inner: InnerRecord
    other: float | None


@inline_only
def compute_with_part(outer, x):
    """Return x plus the present fields; the result has another type without the second one."""
    if outer.inner.part is not None:
        x = x + outer.inner.part.real
    if outer.other is None:
        return x
    return (x, outer.other.real)


def call_with_part(outer, x):
    """Return the result of `compute_with_part`."""
    return compute_with_part(outer, x)


@NEEDS_JIT
def test_absent_named_tuple_fields_are_pruned(folder):
    """Without pruning, Numba types both branches and rejects different result types."""
    compiled = entry_point(call_with_part)
    assert compiled(OuterRecord(InnerRecord(None), None), 1.0) == 1.0
    assert compiled(OuterRecord(InnerRecord(2.0), None), 1.0) == 3.0
    assert compiled(OuterRecord(InnerRecord(2.0), 4.0), 1.0) == (3.0, 4.0)


@inline_only
def return_array(values):
    """Return an array, in a named tuple, without reference counting."""
    return InnerRecord(values[1:])


@inline_allocating
def make_array(values):
    """Return a new array."""
    return values + 1.0


@inline_only
def use_array(values):
    """Return an element of an array that would never be released."""
    return make_array(values)[0]


@inline_only
def return_optional(values):
    """Return an array without reference counting, or None."""
    if values[0] > 0.0:
        return values
    return None


@NEEDS_JIT
@pytest.mark.parametrize("function", [return_array, use_array, return_optional])
def test_array_results_require_reference_counting(folder, function):
    def caller(values):
        function(values)

    with pytest.raises(TypeError, match="allocates or returns arrays: must be `inline_allocating`"):
        entry_point(caller)(np.ones(3))


@NEEDS_JIT
def test_arrays_allocated_in_kernels_are_released(folder):
    def caller(values):
        return make_array(make_array(values))[-1]

    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        assert entry_point(caller)(np.ones(3)) == 3.0
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 1


def test_a_kernel_releases_the_arrays_of_its_scene():
    scene, optics = (
        make_medium_scene(splits.Snow(), analog=True),
        compute_optics(splits.Snow(), 500.0),
    )
    exits = allocate_exits(8, optics.n.size)
    arrays = (*scene.layers, *scene.types, *optics, exits)
    before = [sys.getrefcount(array) for array in arrays]
    history.trace_rays(1, np.array([0, 0, 8, 100]), scene, optics, exits, None)
    assert [sys.getrefcount(array) for array in arrays] == before


# --- deferred code generation, which needs private classes of Numba -------------------------------


def compile_square_sum(options):
    """Return a kernel with a function that is inlined by Numba options."""

    def square(x):
        return x * x

    overload(square, jit_options={**options, "forceinline": True}, strict=False)(
        lambda *types: lambda x: x * x
    )
    return njit(lambda x, y: square(x) + square(y))


def test_this_version_of_numba_has_the_private_classes():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        options = make_deferred_options()
    assert options["pipeline_class"] is not RefcountCheckedCompiler, (
        f"Numba {numba.__version__} broke the deferred code generation of splits.kernels.compiler"
    )


@NEEDS_JIT
def test_kernels_compile_without_them(monkeypatch):
    deferred = compile_square_sum(make_deferred_options())
    monkeypatch.delattr(numba.core.codegen, "JITCodeLibrary")
    with pytest.warns(UserWarning, match=rf"Numba {numba.__version__} has changed .*JITCodeLib"):
        options = make_deferred_options()
    assert options["pipeline_class"] is RefcountCheckedCompiler
    assert compile_square_sum(options)(3.0, 4.0) == deferred(3.0, 4.0) == 25.0


# --- named tuples with replaced fields ------------------------------------------------------------


class Particle(NamedTuple):
    status: int
    position: Vector
    direction: Vector
    weight: float
    light: Any


PARTICLE = Particle(0, Vector(1.0, 2.0, 3.0), Vector(0.0, 0.0, 1.0), 1.0, None)
OTHER = Vector(-1.0, 0.0, 0.5)


def change(particle, other):
    """Return the particle after changes of one field, of fields in another order, and of none."""
    moved = replace(particle, position=other)
    turned = replace(particle, direction=other)
    halved = replace(turned, weight=0.5 * turned.weight, status=turned.status + 1)
    return moved, turned, halved, replace(halved)


def test_other_fields_are_kept():
    moved, turned, halved, same = change(PARTICLE, OTHER)
    assert moved == PARTICLE._replace(position=OTHER)
    assert turned == PARTICLE._replace(direction=OTHER)
    assert halved == same == turned._replace(weight=0.5, status=1)


@NEEDS_JIT
def test_kernels_return_the_same():
    # Numba finds compiled code by the types of arguments: position and direction have the same.
    assert njit(change)(PARTICLE, OTHER) == change(PARTICLE, OTHER)


@NEEDS_JIT
def test_a_field_may_change_in_a_loop():
    @njit
    def halve(particle, n):
        for _ in range(n):
            particle = replace(particle, weight=0.5 * particle.weight)
        return particle

    assert halve(PARTICLE, 3) == PARTICLE._replace(weight=0.125)


# --- structures of arrays -------------------------------------------------------------------------


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
