"""Structures of arrays: one array for the states of many rays, with a row for each number.

A subclass of `StructureOfArrays` declares the fields once, as the file ``workitems.soa`` of pbrt-v4
does.  In compiled code ``Lane(words, i)`` is a reference to an element, whose fields are read and
set as attributes.  Rows have compile-time offsets, so that the compiler can prove that they do not
overlap, which vectorization requires.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple, get_type_hints

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.core.errors import TypingError
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_getattr_generic,
    lower_setattr_generic,
    register_model,
    type_callable,
)

_WORD = ir.IntType(32)
_NUMBERS: dict[Any, Any] = {
    bool: types.boolean, int: types.int32, np.int32: types.int32, np.uint32: types.uint32,
    float: types.float32,
}  # fmt: skip
_TUPLES = (types.NamedTuple, types.NamedUniTuple)


class Field(NamedTuple):
    """Field: its Numba type, its first row, and its initial value, None for none."""

    kind: Any
    row: int
    initial: Any


class ElementType(types.Type):
    """Numba type of an element: a pointer to its number in the first row."""

    def __init__(self, structure: type[StructureOfArrays]) -> None:
        super().__init__(structure.__qualname__)
        self.structure = structure

    @property
    def key(self) -> Any:
        """Structure; several may have the same name."""
        return self.structure


register_model(ElementType)(models.OpaqueModel)


class StructureOfArrays:
    """Declaration of a structure of arrays, by annotations and initial values of its fields.

    A field is a number or a named tuple of numbers and named tuples.  All numbers have 32 bits.
    An element does not keep its array alive.

    Parameters
    ----------
    words : uint32[n_rows × n_elements]
        Or another type of 32 bits; contiguous.
    index : int
        Of an element, 0 to n_elements − 1.  It is not checked.

    Attributes
    ----------
    n_elements : int
        A keyword of the class.
    fields : dict of Field
    n_rows : int
        Numbers of an element.
    """

    n_elements: ClassVar[int]
    fields: ClassVar[dict[str, Field]]
    n_rows: ClassVar[int]

    def __init_subclass__(cls, n_elements: int) -> None:
        cls.n_elements, cls.fields, cls.n_rows = n_elements, {}, 0
        hints = get_type_hints(cls)
        for name in cls.__annotations__:
            kind = _get_numba_type(hints[name])
            cls.fields[name] = Field(kind, cls.n_rows, cls.__dict__.get(name))
            cls.n_rows += _count_rows(kind)
        _register_constructor(cls)


def _get_numba_type(annotation: Any) -> Any:
    """Return the Numba type of a field."""
    if annotation in _NUMBERS:
        return _NUMBERS[annotation]
    if not hasattr(annotation, "_fields"):
        raise TypeError(f"{annotation} is not a 32-bit number or a named tuple of these")
    members = get_type_hints(annotation).values()
    return types.BaseTuple.from_types([_get_numba_type(member) for member in members], annotation)


def _count_rows(kind: Any) -> int:
    return sum(map(_count_rows, kind)) if isinstance(kind, _TUPLES) else 1


def _register_constructor(structure: type[StructureOfArrays]) -> None:
    kind = ElementType(structure)

    @type_callable(structure)
    def define_signature(context: Any) -> Callable[..., Any]:
        def check_arguments(words: Any, index: Any) -> ElementType:
            is_row = isinstance(words, types.Array) and (words.ndim, words.layout) == (1, "C")
            if not is_row or getattr(words.dtype, "bitwidth", None) != _WORD.width:
                allowed = "a contiguous one-dimensional array of 32-bit numbers"
                raise TypingError(f"{structure.__qualname__}: {words} is not {allowed}")
            return kind

        return check_arguments

    @lower_builtin(structure, types.Array, types.Integer)
    def construct(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        index = context.cast(builder, arguments[1], signature.args[1], types.intp)
        address = builder.gep(builder.bitcast(array.data, _WORD.as_pointer()), [index])
        return builder.bitcast(address, ir.IntType(8).as_pointer())


@infer_getattr
class _ElementAttributes(AttributeTemplate):
    key = ElementType

    def resolve(self, element: Any, name: str) -> Any:
        field = element.structure.fields.get(name)
        return field and field.kind


def list_addresses(builder: Any, kind: Any, element: Any, name: str) -> Iterator[Any]:
    """Yield the addresses of the numbers of a field."""
    element = builder.bitcast(element, _WORD.as_pointer())
    for row in range(kind.structure.fields[name].row, kind.structure.n_rows):
        yield builder.gep(element, [_WORD(row * kind.structure.n_elements)])


def _load(context: Any, builder: Any, kind: Any, addresses: Iterator[Any]) -> Any:
    if isinstance(kind, _TUPLES):
        members = [_load(context, builder, member, addresses) for member in kind]
        return context.make_tuple(builder, kind, members)
    if kind == types.boolean:
        return builder.icmp_unsigned("!=", builder.load(next(addresses)), _WORD(0))
    number = context.get_value_type(kind)
    return builder.load(builder.bitcast(next(addresses), number.as_pointer()))


def _store(builder: Any, kind: Any, value: Any, addresses: Iterator[Any]) -> None:
    if isinstance(kind, _TUPLES):
        for i, member in enumerate(kind):
            _store(builder, member, builder.extract_value(value, i), addresses)
        return
    if kind == types.boolean:
        value = builder.zext(value, _WORD)
    builder.store(value, builder.bitcast(next(addresses), value.type.as_pointer()))


@lower_getattr_generic(ElementType)
def _get_field(context: Any, builder: Any, kind: Any, element: Any, name: str) -> Any:
    addresses = list_addresses(builder, kind, element, name)
    return _load(context, builder, kind.structure.fields[name].kind, addresses)


@lower_setattr_generic(ElementType)
def _set_field(context: Any, builder: Any, signature: Any, arguments: Any, name: str) -> None:
    addresses = list_addresses(builder, signature.args[0], arguments[0], name)
    _store(builder, signature.args[1], arguments[1], addresses)


@intrinsic
def initialize(typing_context: Any, element: Any) -> Any:
    """Set the fields of an element that have initial values to these."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for name, field in element.structure.fields.items():
            if field.initial is not None:
                value = context.get_constant_generic(builder, field.kind, field.initial)
                addresses = list_addresses(builder, element, arguments[0], name)
                _store(builder, field.kind, value, addresses)
        return context.get_dummy_value()

    return types.void(element), generate
