"""Sphinx directives for tables of configuration keys, generated from their models."""

from __future__ import annotations

import json
from importlib import import_module

from docutils import nodes
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from splits.experiments.config.instrument_kinds import INSTRUMENT_KINDS
from splits.experiments.config.messages import (
    LIMIT_DESCRIPTIONS,
    describe_limits,
    describe_type,
)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def allowed(field: FieldInfo) -> str:
    """Return the allowed values of a field: its type and limits, except that of all integers."""
    limits = {
        key: getattr(constraint, key)
        for constraint in field.metadata
        for key in LIMIT_DESCRIPTIONS
        if getattr(constraint, key, 2**63) != 2**63
    }
    described = describe_type(field.annotation, "`"), describe_limits(limits)
    return ", ".join(part for part in described if part)


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
        rows = [
            [f"`{key}`", meaning(field), allowed(field), default(field)]
            for key, field in getattr(import_module(module), name).model_fields.items()
        ]
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
            columns = model.FIGURES, model.QUANTITIES
            cells = [", ".join(f"`{name}`" for name in column) or "—" for column in columns]
            rows.append([f"`{kind}`", describe(model), *cells])
        head = ["`instrument.kind`", "description", "`figure.kind`", "`figure.quantity`"]
        return self.parse_text_to_nodes(table(head, rows))


def list_union_keys(models: dict[str, type[BaseModel]]) -> list[list[str]]:
    """Return a row for each key of the models of a union, with the kinds that have it."""
    kinds: dict[tuple[str, ...], list[str]] = {}
    for kind, model in models.items():
        for key, field in model.model_fields.items():
            row = (f"`{key}`", meaning(field), allowed(field), default(field))
            if key != "kind":
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
