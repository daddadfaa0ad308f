"""Validation of configuration files by their models, with one-line messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from splits.core.declarations import MAPPING, describe_error
from splits.core.validation import InvalidValue, invalid
from splits.media.formatting import NAMED_MEDIA
from splits.media.kinds import MEDIUM_CLASSES
from splits.plotting.panels import FIGURE_SETTINGS

SectionType = TypeVar("SectionType", bound=BaseModel)


def validate_content(model: type[SectionType], content: Any) -> SectionType:
    """Return the model of some content; raise a one-line error for invalid content."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        described = describe_error(error, content=content)
    if isinstance(described, InvalidValue) and (described.allowed, described.hint) == (MAPPING, ""):
        hint = suggest_mapping(described.key, described.value, ())
        described = invalid(described.key, described.value, MAPPING, hint)
    raise described


def suggest_mapping(key: str, value: Any, kinds: Sequence[Any]) -> str:
    """Return a hint for a text in place of a section of one of several kinds, or ""."""
    if key == "medium" and value in NAMED_MEDIA:
        return f"write {key}: {{base: {value}}}"
    kinds = {"medium": [*MEDIUM_CLASSES], "figure": [*FIGURE_SETTINGS]}.get(key, kinds)
    return f"write {key}: {{kind: {value}, …}}" if value in kinds else ""
