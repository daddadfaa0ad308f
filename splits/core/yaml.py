"""Safe YAML loading with size limits and one-line errors."""

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
"""Largest size of a file."""
MAX_NODES = 50_000
"""Largest number of values in a file, with the content of aliases counted each time."""
MAX_DEPTH = 32
"""Largest nesting depth of lists and mappings."""
MAX_NUMBER_CHARS = 1000
"""Largest number of characters of a number."""


class ConfigError(ValueError):
    """Invalid configuration; the message names file, key, value and range."""


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
"""Plain scalars other than text, by tag: the core schema of YAML 1.2, and merged mappings.

All other scalars are text, such as 1:15, yes, off and 2001-01-01, which are 75, true, false and a
date in YAML 1.1.  All expressions match in linear time.
"""
_TAG_PREFIX = "tag:yaml.org,2002:"


def _find_tag(text: str) -> str | None:
    """Return the tag of a plain scalar, or None for text."""
    return next(
        (f"{_TAG_PREFIX}{kind}" for kind, form in CORE_SCHEMA.items() if form.fullmatch(text)), None
    )


class _Loader(yaml.SafeLoader):
    """Loader of the YAML 1.2 core schema with size limits, which rejects duplicate keys.

    Exceptions of PyYAML's constructors are raised as errors of the file.
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
        """Return the tag of a node without an explicit tag."""
        if kind is yaml.ScalarNode and implicit[0]:
            return _find_tag(value or "") or f"{_TAG_PREFIX}str"
        tag: str = super().resolve(kind, value, implicit)
        return tag

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node and count its values; an alias counts as much as its anchor."""
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
        """Construct the value of a node; raise a YAML error if it is invalid."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
            description = (
                short_repr(node.value) if isinstance(node.value, str) else "a list or mapping"
            )
            tag = str(node.tag).rpartition(":")[2]
            raise _make_error(
                node.start_mark, f"{description} is not of type {format_key(tag)}"
            ) from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping with plain, distinct keys."""
        seen = set()
        for part, _ in node.value:
            if part.tag == f"{_TAG_PREFIX}merge":
                continue
            key = self.construct_object(part, deep=True)
            if not isinstance(key, Hashable) or isinstance(key, tuple):
                raise _make_error(part.start_mark, "a key that is not text")
            if key in seen:
                raise _make_error(node.start_mark, f"{format_key(key)} given twice")
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_plain(self, node: yaml.ScalarNode) -> bool | int | float:
        """Construct a boolean or a number; raise a YAML error if it is too long or too large."""
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
    """Dumper of text that `_Loader` and YAML 1.1 parsers read identically."""

    def resolve(self, kind: type[yaml.Node], value: str | None, implicit: Any) -> str:
        """Return the tag of a node; text that any parser reads otherwise is quoted."""
        tag: str = super().resolve(kind, value, implicit)
        plain = kind is yaml.ScalarNode and implicit[0] and tag == f"{_TAG_PREFIX}str"
        return (plain and _find_tag(value or "")) or tag


def _make_error(mark: yaml.Mark | None, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _list_children(node: yaml.Node | None) -> list[yaml.Node]:
    """Return the child nodes of a list or mapping; none for a scalar."""
    if isinstance(node, yaml.SequenceNode):
        return list(node.value)
    return [x for pair in node.value for x in pair] if isinstance(node, yaml.MappingNode) else []


@functools.lru_cache(maxsize=64)
def _parse(text: str) -> Any:
    """Return the content of a YAML text."""
    return yaml.load(text, Loader=_Loader)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, is not a mapping or exceeds a limit of this module.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: must be at most {MAX_BYTES // 1024} KiB")
        # Parsed once and copied, because many experiments use the same file.
        content = copy.deepcopy(_parse(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ConfigError(f"{format_key(path)}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        position = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not text"
        raise ConfigError(f"{path}{position}: not YAML ({problem})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def dump_yaml(content: dict[str, Any]) -> str:
    """Return the YAML text from which `read_yaml` restores the content."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
