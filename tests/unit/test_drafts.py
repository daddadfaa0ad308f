"""Small functions are compiled into those that call them, and for Python when that calls them."""

from __future__ import annotations

import pytest
from chi2 import NEEDS_JIT

from splits.transport import cache
from splits.transport.cache import Folder
from splits.transport.jit import entry, kernel, part


@kernel
def square(x):
    """Return x²."""
    return x * x


@part
def cube(x):
    """Return x³."""
    return x * square(x)


def total(x):
    """Return x² + x³."""
    return square(x) + cube(x)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    found = Folder(tmp_path / "numba", False)
    monkeypatch.setattr(cache, "folders", lambda: (found, found))
    return found.path


@NEEDS_JIT
def test_only_what_python_calls_is_made_and_kept(folder):
    assert entry(total)(3.0) == 36.0
    (kept,) = folder.rglob("*.nbc")
    assert "total" in kept.name
    # A function that is kept has within it all that it calls.
    again = entry(total)
    assert again(3.0) == 36.0 and sum(again.stats.cache_hits.values()) == 1


@NEEDS_JIT
def test_python_calls_a_small_function_compiled_and_a_part_as_it_is_written(folder):
    assert square(3) == 9 and len(square.compiled.signatures) == 1
    assert cube(3) == 27 and not hasattr(cube, "compiled")
    assert square.__doc__ == "Return x²."
