"""Who counts the holders of an array: those who make some, and nobody else.

Numba lets an array go once nobody holds it, and for that counts it in and out of every function
that is given it.  Kernels hand the dozens of arrays of a scene to small functions at every step:
the counting took half the time of a trace.  So only functions that make arrays, or return any,
count (`jit.owner`, `jit.entry`); all others borrow what they are given (`_nrt`, Numba's option).  A
borrower must not pass an array on that others take for counted, which is seen to here; nor does it
call functions of NumPy on arrays, which are compiled out of sight.
"""

from __future__ import annotations

from typing import Any

from numba.core import ir, types
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.typed_passes import NativeLowering

from splits.transport.compiling.pruning import Pruned, with_step


@register_pass(mutates_CFG=False, analysis_only=True)
class _Borrowing(AnalysisPass):
    """Refuse a function that does not count and makes or returns arrays."""

    _name = "borrowers_own_nothing"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        if not state.flags.nrt and any(_counted(state, kind) for kind in _passed(state)):
            name = state.func_id.func_qualname
            raise TypeError(f"{name}: makes or returns arrays, but is no `owner`")
        return False


def _passed(state: Any) -> list[Any]:
    """Return the types of what a function returns, and of what those return that it calls."""
    found = [state.return_type]
    for call, signature in state.calltypes.items():
        if isinstance(call, ir.Expr) and call.op == "call":
            made_here = isinstance(state.typemap[call.func.name], types.NamedTupleClass)
            found += [] if made_here else [signature.return_type]
    return found


def _counted(state: Any, value_type: Any) -> bool:
    """Tell whether a value has something in it whose holders are counted, as an array."""
    inside: bool = state.targetctx.data_model_manager[value_type].contains_nrt_meminfo()
    # What a generator holds does not show in its type.
    return inside or isinstance(value_type, types.Generator)


class Checked(Pruned):
    """Numba's compiler, with that seen to."""

    def define_pipelines(self) -> list[Any]:
        """Return the ways of compiling, with one step more."""
        ways = super().define_pipelines()
        return with_step(ways, NativeLowering, _Borrowing, "see that borrowers own nothing")
