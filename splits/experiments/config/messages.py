"""One-line messages for validation errors of pydantic: key, value, allowed values and a hint."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from splits.core.validation import (
    InvalidValue,
    format_key,
    invalid,
    short_repr,
    suggest_name,
    suggest_number,
)
from splits.media.formatting import NAMED_MEDIA
from splits.media.kinds import MEDIUM_CLASSES
from splits.plotting.panels import FIGURE_SETTINGS

MAPPING = "a mapping of keys to values"
ALLOWED = {
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "too_long": "a list of {max_length} values",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "missing": "given",
}
"""What is allowed, by the type of an error of pydantic; others are of mappings."""

SectionType = TypeVar("SectionType", bound=BaseModel)


def validate_content(model: type[SectionType], content: Any) -> SectionType:
    """Return the model of some content; raise a one-line error for invalid content."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise _make_message(error, content) from None


def _make_message(error: ValidationError, content: Any) -> ValueError:
    """Return the error of the deepest key, for which the branches of a union are joined."""
    errors = [(_locate(one["loc"], one["type"], content), one) for one in error.errors()]
    location, _ = max(errors, key=lambda one: (len(one[0]), one[1]["type"] != "missing"))
    branches = [one for other, one in errors if other == location]
    first = next((one for one in branches if one["type"] == "value_error"), branches[0])
    key = _join_keys(location)
    kind, value = first["type"], first["input"]
    if kind == "value_error":
        return _add_section(key, first["ctx"]["error"])
    if kind == "missing" and isinstance(location[-1], int):
        # A list of a certain number of values has too few.
        return invalid(
            _join_keys(location[:-1]), value, f"a list of {len(errors) + len(value)} values"
        )
    if kind == "missing":
        return invalid(key, None, "given")
    if kind == "union_tag_not_found" and isinstance(value, Mapping):
        return invalid(f"{key}.kind", None, "given")
    if kind == "union_tag_invalid" and isinstance(value, Mapping):
        tags = re.findall("'(.*?)'", first["ctx"]["expected_tags"])
        given = value["kind"]
        return invalid(f"{key}.kind", given, f"one of {', '.join(tags)}", suggest_name(given, tags))
    allowed = " or ".join(dict.fromkeys(map(_describe, branches)))
    return invalid(key, value, allowed, _suggest(key, value, branches))


def _locate(location: Sequence[Any], kind: str, content: Any) -> tuple[Any, ...]:
    """Return the keys in the location of an error, without the branches of unions.

    They are those that the content has, and the last one if it is missing.
    """
    keys = []
    for part in location:
        known = range(len(content)) if isinstance(content, list | tuple) else content
        if isinstance(known, Mapping | range) and part in known:
            content = content[part]
        elif part != "[key]" and (kind != "missing" or part != location[-1]):
            continue
        keys.append(part)
    return tuple(keys)


def _join_keys(location: Sequence[Any]) -> str:
    # A key that is itself invalid is the value of the error.
    keys, mark = (location[:-2], " (key)") if "[key]" in location else (location, "")
    parts = [f"[{one}]" if isinstance(one, int) else f".{format_key(one)}" for one in keys]
    return "".join(parts).removeprefix(".") + mark


def _add_section(location: str, error: Exception) -> ValueError:
    """Return the error of a validator, with the location before its key.

    The key may be complete, or repeat the name of the field that a validator checks.
    """
    if not isinstance(error, InvalidValue):
        return ValueError(str(error))
    section, _, field = location.rpartition(".")
    first = re.split(r"\W", error.key, maxsplit=1)[0]
    if first == location.partition(".")[0]:
        return error
    return error.add_prefix(section if first == field else location)


def _describe(error: Any) -> str:
    """Return what an error of pydantic allows."""
    if error["type"] == "literal_error":
        names = re.findall("'(.*?)'", error["ctx"]["expected"])
        return f"one of {', '.join(names)}" if len(names) > 1 else f'"{names[0]}"'
    context = error.get("ctx", {}).items()
    limits = {key: f"{limit:g}" if isinstance(limit, float) else limit for key, limit in context}
    return ALLOWED.get(error["type"], MAPPING).format(**limits)


def _suggest(key: str, value: Any, errors: Sequence[Any]) -> str:
    """Return a correction of a value that is nearly valid, or an empty string."""
    kinds = {error["type"] for error in errors}
    expected = " ".join(error.get("ctx", {}).get("expected", "") for error in errors)
    if names := re.findall("'(.*?)'", expected):
        return suggest_name(value, names)
    if isinstance(value, str):
        # A kind of instrument in place of its section is also the branch of the error.
        if hint := suggest_mapping(key, value, [errors[0]["loc"][-1]]):
            return hint
        if "tuple_type" in kinds and "," in value:
            return f"write [{value}]"
        return suggest_number(value) if "float_type" in kinds else ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if "tuple_type" in kinds:
            return f"write [{short_repr(value)}]"
        return "put it into quotes" if "string_type" in kinds else ""
    return ""


def suggest_mapping(key: str, value: Any, kinds: Sequence[Any]) -> str:
    """Return a hint for a text in place of a section of one of several kinds, or ""."""
    if key == "medium" and value in NAMED_MEDIA:
        return f"write {key}: {{base: {value}}}"
    kinds = {"medium": [*MEDIUM_CLASSES], "figure": [*FIGURE_SETTINGS]}.get(key, kinds)
    return f"write {key}: {{kind: {value}, …}}" if value in kinds else ""
