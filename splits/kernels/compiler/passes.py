"""Functions that are compiled into others only.

Numba turns every function into machine code of its own, after every optimisation, although all of
it is done again in each function that it is inlined into: of the first call of a kernel that took
most of the time.  What only other functions call is left as it was written here, and optimised
once, with them.  (All but passes within one function, which dissolve its named tuples.)

Who counts the holders of an array: those who make some, and nobody else.

Numba lets an array go once nobody holds it, and for that counts it in and out of every function
that is given it.  Kernels hand the dozens of arrays of a scene to small functions at every step:
the counting took half the time of a trace.  So only functions that make arrays, or return any,
count (`jit.owner`, `jit.entry`); all others borrow what they are given (`_nrt`, Numba's option).  A
borrower must not pass an array on that others take for counted, which is seen to here; nor does it
call functions of NumPy on arrays, which are compiled out of sight.

What a scene does not have, left out before types are inferred.

A field of a named tuple that is None says that a scene lacks something.  Whether it does is known
from the tuple's type; Numba itself looks at arguments only, and would infer and write all that
follows ``if features.layered is not None`` before it is found to be dead.
"""

from __future__ import annotations

import operator
from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import ir, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import AnalysisPass, FunctionPass, register_pass
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import DeadBranchPrune

_COMPARISONS = {operator.is_: True, operator.is_not: False}


@register_pass(mutates_CFG=False, analysis_only=False)
class _NoneFieldPruning(FunctionPass):
    """Replace comparisons of fields of arguments with None by what they are."""

    _name = "fields_that_are_none"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        definitions = state.func_ir._definitions
        changed = False
        for block in state.func_ir.blocks.values():
            for line in block.find_insts(ir.Assign):
                known = _evaluate_none_comparison(line.value, definitions, state.args)
                if known is None:
                    continue
                others = definitions[line.target.name]
                place = next(i for i, value in enumerate(others) if value is line.value)
                line.value = others[place] = ir.Const(known, line.loc)
                changed = True
        return changed


def _evaluate_none_comparison(value: Any, definitions: Any, args: Any) -> bool | None:
    """Return what a comparison with None comes to, None where that is not known."""
    if not (isinstance(value, ir.Expr) and value.op == "binop" and value.fn in _COMPARISONS):
        return None
    right = _find_single_definition(value.rhs, definitions)
    if not (isinstance(right, ir.Const) and right.value is None):
        return None
    left = _infer_type(value.lhs, definitions, args)
    if left is None or isinstance(left, (types.Optional, types.Omitted)):
        return None
    return isinstance(left, types.NoneType) == _COMPARISONS[value.fn]


def _find_single_definition(variable: Any, definitions: Any) -> Any:
    """Return what a variable is set to, None if more than once."""
    found = definitions.get(variable.name, [])
    return found[0] if len(found) == 1 else None


def _infer_type(variable: Any, definitions: Any, args: Any) -> Any:
    """Return the type of an argument, or of a field of one, None of anything else."""
    value = _find_single_definition(variable, definitions)
    if isinstance(value, ir.Var):
        return _infer_type(value, definitions, args)
    if isinstance(value, ir.Arg):
        return args[value.index]
    if isinstance(value, ir.Expr) and value.op == "getattr":
        owner = _infer_type(value.value, definitions, args)
        named = isinstance(owner, (types.NamedTuple, types.NamedUniTuple))
        if named and value.attr in owner.fields:
            return owner[owner.fields.index(value.attr)]
    return None


def insert_pass(pipelines: list[Any], before: Any, new_pass: Any, description: str) -> list[Any]:
    """Return ways of compiling with one step more, before another."""
    for way in pipelines:
        place = [known for known, _ in way.passes].index(before)
        way.passes.insert(place, (new_pass, description))
    return pipelines


class NonePruningCompiler(Compiler):
    """Numba's compiler, with such comparisons settled first."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's own ways of compiling, with one step more."""
        ways = super().define_pipelines()
        return insert_pass(ways, DeadBranchPrune, _NoneFieldPruning, "settle which fields are None")


@register_pass(mutates_CFG=False, analysis_only=True)
class _RefcountCheck(AnalysisPass):
    """Refuse a function that does not count and makes or returns arrays."""

    _name = "borrowers_own_nothing"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        if not state.flags.nrt and any(
            _is_refcounted(state, kind) for kind in _list_return_types(state)
        ):
            name = state.func_id.func_qualname
            raise TypeError(f"{name}: makes or returns arrays, but is no `inline_allocating`")
        return False


def _list_return_types(state: Any) -> list[Any]:
    """Return the types of what a function returns, and of what those return that it calls."""
    found = [state.return_type]
    for call, signature in state.calltypes.items():
        if isinstance(call, ir.Expr) and call.op == "call":
            made_here = isinstance(state.typemap[call.func.name], types.NamedTupleClass)
            found += [] if made_here else [signature.return_type]
    return found


def _is_refcounted(state: Any, value_type: Any) -> bool:
    """Tell whether a value has something in it whose holders are counted, as an array."""
    inside: bool = state.targetctx.data_model_manager[value_type].contains_nrt_meminfo()
    # What a generator holds does not show in its type.
    return inside or isinstance(value_type, types.Generator)


class RefcountCheckedCompiler(NonePruningCompiler):
    """Numba's compiler, with that seen to."""

    def define_pipelines(self) -> list[Any]:
        """Return the ways of compiling, with one step more."""
        ways = super().define_pipelines()
        return insert_pass(ways, NativeLowering, _RefcountCheck, "see that borrowers own nothing")


class _DeferredLibrary(JITCodeLibrary):
    """Code that waits to be linked into that of a caller."""

    def _optimize_final_module(self) -> None:
        """Leave that to the caller."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _DeferredLowering(NativeLowering):
    """Write the code of a function, but no machine code."""

    _name = "draft_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _DeferredLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
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


class DeferredCodegenCompiler(RefcountCheckedCompiler):
    """The compiler of such functions."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's own ways of compiling, with another last step."""
        found = super().define_pipelines()
        for way in found:
            way.passes = [
                (_DeferredLowering if step is NativeLowering else step, why)
                for step, why in way.passes
            ]
        return found


DEFERRED_CODEGEN_OPTIONS: Any = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": DeferredCodegenCompiler,
}
"""Options of functions that only other functions call."""
