"""Tables of the keys of configuration files, from the models that read them.

A page gives each key its meaning; what is allowed and the default come from the model, unless the
page says them in other words.  A key without a meaning, or a meaning without a key, is a warning.
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
from splits.experiments.config.study_kinds import STUDY_FILES, STUDY_INPUTS, STUDY_PRODUCTS

LOG = logging.getLogger(__name__)
WORDS = {float: "a number", int: "a whole number", str: "text"}
SIGNS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def code(value: Any) -> str:
    """Return a value as YAML has it, in backticks."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_defaults=True)
    if isinstance(value, tuple):
        value = list(value)
    text = yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n...\n")
    return f"`{text.strip()}`"


def words(kind: Any) -> str:
    """Return in words what a type of a field allows."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Literal:
        return ", ".join(code(value) for value in inside)
    if origin in (Union, types.UnionType):
        return " or ".join(words(one) for one in inside if one is not type(None))
    if origin is tuple and inside[-1] is Ellipsis:
        one = words(inside[0])
        return f"several of {one}" if get_origin(inside[0]) is Literal else f"a list: {one} each"
    if origin is tuple:
        return f"{len(inside)} numbers"
    if origin is dict or kind is dict:
        return "a mapping"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "a mapping with " + ", ".join(f"`{key}`" for key in kind.model_fields)
    return WORDS[kind]


def allowed(field: FieldInfo) -> str:
    """Return what a field allows: its type, and its limits."""
    limits = [
        f"{sign} {getattr(one, key):g}"
        for one in field.metadata
        for key, sign in SIGNS.items()
        if getattr(one, key, None) is not None
    ]
    return ", ".join([words(field.annotation), *limits])


def default(field: FieldInfo) -> str:
    """Return a field's default."""
    if field.is_required():
        return "needed"
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
        given = yaml.safe_load("\n".join(self.content))
        for key in sorted(set(fields) ^ set(given)):
            what = "has no meaning" if key in fields else "is none"
            LOG.warning("%s: key %s %s", self.arguments[0], key, what, location=self.get_location())
        rows = []
        for key in (key for key in given if key in fields):
            said = given[key] if isinstance(given[key], dict) else {"meaning": given[key]}
            rows.append(
                [
                    f"`{key}`",
                    said["meaning"],
                    said.get("allowed", allowed(fields[key])),
                    str(said.get("default", default(fields[key]))),
                ]
            )
        return self.parse_text_to_nodes(table(["key", "meaning", "allowed", "default"], rows))


class Instruments(SphinxDirective):
    """``{instrument-kinds}``: what each kind of instrument knows."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for kind, figures in FIGURE_KINDS.items():
            own = [key for key, kinds in INSTRUMENTS_OF_SETTING.items() if kind in kinds]
            needed = REQUIRED_SETTINGS.get(kind, ())
            columns = [
                [f"`{name}`" for name in ESTIMATORS.get(kind, ())],
                [f"`{key}`" + (" (needed)" if key in needed else "") for key in own],
                [f"`{name}`" for name in figures],
                [f"`{name}`" for name in FIGURE_QUANTITIES.get(kind, ())],
            ]
            rows.append([f"`{kind}`", *(", ".join(column) or "—" for column in columns)])
        head = ["`instrument.kind`", "`estimator`", "keys of its own", "`figure.kind`"]
        return self.parse_text_to_nodes(table([*head, "`figure.quantity`"], rows))


class Studies(SphinxDirective):
    """``{study-kinds}``: what each kind of study needs and makes; the body says what it is."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        given = yaml.safe_load("\n".join(self.content))
        for kind in sorted(set(STUDY_PRODUCTS) ^ set(given)):
            LOG.warning("study-kinds: %s", kind, location=self.get_location())
        rows = []
        for kind, meaning in given.items():
            columns = STUDY_INPUTS.get(kind, ()), STUDY_FILES.get(kind, ()), STUDY_PRODUCTS[kind]
            cells = [", ".join(f"`{key}`" for key in column) or "—" for column in columns]
            rows.append([f"`{kind}`", meaning, *cells])
        head = ["kind", "what it is", "roles under `inputs`", "`files`", "makes (`outputs`)"]
        return self.parse_text_to_nodes(table(head, rows))


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the directives."""
    for name, directive in (
        ("config-keys", Keys), ("instrument-kinds", Instruments), ("study-kinds", Studies),
    ):  # fmt: skip
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
