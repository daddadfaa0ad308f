"""Base class of configuration sections, their types of values, and the section `fit`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Annotated, Any, Literal, get_args, get_origin

import pandas as pd
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
)
from pydantic_core import PydanticCustomError

from splits.analysis.measured import WAVELENGTH_COLUMN
from splits.core.validation import check_choice, invalid
from splits.retrieval.sand_fit import resolve_ranges

MAX_LABEL_CHARS = 80
MAX_TITLE_CHARS = 200
MAX_CAPTION_CHARS = 5000
FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
"""File suffixes of figures."""


def check_text(key: str, value: str, max_chars: int, multiline: bool = False) -> str:
    """Return a printable text of one or several lines; reject others."""
    if len(value) > max_chars:
        raise invalid(key, value, f"at most {max_chars} characters")
    joined = value.replace("\n", "").replace("\t", "") if multiline else value
    if not joined.isprintable():
        raise invalid(key, value, "text without control characters or line breaks")
    return value


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


def check_mathematics(value: str) -> str:
    """Return a text that may contain formulas between dollar signs; reject invalid formulas."""
    # A single dollar sign starts no formula.
    n_dollars = value.count("$") - value.count(r"\$")
    if n_dollars < 2 or n_dollars % 2:
        return value
    from matplotlib.mathtext import MathTextParser  # a figure's job loads it anyway

    try:
        MathTextParser("path").parse(value)
    except (ValueError, RuntimeError):
        hint = r"write \$ for a dollar sign"
        raise invalid("", value, "text that matplotlib can typeset", hint) from None
    return value


def check_measured_file(name: str) -> str:
    """Return the name of a file of config/measured; reject paths to other folders."""
    if not name.isprintable() or len(name) > 100 or PurePath(name).name != name or "\\" in name:
        raise invalid("", name, "the name of a file of config/measured, without folders")
    return check_path("", name)


def check_different(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names; reject none at all and repeated ones."""
    if not names or len(set(names)) < len(names):
        raise invalid("", list(names), "at least one, without repetition")
    return names


def check_interval(limits: tuple[float, float]) -> tuple[float, float]:
    """Return the limits of an interval; reject an empty one."""
    if not limits[0] < limits[1]:
        raise invalid("", list(limits), "low < high")
    return limits


def accept_single(kind: Any) -> BeforeValidator:
    """Return the validator of a list, in place of which a single text or mapping may be given."""

    def to_tuple(value: Any) -> Any:
        return (value,) if isinstance(value, str | dict) else value

    return BeforeValidator(to_tuple, json_schema_input_type=kind | tuple[kind, ...])


# Validators raise errors with a key relative to their section, or without one for their own field;
# `splits.experiments.config.messages` prefixes the rest.
Label = Annotated[str, AfterValidator(lambda text: check_text("", text, MAX_LABEL_CHARS))]
Title = Annotated[
    str,
    AfterValidator(lambda text: check_text("", text, MAX_TITLE_CHARS)),
    WithJsonSchema({"type": "string", "maxLength": MAX_TITLE_CHARS}),
]
Caption = Annotated[str, AfterValidator(lambda text: check_text("", text, MAX_CAPTION_CHARS, True))]
MeasuredFile = Annotated[str, AfterValidator(check_measured_file)]
Interval = Annotated[tuple[float, float], AfterValidator(check_interval)]


def _iter_types(annotation: Any) -> Iterator[Any]:
    """Yield the types in an annotation, without those that contain others."""
    if get_origin(annotation) is Literal:
        return
    parts = get_args(annotation)
    for part in parts:
        yield from _iter_types(part)
    if not parts:
        yield annotation


def _has_boolean(value: Any, mappings: bool) -> bool:
    """Return whether a value is a boolean, or contains one in its lists and optionally mappings."""
    if mappings and isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return any(_has_boolean(part, mappings) for part in value)
    return isinstance(value, bool)


class ConfigSection(BaseModel):
    """A configuration section: immutable, and unknown keys are rejected."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, ser_json_inf_nan="constants", use_attribute_docstrings=True
    )

    @field_validator("*", mode="before")
    @classmethod
    def _reject_booleans(cls, value: Any, info: ValidationInfo) -> Any:
        # Pydantic would convert true to the number 1. Nested sections check their own fields.
        types = set(_iter_types(cls.model_fields[str(info.field_name)].annotation))
        has_section = any(isinstance(one, type) and issubclass(one, BaseModel) for one in types)
        if not {bool, Any} & types and _has_boolean(value, mappings=not has_section):
            raise PydanticCustomError("no_switch", "true or false")
        return value


class FiniteSection(ConfigSection):
    """A section whose numbers are finite."""

    model_config = ConfigDict(allow_inf_nan=False)


class FitSection(ConfigSection):
    """Measured spectra to which sands are fitted."""

    measured: MeasuredFile
    """name of a file of `config/measured/`, with a column `wavelength_nm` and a column of
    reflectances (fractions, no gaps) per sample"""
    samples: tuple[str, ...] = ()
    """samples to fit; by default all"""
    ranges: dict[str, tuple[float, float]] = Field({})
    """(low, high) by parameter; by default those of SPLITS Table 2"""

    @field_validator("ranges")
    @classmethod
    def _check_ranges(cls, value: dict[str, Any]) -> dict[str, Any]:
        resolve_ranges(value)
        return value


def list_samples(section: str, measured: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Return the samples of a measured table that a section names, by default all.

    Unknown samples, and tables without wavelengths or names of columns, are rejected.
    """
    key = f"{section}.measured"
    if WAVELENGTH_COLUMN not in measured:
        raise invalid(key, list(measured.columns), f"a table with column {WAVELENGTH_COLUMN}")
    available = [str(name) for name in measured.columns if name != WAVELENGTH_COLUMN]
    if any(name.startswith("Unnamed") for name in available):
        hint = "a column of row numbers? write the table with index=False"
        raise invalid(key, "a column without a name", "names for all", hint)
    return [check_choice(f"{section}.samples", name, available) for name in names] or available
