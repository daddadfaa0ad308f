"""Sphinx directives for tables of configuration keys, generated from their models."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

from docutils import nodes
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from splits.experiments.config.figure import INSTRUMENT_FIGURES, INSTRUMENT_QUANTITIES
from splits.experiments.config.instruments import INSTRUMENT_KINDS


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


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


def allowed(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """Return the allowed values that a schema describes: their types and limits."""
    if "$ref" in schema:
        return allowed(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    options = schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf")
    if options:
        others = [one for one in options if one.get("type") != "null"]
        return " or ".join(dict.fromkeys(allowed(one, definitions) for one in others))
    names = [f"`{name}`" for name in schema.get("enum", [schema.get("const")]) if name is not None]
    if names:
        return f"one of {', '.join(names)}" if len(names) > 1 else names[0]
    kind = schema.get("type", "object")
    if kind == "array":
        items, count = schema.get("items"), ""
        if "prefixItems" in schema:
            items, count = schema["prefixItems"][0], f"{len(schema['prefixItems'])} "
        described = allowed(items or {}, definitions)
        if described.startswith("one of "):
            return f"a list of {described.removeprefix('one of ')}"
        described = described.partition(", ")[0]
        plurals = dict(TYPES.values())
        return f"a list of {count}{plurals.get(described, described.replace('a list', 'lists'))}"
    if kind == "object" and schema.get("required") and "kind" not in schema["properties"]:
        return f"a mapping with {', '.join(f'`{key}`' for key in schema['required'])}"
    # Limits of all integers and of labels are not stated.
    limits = [
        f"{word} {schema[key]:g}"
        for key, word in LIMITS.items()
        if key in schema and schema[key] != 2**63
    ]
    return ", ".join([TYPES[kind][0], *limits])


def list_rows(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """Return key, meaning, allowed values and default of each key of a model."""
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})
    return [
        (
            f"`{key}`",
            meaning(field),
            allowed(schema["properties"][key], definitions),
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
    if value is None or value in ("", (), {}) or isinstance(value, BaseModel):
        return "—"
    return f"`{value if isinstance(value, str) else json.dumps(value)}`"


class Keys(SphinxDirective):
    """``{config-keys} MODULE.MODEL``: a row for each key."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        module, name = self.arguments[0].rsplit(".", 1)
        rows = [list(row) for row in list_rows(getattr(import_module(module), name))]
        return self.parse_text_to_nodes(table(["key", "meaning", "allowed", "default"], rows))


def describe(model: type[BaseModel]) -> str:
    """Return the first paragraph of the docstring of a model."""
    return " ".join(str(model.__doc__).split("\n\n")[0].split()).rstrip(".")


class Instruments(SphinxDirective):
    """``{instrument-kinds}``: description and figures of each kind of instrument."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for kind, model in INSTRUMENT_KINDS.items():
            columns = INSTRUMENT_FIGURES[kind], INSTRUMENT_QUANTITIES.get(kind, ())
            cells = [", ".join(f"`{name}`" for name in column) or "—" for column in columns]
            rows.append([f"`{kind}`", describe(model), *cells])
        head = ["`instrument.kind`", "description", "`figure.kind`", "`figure.quantity`"]
        return self.parse_text_to_nodes(table(head, rows))


def list_union_keys(models: dict[str, type[BaseModel]]) -> list[list[str]]:
    """Return a row for each key of the models of a union, with the kinds that have it."""
    kinds: dict[tuple[str, ...], list[str]] = {}
    for kind, model in models.items():
        for row in list_rows(model):
            if row[0] != "`kind`":
                kinds.setdefault(row, []).append(f"`{kind}`")
    rows = [
        [key, meaning, "all" if len(owners) == len(models) else ", ".join(owners), *others]
        for (key, meaning, *others), owners in kinds.items()
    ]
    return sorted(rows, key=lambda row: [one[0] for one in kinds].index(row[0]))


class InstrumentKeys(SphinxDirective):
    """``{instrument-keys}``: a row for each key of instruments, with the kinds that have it."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        head = ["key", "meaning", "kinds", "allowed", "default"]
        return self.parse_text_to_nodes(table(head, list_union_keys(INSTRUMENT_KINDS)))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    for name, directive in (
        ("config-keys", Keys), ("instrument-kinds", Instruments),
        ("instrument-keys", InstrumentKeys),
    ):  # fmt: skip
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
