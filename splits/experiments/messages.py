"""One line for what pydantic refuses: the key with its full path, the value, what is allowed."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from splits.checks import named, refuse, shown, suggestion, unknown_key

WORDS = {
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "names"),
}
"""What a key of a type must be, and a list of them."""
LIMITS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


def line_of(model: type[BaseModel], error: ValidationError) -> str:
    """Return one line for a model's refusal: key, value, what is allowed, a hint."""
    # A misspelt key may be the one that is missing; of a key that may be either of two things,
    # the deepest error tells which was meant.
    errors: list[Any] = error.errors(include_url=False)
    first = max(errors, key=lambda e: (e["type"] == "extra_forbidden", len(e["loc"])))
    place, problem = first["loc"], first["type"]
    if problem == "value_error":
        return str(first["ctx"]["error"])
    if problem in ("extra_forbidden", "invalid_key"):
        section, kind = _lead(model, place[:-1])
        known = next(k for k in _options(kind) if _is_section(k)).model_fields
        return str(unknown_key(f"{section}.{place[-1]}".lstrip("."), known))
    of_list = problem == "missing" and isinstance(place[-1], int)
    key, kind = _lead(model, place[:-1] if of_list else place)
    if problem == "missing" and not of_list:
        return f"{key}: missing, must be {_words(kind)}"
    limits = [f"{LIMITS[k]} {v:g}" for k, v in first.get("ctx", {}).items() if k in LIMITS]
    finite = "finite " if problem == "finite_number" else ""
    allowed = limits[0] if limits else _words(kind).replace("a number", f"a {finite}number")
    return str(refuse(key, first["input"], allowed, _hint(kind, first["input"])))


def _lead(model: type[BaseModel], location: Sequence[Any]) -> tuple[str, Any]:
    """Return the key that a location leads to, and the type of what stands there.

    Locations also name branches of unions, which are no keys.
    """
    kind: Any = model
    names: list[str] = []
    for part in location:
        if part == "[key]":
            kind = str
            continue
        for option in _options(kind):
            origin, inner = get_origin(option), get_args(option)
            if _is_section(option) and part in option.model_fields:
                kind = option.model_fields[part].annotation
            elif origin is dict:
                kind = inner[1]
            elif origin is tuple and isinstance(part, int):
                kind = inner[0]
                names[-1] += f"[{part}]"
                break
            else:
                continue
            names.append(named(part))
            break
    return ".".join(names), kind


def _options(kind: Any) -> list[Any]:
    """Return the types that a key may have, None left out."""
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return [one for one in kinds if one is not type(None)]


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _words(kind: Any) -> str:
    """Return what may stand under a key of this type."""
    return " or ".join(dict.fromkeys(_word(option) for option in _options(kind)))


def _word(kind: Any) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return "one of " + ", ".join(inner) if len(inner) > 1 else f'"{inner[0]}"'
    if origin is tuple:
        several = WORDS[inner[0]][1] if inner[0] in WORDS else ", ".join(get_args(inner[0]))
        return f"a list of {several if inner[-1] is Ellipsis else f'{len(inner)} {several}'}"
    if _is_section(kind):
        needed = [name for name, field in kind.model_fields.items() if field.is_required()]
        return "a mapping with " + ", ".join(needed) if needed else "a mapping of keys to values"
    return WORDS[kind][0] if kind in WORDS else "a mapping of keys to values"


def _hint(kind: Any, value: Any) -> str:
    """Return what to write instead of a value that is nearly right, or nothing."""
    options = _options(kind)
    choices = [c for k in options if get_origin(k) is Literal for c in get_args(k)]
    if choices:
        return suggestion(value, choices)
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    if plain and any(get_args(k) == (float, Ellipsis) for k in options):
        return f"write [{shown(value)}]"
    quoted = str in options and isinstance(value, (int, float, date))
    return "put it into quotes" if quoted else ""
