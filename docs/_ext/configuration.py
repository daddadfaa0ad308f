"""Sphinx directives for tables of configuration keys, generated from their models.

A page gives the meaning of each key, unless the model describes it; the allowed values and the
default come from the model unless the page overrides them.  A key without a meaning, or a meaning
without a key, causes a warning.
"""

from __future__ import annotations

import types
from importlib import import_module
from typing import Any, Literal, Union, get_args, get_origin

import yaml
from docutils import nodes
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from splits.experiments.config.instrument import (
    ESTIMATORS,
    INSTRUMENTS_OF_SETTING,
    REQUIRED_SETTINGS,
)
from splits.experiments.config.sections import FIGURE_KINDS, FIGURE_QUANTITIES
from splits.experiments.studies import AnyStudy
from splits.experiments.studies.study import Study

LOG = logging.getLogger(__name__)
WORDS = {float: "a number", int: "a whole number", str: "text"}
SIGNS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def code(value: Any) -> str:
    """Return a value as YAML in backticks."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_defaults=True)
    if isinstance(value, tuple):
        value = list(value)
    text = yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n...\n")
    return f"`{text.strip()}`"


def words(kind: Any) -> str:
    """Return a description of the values of a type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return ", ".join(code(value) for value in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(words(item) for item in arguments if item is not type(None))
    if origin is tuple and arguments[-1] is Ellipsis:
        item = words(arguments[0])
        return (
            f"several of {item}" if get_origin(arguments[0]) is Literal else f"a list: {item} each"
        )
    if origin is tuple:
        return f"{len(arguments)} numbers"
    if origin is dict or kind is dict:
        return "a mapping"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "a mapping with " + ", ".join(f"`{key}`" for key in kind.model_fields)
    return WORDS[kind]


def allowed(field: FieldInfo) -> str:
    """Return the allowed values of a field: its type and limits."""
    limits = [
        f"{sign} {getattr(constraint, key):g}"
        for constraint in field.metadata
        for key, sign in SIGNS.items()
        if getattr(constraint, key, None) is not None
    ]
    return ", ".join([words(field.annotation), *limits])


def default(field: FieldInfo) -> str:
    """Return the default of a field."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ("", (), {}) or isinstance(value, BaseModel):
        return "none"
    return code(value)


class Keys(SphinxDirective):
    """``{config-keys} MODULE.MODEL``: a row per key; the body is YAML, key to meaning.

    A meaning is a text, or a mapping with ``meaning`` and ``allowed`` or ``default`` in words.
    """

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        module, name = self.arguments[0].rsplit(".", 1)
        fields = getattr(import_module(module), name).model_fields
        described = {key: one.description for key, one in fields.items() if one.description}
        meanings = described | (yaml.safe_load("\n".join(self.content)) or {})
        for key in sorted(set(fields) ^ set(meanings)):
            problem = "has no meaning" if key in fields else "does not exist"
            LOG.warning(
                "%s: key %s %s", self.arguments[0], key, problem, location=self.get_location()
            )
        rows = []
        for key in (key for key in meanings if key in fields):
            entry = meanings[key] if isinstance(meanings[key], dict) else {"meaning": meanings[key]}
            rows.append(
                [
                    f"`{key}`",
                    entry["meaning"],
                    entry.get("allowed", allowed(fields[key])),
                    str(entry.get("default", default(fields[key]))),
                ]
            )
        return self.parse_text_to_nodes(table(["key", "meaning", "allowed", "default"], rows))


class Instruments(SphinxDirective):
    """``{instrument-kinds}``: settings and figures of each kind of instrument."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for kind, figures in FIGURE_KINDS.items():
            settings = [key for key, kinds in INSTRUMENTS_OF_SETTING.items() if kind in kinds]
            required = REQUIRED_SETTINGS.get(kind, ())
            columns = [
                [f"`{name}`" for name in ESTIMATORS.get(kind, ())],
                [f"`{key}`" + (" (required)" if key in required else "") for key in settings],
                [f"`{name}`" for name in figures],
                [f"`{name}`" for name in FIGURE_QUANTITIES.get(kind, ())],
            ]
            rows.append([f"`{kind}`", *(", ".join(column) or "—" for column in columns)])
        head = ["`instrument.kind`", "`estimator`", "specific keys", "`figure.kind`"]
        return self.parse_text_to_nodes(table([*head, "`figure.quantity`"], rows))


def list_study_kinds() -> list[type[Study]]:
    """Return the classes of studies, in the order of their union."""
    return [get_args(tagged)[0] for tagged in get_args(get_args(AnyStudy)[0])]


class Studies(SphinxDirective):
    """``{study-kinds}``: description, inputs, files and outputs of each kind of study."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for study in list_study_kinds():
            columns = study.INPUTS, study.FILES, study.PRODUCTS
            cells = [", ".join(f"`{key}`" for key in column) or "—" for column in columns]
            (kind,) = get_args(study.model_fields["kind"].annotation)
            description = " ".join(study.__doc__.split("\n\n")[0].split()).rstrip(".")
            rows.append([f"`{kind}`", description, *cells])
        head = ["kind", "description", "`inputs`", "`files`", "`outputs`"]
        return self.parse_text_to_nodes(table(head, rows))


class StudyKeys(SphinxDirective):
    """``{study-keys}``: a row for each key of studies, with the kinds that have it."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        fields: dict[str, FieldInfo] = {}
        kinds: dict[str, list[str]] = {}
        for study in list_study_kinds():
            (kind,) = get_args(study.model_fields["kind"].annotation)
            for key, field in study.model_fields.items():
                fields.setdefault(key, field)
                kinds.setdefault(key, []).append(f"`{kind}`")
        n_kinds = len(list_study_kinds())
        rows = []
        for key, field in fields.items():
            owners = "all" if len(kinds[key]) == n_kinds else ", ".join(kinds[key])
            values = "see above" if key == "kind" else allowed(field)
            meaning = (Study.model_fields.get(key) or field).description
            rows.append([f"`{key}`", meaning, owners, values, default(field)])
        head = ["key", "meaning", "kinds", "allowed", "default"]
        return self.parse_text_to_nodes(table(head, rows))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    for name, directive in (
        ("config-keys", Keys), ("instrument-kinds", Instruments), ("study-kinds", Studies),
        ("study-keys", StudyKeys),
    ):  # fmt: skip
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
