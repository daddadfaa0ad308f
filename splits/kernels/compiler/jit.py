"""Decorators that compile the kernels with common options, and constants of either precision."""

from __future__ import annotations

import functools
import operator
import warnings
from typing import Any

import numba
import numpy as np
from numba import config, njit
from numba.core import ir, types
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import AnalysisPass, FunctionPass, register_pass
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import DeadBranchPrune
from numba.extending import overload

from splits.kernels.compiler.cache import enable_caching

if config.DISABLE_JIT:  # type: ignore[attr-defined]
    # The random stream overflows 2**64 on purpose; NumPy scalars warn about that, machine integers
    # do not.
    warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)

# --------------------------------------------------------------------------------------------------
# Numba compiler passes: reference-count check, and pruning of None fields.
#
# Reference counting is enabled only in functions that allocate or return arrays.  Numba counts
# references to an array in and out of every function that takes it.  Kernels pass the dozens of
# arrays of a scene to small functions at every step, and the counting took half of the run time.
# Only functions that allocate or return arrays count (`inline_allocating`, `entry_point`);
# all others borrow their arguments (Numba's option `_nrt`).  A function without reference counting
# must not return an array, which is checked here; nor does it call NumPy functions on arrays, which
# are compiled separately and cannot be checked.
#
# Pruning of None fields.  A field of a named tuple that is None means that the scene lacks a
# feature, which is known from the type of the tuple.  Numba prunes on arguments only: without this
# pass it would type and lower everything after ``if features.layered is not None`` before it finds
# the branch dead.

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


@register_pass(mutates_CFG=False, analysis_only=True)
class _RefcountCheck(AnalysisPass):
    """Reject a function that allocates or returns arrays without reference counting."""

    _name = "check_no_refcounted_values"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        if state.flags.nrt:
            return False
        # Types that the function and the functions that it calls return.
        return_types = [state.return_type]
        for call, signature in state.calltypes.items():
            if isinstance(call, ir.Expr) and call.op == "call":
                is_constructor = isinstance(state.typemap[call.func.name], types.NamedTupleClass)
                return_types += [] if is_constructor else [signature.return_type]
        # The type of a generator does not show what it holds.
        if any(
            isinstance(one, types.Generator)
            or state.targetctx.data_model_manager[one].contains_nrt_meminfo()
            for one in return_types
        ):
            name = state.func_id.func_qualname
            raise TypeError(f"{name}: allocates or returns arrays: must be `inline_allocating`")
        return False


class RefcountCheckedCompiler(Compiler):
    """Numba's compiler with pruning of None fields and the reference-count check."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's pipelines with both passes."""
        pipelines: list[Any] = super().define_pipelines()
        for before, new_pass, description in (
            (DeadBranchPrune, _NoneFieldPruning, "prune None fields"),
            (NativeLowering, _RefcountCheck, "check that no values are reference-counted"),
        ):
            for pipeline in pipelines:
                position = [known for known, _ in pipeline.passes].index(before)
                pipeline.passes.insert(position, (new_pass, description))
        return pipelines


# --------------------------------------------------------------------------------------------------
# Deferred code generation of functions that only kernels call.
#
# Numba generates and optimizes machine code for every function, although all of it is repeated in
# each function into which that one is inlined; this took most of the compile time of a kernel.
# Here such functions stay unoptimized LLVM code and are optimized once, within the kernel.  (Passes
# within one function still run: they eliminate its named tuples.)
#
# This needs private classes of Numba.  A version without them compiles the same kernels more
# slowly.


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


# --------------------------------------------------------------------------------------------------
# Decorators that compile the kernels with common options, and constants of either precision.

COMMON_OPTIONS: Any = {"error_model": "numpy", "forceinline": True}
"""Options of all small functions, see `inline`."""
INLINE_OPTIONS: Any = {**COMMON_OPTIONS, **make_deferred_options(), "_nrt": False}
"""Options of functions that only kernels call and that do not allocate, see `passes`."""
ALLOCATING_OPTIONS: Any = {**INLINE_OPTIONS, "_nrt": True}
"""Options of functions that allocate or return arrays."""


class InlineFunction:
    """Small function, inlined into the kernels that call it and compiled for calls from Python."""

    def __init__(self, function: Any) -> None:
        functools.update_wrapper(self, function)
        self.dispatcher = enable_caching(
            njit(**COMMON_OPTIONS, pipeline_class=RefcountCheckedCompiler)(function)
        )
        _register_overload(self, function)

    def __call__(self, *values: Any) -> Any:
        """Return the result of the compiled function."""
        return self.dispatcher(*values)


def _register_overload(target: Any, function: Any, options: Any = INLINE_OPTIONS) -> None:
    """Inline a function into the kernels that call `target`."""

    def choose(*types: Any) -> Any:
        return None if _has_class(types, _SPECIALIZED.get(target, ())) else function

    overload(target, jit_options=options, strict=False)(choose)


_SPECIALIZED: dict[Any, tuple[type, ...]] = {}
"""Classes of arguments for which functions have other versions."""


def _has_class(types: Any, classes: tuple[type, ...]) -> bool:
    """Return whether the Numba type of any argument is a named tuple of one of the classes."""
    return any(getattr(one, "instance_class", None) in classes for one in types)


def specialize(target: Any, kind: type) -> Any:
    """Decorate the version of an inlined function for named tuples of a class.

    It takes the place of `target` in compiled code, where one of its arguments is of this class; so
    can a shape of grains be added without changes of other modules.  Calls from Python and runs
    without the compiler (NUMBA_DISABLE_JIT) use `target` itself.  The version must be in
    `splits.kernels`, because cached kernels are compiled again only after a change of the sources
    there.
    """

    def register(function: Any) -> Any:
        _SPECIALIZED[target] = (*_SPECIALIZED.get(target, ()), kind)
        overload(target, jit_options=INLINE_OPTIONS, strict=False)(
            lambda *types: function if _has_class(types, (kind,)) else None
        )
        return function

    return register


def inline(function: Any) -> Any:
    """Compile a small function that is inlined where it is called.

    Inlining removes the code of absent features and the cost of passing dozens of scalars.
    Division by zero follows IEEE 754 instead of raising, which saves a check at every division.
    Fast-math options are off: with free contraction of products and sums the bits would depend on
    whether code was just compiled or comes from the cache.  `arithmetic.fma` marks the contracted
    ones.
    """
    return function if config.DISABLE_JIT else InlineFunction(function)  # type: ignore[attr-defined]


def inline_only(function: Any) -> Any:
    """Inline a function as `inline` does; calls from Python run its source."""
    _register_overload(function, function)
    return function


def inline_allocating(function: Any) -> Any:
    """Inline a function, as `inline_only` does, that allocates or returns arrays."""
    _register_overload(function, function, ALLOCATING_OPTIONS)
    return function


def entry_point(function: Any) -> Any:
    """Compile a function that Python calls, without the global interpreter lock."""
    return enable_caching(
        njit(error_model="numpy", nogil=True, pipeline_class=RefcountCheckedCompiler)(function)
    )


def entry_point_no_refcount(function: Any) -> Any:
    """Compile a function, as `entry_point` does, that allocates no arrays.

    Kernels may call it, too.
    """
    options: Any = {"error_model": "numpy", "nogil": True, "_nrt": False}
    return enable_caching(njit(**options, pipeline_class=RefcountCheckedCompiler)(function))


def float32_constant(value: float) -> float | np.float32:
    """Return a constant that adopts the precision of the operands.

    Compiled arithmetic of a single-precision constant with a double is in double precision, and
    with a single stays single, so that one formula serves both precisions.  A value that is not
    exact in single precision is rounded for both.
    """
    return value if config.DISABLE_JIT else np.float32(value)  # type: ignore[attr-defined]


ZERO, HALF, ONE, TWO, THREE, FOUR = (float32_constant(x) for x in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
ONE_AND_HALF = float32_constant(1.5)
TINY = float32_constant(1e-30)
"""Lower bound of a square whose reciprocal root is multiplied by zero; its value does not affect
results."""


# --------------------------------------------------------------------------------------------------
# Named tuples with some fields replaced, in kernels and in Python.


def replace(value: Any, **changes: Any) -> Any:
    """Return a named tuple with some fields replaced, as `dataclasses.replace` does."""
    return value._replace(**changes)


@overload(replace, strict=False, jit_options=INLINE_OPTIONS)
def _replace_in_kernel(value: Any, **changes: Any) -> Any:
    # Numba has no keyword arguments of unknown names, so the function is written for these ones.
    # It finds the compiled code by the types of all arguments, so the last one carries the names.
    kind = value.instance_class
    arguments = ", ".join(name if name in changes else f"value.{name}" for name in kind._fields)
    parameters = ", ".join(["value", *changes, f"names={' '.join(changes)!r}"])
    scope = {"Kind": kind}
    exec(f"def replace({parameters}):\n    return Kind({arguments})", scope)
    return scope["replace"]
