"""Sphinx directives for tables of configuration keys and of keywords, from their declarations."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from inspect import Parameter, signature
from typing import Any

import numpy as np
from docutils import nodes
from numpydoc.docscrape import FunctionDoc
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import splits
from splits.core.declarations import UNIT_SYMBOLS, Input, list_inputs
from splits.core.discovery import load_instruments
from splits.experiments.config.experiment import INSTRUMENT_QUANTITIES, list_figure_inputs
from splits.experiments.config.instruments import (
    FUNCTIONS,
    KINDS,
    Instrument,
    list_section_inputs,
)
from splits.media.kinds import MEDIUM_FACTORIES
from splits.plotting.figure import FIGURES, list_instrument_figures

MAX_NUMBERS = 6
"""Longest sequence of numbers of which all are shown."""


def table(head: list[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# --------------------------------------------------------------------------------------------------
# Allowed values and defaults, as text.

TYPES = {
    "integer": ("a whole number", "whole numbers"), "number": ("a number", "numbers"),
    "string": ("text", "names"), "boolean": ("true or false", ""),
    "object": ("a mapping of keys to values", "mappings"), "array": ("a list", "lists"),
}  # fmt: skip
"""Descriptions of a value of a type of JSON schemas, and of a list of such values."""
LIMITS = {
    "exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below",
    "maximum": "at most",
}  # fmt: skip


def allowed(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Return the allowed values that a schema describes: their types and limits."""
    if "$ref" in schema:
        return allowed(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    options = schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf")
    types = schema.get("type")
    if isinstance(types, list):
        options = [{**schema, "type": one} for one in types]
    if options:
        # A list may also be a single one of its values.
        several = [one["items"] for one in options if one.get("items")]
        others = [one for one in options if one.get("type") != "null" and one not in several]
        texts = dict.fromkeys(
            allowed(one, definitions)
            .replace("a list of `", "one or several of `", 1)
            .replace("a list of", "one or several", 1)
            if one.get("items") in options
            else allowed(one, definitions)
            for one in others
        )
        return ("; or " if any(", " in text for text in texts) else " or ").join(texts)
    names = [f"`{name}`" for name in schema.get("enum", [schema.get("const")]) if name is not None]
    if names:
        return f"one of {', '.join(names)}" if len(names) > 1 else names[0]
    # Limits of all integers and of labels are not stated.
    limits = [
        f"{word} {show_number(schema[key])}"
        for key, word in LIMITS.items()
        if key in schema and schema[key] < 2**63 - 1
    ]
    if types == "array":
        return ", ".join([_describe_list(schema, definitions), *limits])
    if types == "object" and schema.get("required") and "kind" not in schema["properties"]:
        required = ", ".join(f"`{key}`" for key in schema["required"])
        optional = [key for key in schema["properties"] if key not in schema["required"]]
        # The keys of a model have a table of their own.
        more = ", ".join(f"`{key}`" for key in optional if "title" not in schema)
        return f"a mapping with {required}" + (f", possibly {more}" if more else "")
    return ", ".join([TYPES[types][0], *limits]) if types else ""


def _describe_list(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Return the description of a list, with the names of its values if there are any."""
    items, count, names = schema.get("items", {}), "", ""
    if "prefixItems" in schema:
        members = schema["prefixItems"]
        items, count = members[0], f"{len(members)} "
        if all("description" in one for one in members):
            names = f" ({', '.join(one['description'] for one in members)})"
    described = allowed(items, definitions)
    if described.startswith("one of "):
        return f"a list of {described.removeprefix('one of ')}"
    described, comma, limits = described.partition(", ")
    plurals = dict(TYPES.values())
    plural = plurals.get(described) or re.sub(r"^a (list|mapping)", r"\1s", described)
    return f"a list of {count}{plural}{names}{comma}{limits}" if plural else "a list"


def show_number(value: float) -> str:
    """Return a number with up to six digits."""
    return re.sub(r"e([+-])0*", lambda sign: "e" + sign[1].strip("+"), f"{value:g}")


def describe_allowed(one: Input) -> str:
    """Return the allowed values of a declared input, an empty text if its schema has none."""
    quantity, text = one.quantity, allowed(one.make_schema(), {})
    if quantity.infinite:
        text += f", at most {show_number(quantity.high)}" if quantity.high < math.inf else ""
        text += ", or infinite"
    return text


def show_default(value: Any, *, as_yaml: bool = False) -> str:
    """Return a default as text, as in a file or as in Python."""
    is_empty = value is None or (isinstance(value, str | tuple | Mapping) and not value)
    if value is Parameter.empty:
        return "required"
    if is_empty or "FACTORY" in type(value).__name__:
        return "—"
    if isinstance(value, float) and math.isinf(value):
        return "infinite"
    return f"`{_show(value, as_yaml)}`"


def _show(value: Any, as_yaml: bool) -> str:
    if isinstance(value, str):
        return value if as_yaml else f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower() if as_yaml else str(value)
    if isinstance(value, float):
        return show_number(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_show(one, as_yaml)}" for key, one in value.items()) + "}"
    if isinstance(value, tuple | list | np.ndarray):
        values = value.tolist() if isinstance(value, np.ndarray) else value
        shown = [_show(one, as_yaml) for one in values]
        shown = shown if len(shown) <= MAX_NUMBERS else [*shown[:2], "…", shown[-1]]
        opening, closing = "[]" if as_yaml else "()"
        return f"{opening}{', '.join(shown)}{closing}"
    return _show(value.as_input(), as_yaml) if hasattr(value, "as_input") else str(value)


# --------------------------------------------------------------------------------------------------
# Keys of files.


def list_rows(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """Return key, meaning, allowed values and default of each key of a model."""
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})
    return [
        (
            f"`{key}`",
            meaning(field),
            allowed(schema["properties"][key], definitions) or TYPES["object"][0],
            default(field),
        )
        for key, field in model.model_fields.items()
    ]


def meaning(field: FieldInfo) -> str:
    """Return the description of a field as one line."""
    return " ".join(str(field.description).split())


def default(field: FieldInfo) -> str:
    """Return the default of a field."""
    if field.is_required():
        return "—" if "by default" in str(field.description) else "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ("", (), {}) or isinstance(value, BaseModel | Instrument):
        return "—"
    return f"`{value if isinstance(value, str) else json.dumps(value)}`"


class Keys(SphinxDirective):
    """``{config-keys} MODULE.MODEL``: a row for each key."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        module, name = self.arguments[0].rsplit(".", 1)
        rows = list_rows(getattr(import_module(module), name))
        return self.parse_text_to_nodes(table(["key", "meaning", "allowed", "default"], rows))


def describe(function: Callable[..., Any]) -> str:
    """Return the first paragraph of a docstring."""
    return " ".join(str(function.__doc__).split("\n\n")[0].split()).rstrip(".")


class Instruments(SphinxDirective):
    """``{instrument-kinds}``: description and figures of each kind of instrument."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for kind in KINDS:
            columns = list_instrument_figures(kind), INSTRUMENT_QUANTITIES.get(kind, ())
            cells = [", ".join(f"`{name}`" for name in column) or "—" for column in columns]
            rows.append([f"`{kind}`", describe(FUNCTIONS.get(kind, splits.build_table)), *cells])
        head = ["`instrument.kind`", "description", "`figure.kind`", "`figure.quantity`"]
        return self.parse_text_to_nodes(table(head, rows))


def list_section_rows(kind: str) -> list[tuple[str, str, str, str]]:
    """Return key, meaning, allowed values and default of each key of a kind of instrument."""
    return [
        (
            f"`{key}`",
            one.quantity.describe(),
            describe_allowed(one) or "—",
            show_default(one.default, as_yaml=True),
        )
        for key, one in list_section_inputs(kind).items()
    ]


def list_instrument_keys() -> list[list[str]]:
    """Return a row for each key of instruments, with the kinds that have it."""
    kinds: dict[tuple[str, ...], list[str]] = {}
    for kind in KINDS:
        for row in list_section_rows(kind):
            kinds.setdefault(row, []).append(f"`{kind}`")
    keys = list(dict.fromkeys(key for key, *_ in kinds))
    rows = [
        [key, meaning, "all" if len(owners) == len(KINDS) else ", ".join(owners), *others]
        for (key, meaning, *others), owners in kinds.items()
    ]
    return sorted(rows, key=lambda row: keys.index(row[0]))


def list_figure_keys() -> list[list[str]]:
    """Return a row for each key of the section `figure`, with the kinds that have it."""
    rows = []
    for key, one in list_figure_inputs().items():
        kinds = [f"`{kind}`" for kind, figure in FIGURES.items() if key in list_inputs(figure.draw)]
        rows.append(
            [f"`{key}`", str(one.quantity), ", ".join(kinds) or "all", describe_allowed(one)]
        )
    return rows


class FigureKeys(SphinxDirective):
    """``{figure-keys}``: a row for each key of the section `figure`."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = list_figure_keys()
        return self.parse_text_to_nodes(table(["key", "meaning", "kinds", "allowed"], rows))


class InstrumentKeys(SphinxDirective):
    """``{instrument-keys}``: a row for each key of instruments, with the kinds that have it."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        head = ["key", "meaning", "kinds", "allowed", "default"]
        return self.parse_text_to_nodes(table(head, list_instrument_keys()))


# --------------------------------------------------------------------------------------------------
# Keywords of functions and classes.


def find_object(name: str) -> tuple[Any, Any]:
    """Return an object for its full name, and the class or function that declares its inputs.

    The inputs of another constructor of a class are those of the class.
    """
    module, parts = name.split("."), []
    while True:
        try:
            found = owner = import_module(".".join(module))
            break
        except ModuleNotFoundError:
            parts.insert(0, module.pop())
    for part in parts:
        owner, found = found, getattr(found, part)
    return found, owner if isinstance(owner, type) else found


def list_keywords(name: str) -> dict[str, tuple[str, str, str, str]]:
    """Return meaning, unit, allowed values and default of each keyword of a function or class.

    The docstring describes keywords that are not declared.
    """
    found, declaring = find_object(name)
    declared: dict[str, Input] = list_inputs(declaring)
    documented = {
        own_name: parameter
        for parameter in FunctionDoc(found)["Parameters"]
        for own_name in parameter.name.split(", ")
    }
    rows = {}
    for keyword, parameter in signature(found).parameters.items():
        one, text = declared.get(keyword), documented.get(keyword)
        shown = show_default(parameter.default)
        if one:
            unit = UNIT_SYMBOLS.get(one.quantity.unit, one.quantity.unit) or "—"
            values = describe_allowed(one) or (text.type if text else "—")
            rows[keyword] = one.quantity.long_name, unit, values, shown
        elif text:
            sentence = " ".join(text.desc).partition(". ")[0].rstrip(".")
            rows[keyword] = " ".join(sentence.split()), "—", text.type or "—", shown
    return rows


def make_keyword_table(names: list[str], only: list[str] | None = None) -> str:
    """Return the table of the keywords of the first object, with the defaults of all."""
    columns = [list_keywords(name) for name in names]
    heads = [f"`{name}`" for name in names] if len(names) > 1 else ["default"]
    rows = [
        [f"`{keyword}`", *cells[:-1], *(column[keyword][-1] for column in columns)]
        for keyword, cells in columns[0].items()
        if only is None or keyword in only
    ]
    return table(["keyword", "meaning", "unit", "allowed", *heads], rows)


class Keywords(SphinxDirective):
    """``{keywords} splits.NAME …``: keywords of the first object, with the defaults of each."""

    required_arguments = 1
    optional_arguments = 9
    option_spec = {"only": str.split}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        text = make_keyword_table(self.arguments, self.options.get("only"))
        return self.parse_text_to_nodes(text)


def list_names(subject: str) -> list[str]:
    """Return the full names of all media, or of all instruments, the public ones of the package."""
    factories = {**MEDIUM_FACTORIES, "stack": splits.Stack}
    objects = factories if subject == "media" else load_instruments()
    public = {one: one.__qualname__.partition(".")[0] in splits.__all__ for one in objects.values()}
    return [
        f"{'splits' if is_public else one.__module__}.{one.__qualname__}"
        for one, is_public in public.items()
    ]


class AllKeywords(SphinxDirective):
    """``{all-keywords} media`` or ``instruments``: a section with a table for each."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        sections = [
            f"### `{name}`\n\n{describe(find_object(name)[0])}: {{py:obj}}`{name}`.\n\n"
            + make_keyword_table([name])
            for name in list_names(self.arguments[0])
        ]
        return self.parse_text_to_nodes("\n\n".join(sections), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    for name, directive in (
        ("config-keys", Keys), ("instrument-kinds", Instruments),
        ("instrument-keys", InstrumentKeys), ("figure-keys", FigureKeys), ("keywords", Keywords),
        ("all-keywords", AllKeywords),
    ):  # fmt: skip
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
