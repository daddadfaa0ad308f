"""Deferred code generation of functions that only kernels call.

Numba generates and optimizes machine code for every function, although all of it is repeated in
each function into which that one is inlined; this took most of the compile time of a kernel.  Here
such functions stay unoptimized LLVM code and are optimized once, within the kernel.  (Passes within
one function still run: they eliminate its named tuples.)

This needs private classes of Numba.  A version without them compiles the same kernels more slowly.
"""

from __future__ import annotations

import warnings
from typing import Any

import numba
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from splits.kernels.compiler.passes import RefcountCheckedCompiler


def make_deferred_options() -> dict[str, Any]:
    """Return the Numba options of functions that only other functions call."""
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    try:
        return {**options, "pipeline_class": _define_compiler()}
    except (ImportError, AttributeError) as error:
        warnings.warn(
            f"Numba {numba.__version__} has changed ({error}): kernels compile more slowly",
            stacklevel=2,
        )
        return {"pipeline_class": RefcountCheckedCompiler}


def _define_compiler() -> type[RefcountCheckedCompiler]:
    """Return the compiler, from classes that Numba does not document."""
    from numba import _dynfunc  # type: ignore[attr-defined]
    from numba.core.codegen import JITCodeLibrary

    class DeferredLibrary(JITCodeLibrary):
        """LLVM library that is optimized only after it is linked into a caller."""

        def _optimize_final_module(self) -> None:
            """Do nothing: the caller optimizes this code."""

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._finalized = True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class DeferredLowering(NativeLowering):
        """Lower a function to LLVM code without generating machine code."""

        _name = "deferred_lowering"

        def run_pass(self, state: Any) -> bool:
            state.library = DeferredLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
            state.flags = state.flags.copy()
            state.flags.no_compile = True
            super().run_pass(state)
            result = state["cr"]
            description = result.fndesc
            # Numba looks the code up by the function that Python would call: here an empty one.
            placeholder = _dynfunc.make_function(
                description.lookup_module(), description.qualname, "", 0, result.env,
                (state.library,),
            )  # fmt: skip
            state.targetctx.insert_user_function(placeholder, description, [state.library])
            state["cr"] = result._replace(cfunc=placeholder)
            return True

    class DeferredCodegenCompiler(RefcountCheckedCompiler):
        """Compiler of functions that only other functions call."""

        def define_pipelines(self) -> list[Any]:
            """Return the pipelines with deferred lowering as their last pass."""
            pipelines = super().define_pipelines()
            for pipeline in pipelines:
                pipeline.passes = [
                    (DeferredLowering if known is NativeLowering else known, description)
                    for known, description in pipeline.passes
                ]
            return pipelines

    return DeferredCodegenCompiler
