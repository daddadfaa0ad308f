"""Deferred code generation needs private classes of Numba; without them kernels still work."""

import warnings

import numba
import numba.core.codegen
import pytest
from chi2 import NEEDS_JIT
from numba import njit
from numba.extending import overload

from splits.kernels.compiler.jit import RefcountCheckedCompiler, make_deferred_options


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
