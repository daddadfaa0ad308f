"""Equality and hashing of inputs by value, including arrays."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np


class ContentEquality:
    """Base class of frozen dataclasses that compare and hash by the values of their fields.

    Derived classes are declared with ``eq=False``: the generated equality of dataclasses fails for
    arrays, and the generated hash fails for arrays and mappings.  Arrays, lists and tuples of equal
    values are equal, and mappings are equal in any order.  Copies and unpickled objects are equal.
    """

    def __eq__(self, other: object) -> bool:
        """Return whether the other is of the same class with equal fields."""
        if type(other) is not type(self):
            return NotImplemented
        return self is other or self._comparison_key() == other._comparison_key()

    def __hash__(self) -> int:
        """Return the hash of the fields."""
        return hash(self._comparison_key())

    def _comparison_key(self) -> tuple[Hashable, ...]:
        """Return the key by which objects compare."""
        instance: Any = self
        return tuple(_to_hashable(getattr(instance, f.name)) for f in fields(instance) if f.compare)


def _to_hashable(value: Any) -> Hashable:
    """Return a hashable equivalent: tuples of sequences and arrays, sets of pairs of mappings."""
    if isinstance(value, Mapping):
        return frozenset((key, _to_hashable(item)) for key, item in value.items())
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return tuple(map(_to_hashable, value))
    hashable: Hashable = value
    return hashable
