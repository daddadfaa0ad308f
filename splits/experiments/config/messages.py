"""One-line messages for validation errors of pydantic: key, value, allowed values and a hint."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from splits.core.validation import format_key, invalid, short_repr, suggest_name, unknown_key

TYPE_DESCRIPTIONS = {
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "names"),
}
"""Descriptions of a value of a type, and of a list of such values."""
LIMIT_DESCRIPTIONS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


def format_validation_error(model: type[BaseModel], error: ValidationError) -> str:
    """Return the first validation error as one line: key, value, allowed values and a hint."""
    # Unknown keys come first, since a misspelt key also causes a missing one.  Of the branches of
    # a union, the deepest error belongs to the branch that was meant.
    errors: list[Any] = error.errors(include_url=False)
    first = max(errors, key=lambda e: (e["type"] == "extra_forbidden", len(e["loc"])))
    location, error_type = first["loc"], first["type"]
    if error_type == "value_error":
        return str(first["ctx"]["error"])
    if error_type in ("union_tag_invalid", "union_tag_not_found"):
        section, kind = _resolve_location(model, location)
        tags = [tag for option in _list_options(kind) for tag in _list_tags(option)]
        key, allowed = f"{section}.kind", f"one of {', '.join(tags)}"
        if error_type == "union_tag_not_found":
            return f"{key}: missing, must be {allowed}"
        tag = first["ctx"]["tag"]
        return str(invalid(key, tag, allowed, suggest_name(tag, tags)))
    if error_type in ("extra_forbidden", "invalid_key"):
        section, kind = _resolve_location(model, location[:-1])
        fields = next(k for k in _list_options(kind) if _is_section(k)).model_fields
        return str(unknown_key(f"{section}.{location[-1]}".lstrip("."), fields))
    of_list = error_type == "missing" and isinstance(location[-1], int)
    key, kind = _resolve_location(model, location[:-1] if of_list else location)
    if error_type == "missing" and not of_list:
        return f"{key}: missing, must be {_describe_type(kind)}"
    limits = [
        f"{LIMIT_DESCRIPTIONS[k]} {v:g}"
        for k, v in first.get("ctx", {}).items()
        if k in LIMIT_DESCRIPTIONS
    ]
    finite = "finite " if error_type == "finite_number" else ""
    allowed = limits[0] if limits else _describe_type(kind).replace("a number", f"a {finite}number")
    return str(invalid(key, first["input"], allowed, _suggest_value(kind, first["input"])))


def _resolve_location(model: type[BaseModel], location: Sequence[Any]) -> tuple[str, Any]:
    """Return the key at a location of an error, and the type of its value.

    Locations also contain the names of branches of unions, which are skipped.
    """
    kind: Any = model
    names: list[str] = []
    for part in location:
        if part == "[key]":
            kind = str
            continue
        tagged = [option for option in _list_options(kind) if part in _list_tags(option)]
        if len(_list_options(kind)) > 1 and tagged:
            kind = tagged[0]
            continue
        for option in _list_options(kind):
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
            names.append(format_key(part))
            break
    return ".".join(names), kind


def _list_options(kind: Any) -> list[Any]:
    """Return the types that a key may have, without None."""
    kind = _strip_metadata(kind)
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return [_strip_metadata(option) for option in kinds if option is not type(None)]


def _strip_metadata(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _list_tags(kind: Any) -> tuple[Any, ...]:
    """Return the values of the key `kind` that select a section of a discriminated union."""
    field = kind.model_fields.get("kind") if _is_section(kind) else None
    return get_args(field.annotation) if field and get_origin(field.annotation) is Literal else ()


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _describe_type(kind: Any) -> str:
    """Return a description of the values of a type."""
    return " or ".join(dict.fromkeys(_describe_option(option) for option in _list_options(kind)))


def _describe_option(kind: Any) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return "one of " + ", ".join(inner) if len(inner) > 1 else f'"{inner[0]}"'
    if origin is tuple:
        items = (
            TYPE_DESCRIPTIONS[inner[0]][1]
            if inner[0] in TYPE_DESCRIPTIONS
            else ", ".join(get_args(inner[0]))
        )
        return f"a list of {items if inner[-1] is Ellipsis else f'{len(inner)} {items}'}"
    if _is_section(kind):
        required = [name for name, field in kind.model_fields.items() if field.is_required()]
        return (
            "a mapping with " + ", ".join(required) if required else "a mapping of keys to values"
        )
    return (
        TYPE_DESCRIPTIONS[kind][0] if kind in TYPE_DESCRIPTIONS else "a mapping of keys to values"
    )


def _suggest_value(kind: Any, value: Any) -> str:
    """Return a correction of a value that is nearly valid, or an empty string."""
    options = _list_options(kind)
    choices = [c for k in options if get_origin(k) is Literal for c in get_args(k)]
    if choices:
        return suggest_name(value, choices)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if is_number and any(get_args(k) == (float, Ellipsis) for k in options):
        return f"write [{short_repr(value)}]"
    quoted = str in options and isinstance(value, (int, float, date))
    return "put it into quotes" if quoted else ""
