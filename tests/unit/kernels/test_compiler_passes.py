"""Compiler passes: inlining, pruning of absent fields, and reference counting."""

import sys
from typing import NamedTuple

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba.core.runtime import _nrt_python, rtsys
from scenes import compute_optics, make_medium_scene

import splits
from splits.kernels.compiler import cache
from splits.kernels.compiler.jit import entry_point, inline, inline_allocating, inline_only
from splits.kernels.tallies.exits import allocate_exits
from splits.kernels.transport import history


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
