"""Base class of configuration sections, and their types of values."""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Strict,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from splits.core.inputs import MaxRays, RelativeError, StandardError
from splits.core.validation import (
    MAX_LABEL_CHARS,
    MAX_TITLE_CHARS,
    check_text,
    invalid,
    unknown_key,
)

MAX_CAPTION_CHARS = 5000


def match_pattern(pattern: re.Pattern[str], allowed: str) -> AfterValidator:
    """Return the validator of a field whose text a pattern describes completely."""

    def check(value: str, info: ValidationInfo) -> str:
        if not pattern.fullmatch(value):
            raise invalid(info.field_name or "", value, allowed)
        return value

    return AfterValidator(check)


def check_path(key: str, value: str) -> str:
    """Return the path of a folder or file; reject one that Snakemake would read as a pattern."""
    if not value.isprintable() or set(value) & set("{}<>"):
        allowed = "a path without { } < > and control characters"
        raise invalid(key, value, allowed, "Snakemake reads braces as wildcards")
    return value


def check_measured_file(name: str) -> str:
    """Return the name of a file of config/measured; reject paths to other folders."""
    if not name.isprintable() or len(name) > 100 or PurePath(name).name != name or "\\" in name:
        raise invalid("", name, "the name of a file of config/measured, without folders")
    return check_path("", name)


def accept_single(kind: Any) -> BeforeValidator:
    """Return the validator of a list, in place of which a single text or mapping may be given."""

    def to_tuple(value: Any) -> Any:
        return (value,) if isinstance(value, str | dict) else value

    return BeforeValidator(to_tuple, json_schema_input_type=kind | tuple[kind, ...])


# Validators raise errors with a key relative to their section, or without one for their own field;
# `splits.experiments.config.load.validate_content` prefixes the rest.
Number = Annotated[float, Strict()]
Label = Annotated[str, AfterValidator(lambda text: check_text("", text, MAX_LABEL_CHARS))]
Title = Annotated[
    str,
    AfterValidator(lambda text: check_text("", text, MAX_TITLE_CHARS)),
    WithJsonSchema({"type": "string", "maxLength": MAX_TITLE_CHARS}),
]
Caption = Annotated[str, AfterValidator(lambda text: check_text("", text, MAX_CAPTION_CHARS, True))]
MeasuredFile = Annotated[str, AfterValidator(check_measured_file)]


class ConfigSection(BaseModel):
    """A configuration section: immutable, and unknown keys are rejected."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, ser_json_inf_nan="constants", use_attribute_docstrings=True
    )

    @model_validator(mode="before")
    @classmethod
    def _reject_unknown_keys(cls, content: Any) -> Any:
        """Reject an unknown key."""
        for key in content if isinstance(content, dict) else ():
            if key not in cls.model_fields:
                raise unknown_key(str(key), cls.model_fields)
        return content


class FiniteSection(ConfigSection):
    """A section whose numbers are finite."""

    model_config = ConfigDict(allow_inf_nan=False)


class Accuracy(ConfigSection):
    """Target standard errors and the limit of rays of simulations."""

    max_stderr: StandardError
    """largest standard error of a hemispherical quantity"""
    relative_stderr: RelativeError = 0.02
    """largest relative standard error of a value by direction or position"""
    max_rays: MaxRays | None = None
    """largest number of rays per spectrum, or per set of spectra that share paths, even if the
    target error is not reached; by default that of the instrument"""
