"""One-line messages for validation errors of pydantic: key, value, allowed values and a hint."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from splits.core.validation import (
    InvalidValue,
    format_key,
    invalid,
    short_repr,
    suggest_name,
    suggest_number,
    unknown_key,
)
from splits.media.formatting import NAMED_MEDIA
from splits.media.kinds import MEDIUM_CLASSES

TYPE_DESCRIPTIONS = {
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "names"),
}
"""Descriptions of a value of a type, and of a list of such values."""
LIMIT_DESCRIPTIONS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


SectionType = TypeVar("SectionType", bound=BaseModel)


def validate_content(model: type[SectionType], content: Any) -> SectionType:
    """Return the model of some content; raise a one-line error for invalid content."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ValueError(format_validation_error(model, error)) from None


def format_validation_error(model: type[BaseModel], error: ValidationError) -> str:
    """Return the first validation error as one line: key, value, allowed values and a hint."""
    # Unknown keys come first, since a misspelt key also causes a missing one.  Of the branches of
    # a union, the deepest error belongs to the branch that was meant.
    errors: list[Any] = error.errors(include_url=False)
    first = max(
        errors,
        key=lambda e: (e["type"] == "extra_forbidden", len(e["loc"]), e["type"] != "missing"),
    )
    location, error_type, value = first["loc"], first["type"], first["input"]
    if error_type in ("extra_forbidden", "invalid_key"):
        return str(_make_key_error(model, location, value))
    of_list = error_type == "missing" and isinstance(location[-1], int)
    key, kind = _resolve_location(model, location[:-1] if of_list else location)
    if error_type == "value_error":
        return _prefix_message(key, first["ctx"]["error"])
    if error_type in ("union_tag_invalid", "union_tag_not_found"):
        tags = [tag for option in list_options(kind) for tag in list_tags(option)]
        if not isinstance(value, Mapping):
            hint = suggest_mapping(key, value, tags)
            return str(invalid(key, value, "a mapping of keys to values", hint))
        if "kind" not in value:
            return f"{key}.kind: missing, must be one of {', '.join(tags)}"
        hint = suggest_name(value["kind"], tags)
        return str(invalid(f"{key}.kind", value["kind"], f"one of {', '.join(tags)}", hint))
    if error_type == "missing" and not of_list:
        return f"{key}: missing, must be {describe_type(kind)}"
    limits = describe_limits(first.get("ctx", {}))
    finite = "finite " if error_type == "finite_number" else ""
    allowed = limits or describe_type(kind).replace("a number", f"a {finite}number")
    if error_type == "literal_error" and len(_list_alternatives(model, location)) > 1:
        allowed += f" for {location[-2]}"
    return str(invalid(key, value, allowed, _suggest_value(key, kind, value)))


def _make_key_error(model: type[BaseModel], location: Sequence[Any], value: Any) -> InvalidValue:
    """Return the error for a key that its section does not have, but perhaps another kind of it."""
    name = location[-1]
    section, kind = _resolve_location(model, location[:-1])
    key, option = f"{section}.{name}".lstrip("."), next(filter(is_section, list_options(kind)))
    union = _list_alternatives(model, location)
    owners = [tag for one in union if name in one.model_fields for tag in list_tags(one)]
    if owners:
        hint = f"it belongs to {', '.join(owners)}"
        return invalid(key, value, f"left out for {location[-2]}", hint)
    return unknown_key(key, option.model_fields)


def _list_alternatives(model: type[BaseModel], location: Sequence[Any]) -> list[Any]:
    """Return the sections of a tagged union, at the location of a key of one of them."""
    # The tag of the section is the last part of the location before the key.
    _, kind = _resolve_location(model, location[:-2])
    options = list_options(kind) if len(location) > 1 else []
    return options if any(location[-2] in list_tags(option) for option in options) else []


def _prefix_message(location: str, error: Exception) -> str:
    """Return the message of a validator's error, with the location before its key."""
    if not isinstance(error, InvalidValue):
        return str(error)
    # The key of an error may be complete, or repeat the name of the field that a validator checks.
    section, _, field = location.rpartition(".")
    first = re.split(r"\W", error.key, maxsplit=1)[0]
    if first == location.partition(".")[0]:
        return str(error)
    return str(error.add_prefix(section if first == field else location))


def _resolve_location(model: type[BaseModel], location: Sequence[Any]) -> tuple[str, Any]:
    """Return the key at a location of an error, and the type of its value.

    Locations also contain the names of branches of unions, which are skipped.
    """
    kind: Any = model
    names: list[str] = []
    for part in location:
        if part == "[key]":
            kind, names = str, [*names[:-2], f"{names[-2]} (key)"]
            continue
        options = list_options(kind)
        tagged = [option for option in options if part in list_tags(option)]
        if len(options) > 1 and tagged:
            kind = tagged[0]
            continue
        for option in options:
            inner = get_args(option)
            if get_origin(option) is tuple and isinstance(part, int):
                kind, names[-1] = inner[0], f"{names[-1]}[{part}]"
                break
            if is_section(option) and part in option.model_fields:
                kind = option.model_fields[part].annotation
            elif get_origin(option) is dict:
                kind = inner[1]
            else:
                continue
            names.append(format_key(part))
            break
    return ".".join(names), kind


def list_options(kind: Any) -> list[Any]:
    """Return the types that a key may have, without None."""
    kind = _strip_metadata(kind)
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return [_strip_metadata(option) for option in kinds if option is not type(None)]


def _strip_metadata(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def list_tags(kind: Any) -> tuple[Any, ...]:
    """Return the values of the key `kind` that select a section of a discriminated union."""
    field = kind.model_fields.get("kind") if is_section(kind) else None
    return get_args(field.annotation) if field and get_origin(field.annotation) is Literal else ()


def is_section(kind: Any) -> bool:
    """Return whether a type is a section of keys."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def describe_limits(limits: Mapping[str, Any]) -> str:
    """Return a description of the limits of a number, such as "at least 1"."""
    return ", ".join(
        f"{LIMIT_DESCRIPTIONS[k]} {v if isinstance(v, int) else f'{v:g}'}"
        for k, v in limits.items() if k in LIMIT_DESCRIPTIONS
    )  # fmt: skip


def describe_type(kind: Any, quote: str = "") -> str:
    """Return a description of the values of a type, with names in quotation marks."""
    options = list_options(kind)
    if len(options) > 1 and all(map(list_tags, options)):
        return "a mapping of keys to values"
    return " or ".join(dict.fromkeys(_describe_option(option, quote) for option in options))


def _describe_option(kind: Any, quote: str) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if kind in TYPE_DESCRIPTIONS:
        return TYPE_DESCRIPTIONS[kind][0]
    if origin is Literal:
        names = ", ".join(f"{quote}{name}{quote}" for name in inner)
        return f"one of {names}" if len(inner) > 1 else names if quote else f'"{names}"'
    if origin is tuple:
        (item,) = set(list_options(inner[0]))
        _, items = TYPE_DESCRIPTIONS.get(item, ("", describe_type(item, quote)))
        count = "" if inner[-1] is Ellipsis else f"{len(inner)} "
        return f"a list of {count}{items.removeprefix('one of ').replace('a list', 'lists')}"
    fields = kind.model_fields if is_section(kind) else {}
    required = [f"{quote}{key}{quote}" for key, field in fields.items() if field.is_required()]
    return f"a mapping with {', '.join(required)}" if required else "a mapping of keys to values"


def suggest_mapping(key: str, value: Any, kinds: Iterable[str]) -> str:
    """Return a hint for a text in place of a section of one of several kinds, or ""."""
    if key == "medium" and value in NAMED_MEDIA:
        return f"write {key}: {{base: {value}}}"
    kinds = MEDIUM_CLASSES if key == "medium" else kinds
    return f"write {key}: {{kind: {value}, …}}" if value in [*kinds] else ""


def _suggest_value(key: str, kind: Any, value: Any) -> str:
    """Return a correction of a value that is nearly valid, or an empty string."""
    options = list_options(kind)
    if isinstance(value, str):
        lists = [option for option in options if get_args(option) == (float, Ellipsis)]
        sections = [option for option in options if "kind" in getattr(option, "model_fields", ())]
        tags = [
            tag
            for section in sections
            for option in list_options(section.model_fields["kind"].annotation)
            for tag in get_args(option)
        ]
        if hint := suggest_mapping(key, value, tags):
            return hint
        if lists and "," in value:
            return f"write [{value}]"
        if float in options:
            return suggest_number(value)
    choices = [c for k in options if get_origin(k) is Literal for c in get_args(k)]
    if choices:
        return suggest_name(value, choices)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if is_number and any(get_args(k) == (float, Ellipsis) for k in options):
        return f"write [{short_repr(value)}]"
    return "put it into quotes" if str in options and isinstance(value, (int, float)) else ""
