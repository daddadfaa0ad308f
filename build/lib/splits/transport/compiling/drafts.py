"""Functions that are compiled into others only.

Numba turns every function into machine code of its own, after every optimisation, although all of
it is done again in each function that it is inlined into: of the first call of a kernel that took
most of the time.  What only other functions call is left as it was written here, and optimised
once, with them.  (All but passes within one function, which dissolve its named tuples.)
"""

from __future__ import annotations

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from splits.transport.compiling.ownership import Checked


class _Library(JITCodeLibrary):
    """Code that waits to be linked into that of a caller."""

    def _optimize_final_module(self) -> None:
        """Leave that to the caller."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Write the code of a function, but no machine code."""

    _name = "draft_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags = state.flags.copy()
        state.flags.no_compile = True
        super().run_pass(state)
        made = state["cr"]
        # Numba finds the code by the function that Python would call: one that does nothing.
        found_by = _dynfunc.make_function(
            made.fndesc.lookup_module(), made.fndesc.qualname, "", 0, made.env, (state.library,)
        )
        state.targetctx.insert_user_function(found_by, made.fndesc, [state.library])
        state["cr"] = made._replace(cfunc=found_by)
        return True


class Drafts(Checked):
    """The compiler of such functions."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's own ways of compiling, with another last step."""
        found = super().define_pipelines()
        for way in found:
            way.passes = [
                (_Lowering if step is NativeLowering else step, why) for step, why in way.passes
            ]
        return found


ONLY_INSIDE: Any = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": Drafts,
}
"""Options of functions that only other functions call."""
