"""Numba compiler passes: reference-count check, and pruning of None fields.

Reference counting is enabled only in functions that allocate or return arrays.  Numba counts
references to an array in and out of every function that takes it.  Kernels pass the dozens of
arrays of a scene to small functions at every step, and the counting took half of the run time.
Only functions that allocate or return arrays count (`jit.inline_allocating`, `jit.entry_point`);
all others borrow their arguments (Numba's option `_nrt`).  A function without reference counting
must not return an array, which is checked here; nor does it call NumPy functions on arrays, which
are compiled separately and cannot be checked.

Pruning of None fields.  A field of a named tuple that is None means that the scene lacks a feature,
which is known from the type of the tuple.  Numba prunes on arguments only: without this pass it
would type and lower everything after ``if features.layered is not None`` before it finds the branch
dead.
"""

from __future__ import annotations

import operator
from typing import Any

from numba.core import ir, types
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import AnalysisPass, FunctionPass, register_pass
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import DeadBranchPrune

_COMPARISONS = {operator.is_: True, operator.is_not: False}


@register_pass(mutates_CFG=False, analysis_only=False)
class _NoneFieldPruning(FunctionPass):
    """Replace comparisons with None of fields of arguments by constants."""

    _name = "prune_none_fields"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        definitions = state.func_ir._definitions
        changed = False
        for block in state.func_ir.blocks.values():
            for assignment in block.find_insts(ir.Assign):
                known = _evaluate_none_comparison(assignment.value, definitions, state.args)
                if known is None:
                    continue
                values = definitions[assignment.target.name]
                position = next(i for i, value in enumerate(values) if value is assignment.value)
                assignment.value = values[position] = ir.Const(known, assignment.loc)
                changed = True
        return changed


def _evaluate_none_comparison(value: Any, definitions: Any, args: Any) -> bool | None:
    """Return the value of a comparison with None, or None if it is unknown."""
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
    """Return the only definition of a variable, or None if it has several."""
    values = definitions.get(variable.name, [])
    return values[0] if len(values) == 1 else None


def _infer_type(variable: Any, definitions: Any, args: Any) -> Any:
    """Return the type of an argument or of a field of one, or None for other values."""
    value = _find_single_definition(variable, definitions)
    if isinstance(value, ir.Var):
        return _infer_type(value, definitions, args)
    if isinstance(value, ir.Arg):
        return args[value.index]
    if isinstance(value, ir.Expr) and value.op == "getattr":
        owner = _infer_type(value.value, definitions, args)
        is_named_tuple = isinstance(owner, (types.NamedTuple, types.NamedUniTuple))
        if is_named_tuple and value.attr in owner.fields:
            return owner[owner.fields.index(value.attr)]
    return None


def insert_pass(pipelines: list[Any], before: Any, new_pass: Any, description: str) -> list[Any]:
    """Insert a pass before another in each pipeline, and return the pipelines."""
    for pipeline in pipelines:
        position = [known for known, _ in pipeline.passes].index(before)
        pipeline.passes.insert(position, (new_pass, description))
    return pipelines


class NonePruningCompiler(Compiler):
    """Numba's compiler with pruning of None fields."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's pipelines with the pruning pass."""
        pipelines = super().define_pipelines()
        return insert_pass(pipelines, DeadBranchPrune, _NoneFieldPruning, "prune None fields")


@register_pass(mutates_CFG=False, analysis_only=True)
class _RefcountCheck(AnalysisPass):
    """Reject a function that allocates or returns arrays without reference counting."""

    _name = "check_no_refcounted_values"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        if not state.flags.nrt and any(
            _is_refcounted(state, value_type) for value_type in _list_return_types(state)
        ):
            name = state.func_id.func_qualname
            raise TypeError(f"{name}: allocates or returns arrays: must be `inline_allocating`")
        return False


def _list_return_types(state: Any) -> list[Any]:
    """Return the return types of a function and of the functions that it calls."""
    return_types = [state.return_type]
    for call, signature in state.calltypes.items():
        if isinstance(call, ir.Expr) and call.op == "call":
            is_constructor = isinstance(state.typemap[call.func.name], types.NamedTupleClass)
            return_types += [] if is_constructor else [signature.return_type]
    return return_types


def _is_refcounted(state: Any, value_type: Any) -> bool:
    """Return whether values of a type contain reference-counted memory, such as an array."""
    has_meminfo: bool = state.targetctx.data_model_manager[value_type].contains_nrt_meminfo()
    # The type of a generator does not show what it holds.
    return has_meminfo or isinstance(value_type, types.Generator)


class RefcountCheckedCompiler(NonePruningCompiler):
    """Numba's compiler with pruning of None fields and the reference-count check."""

    def define_pipelines(self) -> list[Any]:
        """Return the pipelines with the reference-count check."""
        pipelines = super().define_pipelines()
        return insert_pass(
            pipelines, NativeLowering, _RefcountCheck, "check that no values are reference-counted"
        )
