"""What a scene does not have, left out before types are inferred.

A field of a named tuple that is None says that a scene lacks something.  Whether it does is known
from the tuple's type; Numba itself looks at arguments only, and would infer and write all that
follows ``if features.layered is not None`` before it is found to be dead.
"""

from __future__ import annotations

import operator
from typing import Any

from numba.core import ir, types
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import DeadBranchPrune

_COMPARISONS = {operator.is_: True, operator.is_not: False}


@register_pass(mutates_CFG=False, analysis_only=False)
class _Fields(FunctionPass):
    """Replace comparisons of fields of arguments with None by what they are."""

    _name = "fields_that_are_none"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        definitions = state.func_ir._definitions
        changed = False
        for block in state.func_ir.blocks.values():
            for line in block.find_insts(ir.Assign):
                known = _answer(line.value, definitions, state.args)
                if known is None:
                    continue
                others = definitions[line.target.name]
                place = next(i for i, value in enumerate(others) if value is line.value)
                line.value = others[place] = ir.Const(known, line.loc)
                changed = True
        return changed


def _answer(value: Any, definitions: Any, args: Any) -> bool | None:
    """Return what a comparison with None comes to, None where that is not known."""
    if not (isinstance(value, ir.Expr) and value.op == "binop" and value.fn in _COMPARISONS):
        return None
    right = _single(value.rhs, definitions)
    if not (isinstance(right, ir.Const) and right.value is None):
        return None
    left = _type_of(value.lhs, definitions, args)
    if left is None or isinstance(left, (types.Optional, types.Omitted)):
        return None
    return isinstance(left, types.NoneType) == _COMPARISONS[value.fn]


def _single(variable: Any, definitions: Any) -> Any:
    """Return what a variable is set to, None if more than once."""
    found = definitions.get(variable.name, [])
    return found[0] if len(found) == 1 else None


def _type_of(variable: Any, definitions: Any, args: Any) -> Any:
    """Return the type of an argument, or of a field of one, None of anything else."""
    value = _single(variable, definitions)
    if isinstance(value, ir.Var):
        return _type_of(value, definitions, args)
    if isinstance(value, ir.Arg):
        return args[value.index]
    if isinstance(value, ir.Expr) and value.op == "getattr":
        owner = _type_of(value.value, definitions, args)
        named = isinstance(owner, (types.NamedTuple, types.NamedUniTuple))
        if named and value.attr in owner.make_height_fields:
            return owner[owner.make_height_fields.index(value.attr)]
    return None


def with_step(pipelines: list[Any], before: Any, new_pass: Any, description: str) -> list[Any]:
    """Return ways of compiling with one step more, before another."""
    for way in pipelines:
        place = [known for known, _ in way.passes].index(before)
        way.passes.insert(place, (new_pass, description))
    return pipelines


class Pruned(Compiler):
    """Numba's compiler, with such comparisons settled first."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's own ways of compiling, with one step more."""
        ways = super().define_pipelines()
        return with_step(ways, DeadBranchPrune, _Fields, "settle which fields are None")
