"""Reading YAML files that anyone may have written: bounded, and refused in one line."""

from __future__ import annotations

import copy
import functools
import math
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any, ClassVar

import yaml

from splits.core.validation import format_key, short_repr

MAX_BYTES = 2**20
"""Size of a file."""
MAX_NODES = 50_000
"""Values in a file, those that aliases stand for counted each time."""
MAX_DEPTH = 32
"""Lists and mappings within each other."""
MAX_NUMBER_CHARS = 1000
"""Characters of a number."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names file, key, value and range."""


CORE_SCHEMA = {
    "null": re.compile(r"~|null|Null|NULL|"),
    "bool": re.compile(r"true|True|TRUE|false|False|FALSE"),
    "int": re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    "float": re.compile(
        r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
    ),
    "merge": re.compile("<<"),
}
"""Plain scalars that are no text, by tag: the core schema of YAML 1.2, and merged mappings.

All else is text, such as 1:15, yes, off and 2001-01-01, for which YAML 1.1 has 75, true, false and
a date.  No expression takes more than linear time.
"""
_TAG_PREFIX = "tag:yaml.org,2002:"


def _find_tag(text: str) -> str | None:
    """Return the tag of a plain scalar, or None for text."""
    return next(
        (f"{_TAG_PREFIX}{kind}" for kind, form in CORE_SCHEMA.items() if form.fullmatch(text)), None
    )


class _Loader(yaml.SafeLoader):
    """A loader of YAML 1.2's core schema with bounds, which refuses a key given twice.

    It tells what PyYAML's constructors raise as an error of the file.
    """

    yaml_constructors: ClassVar[dict[Any, Any]] = {
        tag: constructor
        for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.removeprefix(_TAG_PREFIX) in ("null", "str", "seq", "map")
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0
        self.sizes: dict[int, int] = {}

    def resolve(self, kind: type[yaml.Node], value: str | None, implicit: Any) -> str:
        """Return the tag of a node that has none."""
        if kind is yaml.ScalarNode and implicit[0]:
            return _find_tag(value or "") or f"{_TAG_PREFIX}str"
        tag: str = super().resolve(kind, value, implicit)
        return tag

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node and count what it holds; an alias holds what its anchor does."""
        mark = self.peek_event().start_mark
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise _make_error(mark, f"more than {MAX_DEPTH} lists and mappings within each other")
        alias = self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        self.depth -= 1
        if alias and id(node) not in self.sizes:
            raise _make_error(mark, "an alias within its own anchor")
        if not alias:
            self.sizes[id(node)] = 1 + sum(self.sizes[id(part)] for part in _list_children(node))
        if self.sizes[id(node)] > MAX_NODES:
            raise _make_error(mark, f"more than {MAX_NODES} values")
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Construct what a node stands for, or refuse it."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
            what = short_repr(node.value) if isinstance(node.value, str) else "a list or mapping"
            tag = str(node.tag).rpartition(":")[2]
            raise _make_error(node.start_mark, f"{what} is no {format_key(tag)}") from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping whose keys are plain and differ."""
        seen = set()
        for part, _ in node.value:
            if part.tag == f"{_TAG_PREFIX}merge":
                continue
            key = self.construct_object(part, deep=True)
            if not isinstance(key, Hashable) or isinstance(key, tuple):
                raise _make_error(part.start_mark, "a key that is no text")
            if key in seen:
                raise _make_error(node.start_mark, f"{format_key(key)} given twice")
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_plain(self, node: yaml.ScalarNode) -> bool | int | float:
        """Construct a truth value or a number, or refuse one that is too long or too large."""
        kind, text = node.tag.removeprefix(_TAG_PREFIX), str(node.value)
        if len(text) > MAX_NUMBER_CHARS:
            raise _make_error(node.start_mark, f"a number of more than {MAX_NUMBER_CHARS} digits")
        if not CORE_SCHEMA[kind].fullmatch(text):
            raise ValueError(text)
        if kind == "bool":
            return text.lower() == "true"
        if kind == "int":
            base = {"0o": 8, "0x": 16}.get(text[:2], 10)
            return int(text if base == 10 else text[2:], base)
        value = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        if math.isinf(value) and "inf" not in text.lower():
            raise _make_error(node.start_mark, f"{short_repr(text)} is too large a number")
        return value


for _kind in ("bool", "int", "float"):
    _Loader.add_constructor(f"{_TAG_PREFIX}{_kind}", _Loader.construct_plain)


class _Dumper(yaml.SafeDumper):
    """Writes what `_Loader` and readers of YAML 1.1 read alike."""

    def resolve(self, kind: type[yaml.Node], value: str | None, implicit: Any) -> str:
        """Return the tag that readers give to a node, one that is not text's if any does."""
        tag: str = super().resolve(kind, value, implicit)
        plain = kind is yaml.ScalarNode and implicit[0] and tag == f"{_TAG_PREFIX}str"
        return (plain and _find_tag(value or "")) or tag


def _make_error(mark: yaml.Mark | None, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _list_children(node: yaml.Node | None) -> list[yaml.Node]:
    """Return the nodes that a list or a mapping holds, none for a single value."""
    if isinstance(node, yaml.SequenceNode):
        return list(node.value)
    return [x for pair in node.value for x in pair] if isinstance(node, yaml.MappingNode) else []


@functools.lru_cache(maxsize=64)
def _parse(text: str) -> Any:
    """Return what YAML holds."""
    return yaml.load(text, Loader=_Loader)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, is not a mapping or is larger than the bounds of
        this module.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: must be at most {MAX_BYTES // 1024} KiB")
        # Many experiments rest on the same file.
        content = copy.deepcopy(_parse(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ConfigError(f"{format_key(path)}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not text"
        raise ConfigError(f"{path}{where}: not YAML ({problem})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def dump_yaml(content: dict[str, Any]) -> str:
    """Return the text that `read_yaml` takes for that content."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
