"""One-line representation of media: the call that constructs them, without defaults."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from splits.core.validation import as_scalar, short_repr, suggest_name

MAX_SHOWN_NUMBERS = 8
"""Longest sequence shown in full; of longer ones the first and the last number."""


def format_call(name: str, inputs: Mapping[str, Any]) -> str:
    """Return the text of a call with keywords, on one line."""
    return f"{name}({', '.join(f'{key}={format_input(value)}' for key, value in inputs.items())})"


def find_differences(medium: Any, reference: Any) -> dict[str, Any]:
    """Return the fields in which a dataclass differs from a reference of the same class."""
    differences = {}
    for name in (field.name for field in fields(medium)):
        value, reference_value = getattr(medium, name), getattr(reference, name)
        if format_input(value) == format_input(reference_value):
            continue
        if isinstance(value, Mapping) and isinstance(reference_value, Mapping):
            value = {
                k: v
                for k, v in value.items()
                if format_input(v) != format_input(reference_value.get(k))
            }
        differences[name] = value
    return differences


def format_input(value: Any) -> str:
    """Return the text of an input, on one line; objects are shown by their `as_input`."""
    value = as_scalar(value)
    if hasattr(value, "as_input"):
        return format_input(value.as_input())
    if isinstance(value, Real) and not isinstance(value, bool):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        pairs = [f"{format_input(key)}: {format_input(item)}" for key, item in value.items()]
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, (np.ndarray, Sequence)) and not isinstance(value, str):
        if len(value) > MAX_SHOWN_NUMBERS:
            return f"[{format_input(value[0])}, ..., {format_input(value[-1])}]"
        text = ", ".join(format_input(item) for item in value)
        return f"({text})" if isinstance(value, tuple) else f"[{text}]"
    # Refractive indices are shown by name.
    return short_repr(value.name if callable(value) and hasattr(value, "name") else value)


def count_digits(value: Any) -> int:
    """Return the number of digits of a number, or of the longest of several."""
    return max(
        len(format_input(x).partition("e")[0].replace(".", "").strip("0")) for x in np.ravel(value)
    )


# --------------------------------------------------------------------------------------------------
# Hints for values that are given in place of a medium.

NAMED_MEDIA_FOLDER = Path(__file__).with_name("named")
NAMED_MEDIA = tuple(sorted(path.stem for path in NAMED_MEDIA_FOLDER.glob("*.toml")))
"""Names of the media of the package, see `splits.media.kinds`."""


def suggest_medium(value: object, names: Sequence[str]) -> str:
    """Return a hint for a value that is not a medium, or "".

    Parameters
    ----------
    value : object
    names : sequence of str
        Names of the allowed media.
    """
    if callable(value):
        name = getattr(value, "__qualname__", "")
        return f"did you mean splits.{name}()?" if name in names else f"call it: {name}(…)"
    if isinstance(value, list | tuple):
        return "layers on each other are a splits.Stack(layers), several media have one call each"
    if isinstance(value, Mapping):
        return "several media have one call each"
    name = str(getattr(value, "kind", value))
    by_class = suggest_name(name.title().replace("_", ""), names)
    by_file = suggest_name(name, NAMED_MEDIA)
    if by_class or not by_file:
        return re.sub(r"mean (\w+)", r"mean splits.\1()", by_class)
    return re.sub(r"mean (\w+)", r"mean splits.load_medium('\1')", by_file)
