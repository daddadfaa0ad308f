"""Equality and hash of inputs by the values that they hold, arrays included."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np


class ContentEquality:
    """A frozen dataclass that equals another of its class where all of their fields are equal.

    The classes that derive from it are made with ``eq=False``: equality as dataclasses have it
    fails for arrays, and their hash for arrays and mappings.  Arrays, lists and tuples of equal
    values are equal, and so are mappings in any order.  A copy, or what was pickled, is equal.
    """

    def __eq__(self, other: object) -> bool:
        """Return whether the other is of this class and holds the same."""
        if type(other) is not type(self):
            return NotImplemented
        return self is other or self._comparison_key() == other._comparison_key()

    def __hash__(self) -> int:
        """Return the hash of what it holds."""
        return hash(self._comparison_key())

    def _comparison_key(self) -> tuple[Hashable, ...]:
        """Return what two equal objects have in common."""
        own: Any = self
        return tuple(_to_hashable(getattr(own, f.name)) for f in fields(own) if f.compare)


def _to_hashable(value: Any) -> Hashable:
    """Return a value, of arrays and sequences a tuple, of mappings a set of pairs."""
    if isinstance(value, Mapping):
        return frozenset((key, _to_hashable(one)) for key, one in value.items())
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return tuple(map(_to_hashable, value))
    found: Hashable = value
    return found
