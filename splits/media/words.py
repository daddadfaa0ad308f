"""Media on one line, in the words of their input: the call that makes them, without defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from numbers import Real
from typing import Any

import numpy as np

from splits.checks import scalar, shown

MAX_SHOWN = 8
"""Numbers of a row that are shown; of longer rows, the first and the last."""


def call(name: str, inputs: Mapping[str, Any]) -> str:
    """Return a call with keywords as text, on one line."""
    return f"{name}({', '.join(f'{key}={word(value)}' for key, value in inputs.items())})"


def unusual(medium: Any, reference: Any) -> dict[str, Any]:
    """Return the fields of a dataclass in which it differs from another of its kind, by name."""
    found = {}
    for name in (field.name for field in fields(medium)):
        value, other = getattr(medium, name), getattr(reference, name)
        if word(value) == word(other):
            continue
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            value = {k: v for k, v in value.items() if word(v) != word(other.get(k))}
        found[name] = value
    return found


def word(value: Any) -> str:
    """Return an input as text, on one line; what has `as_input` as that says."""
    value = scalar(value)
    if hasattr(value, "as_input"):
        return word(value.as_input())
    if isinstance(value, Real) and not isinstance(value, bool):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{word(key)}: {word(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (np.ndarray, Sequence)) and not isinstance(value, str):
        return _row(value)
    # An index of refraction is known by its name.
    return shown(value.name if callable(value) and hasattr(value, "name") else value)


def digits(value: Any) -> int:
    """Return how many digits a number, or the longest of several, is written with."""
    return max(len(word(x).partition("e")[0].replace(".", "").strip("0")) for x in np.ravel(value))


def _row(values: Any) -> str:
    if len(values) > MAX_SHOWN:
        return f"[{word(values[0])}, ..., {word(values[-1])}]"
    text = ", ".join(word(value) for value in values)
    return f"({text})" if isinstance(values, tuple) else f"[{text}]"
