"""Safe parser of YAML 1.2 with size limits, one-line errors and the lines of keys."""

from __future__ import annotations

import copy
import functools
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from yaml import MarkedYAMLError, YAMLError, events

from splits.core.validation import ConfigError, format_key, short_repr

MAX_BYTES = 2**20
"""Largest size of a file."""
MAX_NODES = 50_000
"""Largest number of values in a file, with the content of aliases counted each time."""
MAX_DEPTH = 32
"""Largest nesting depth of lists and mappings."""
MAX_NUMBER_CHARS = 1000
"""Largest number of characters of a number."""


CORE_SCHEMA = {
    "null": re.compile(r"~|null|Null|NULL|"),
    "bool": re.compile(r"true|True|TRUE|false|False|FALSE"),
    "int": re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    "float": re.compile(
        r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
    ),
}
"""Plain scalars by type in the core schema of YAML 1.2, all others are text; in linear time."""
_TAG_PREFIX = "tag:yaml.org,2002:"
_UNAMBIGUOUS_TEXT = re.compile(r"(?!(y|n|yes|no|on|off|true|false|null)$)[^\W\d_].*", re.I | re.S)
"""Texts that are text in YAML 1.1 and 1.2 without quotes."""


# The scanner in C, about 30 times as fast, is left out of some builds of PyYAML.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class Node(NamedTuple):
    """A value, the line of its key, its items by key or number, and the number of values in it."""

    value: Any
    line: int
    items: dict[Any, Node]
    size: int


class _Parser:
    """Parser of a text into nodes, within the limits of this module."""

    def __init__(self, text: str) -> None:
        self.events: Iterator[Any] = yaml.parse(text, Loader=_LOADER)
        self.anchors: dict[str, Node] = {}
        self.n_nodes = 0

    def parse_node(self, event: Any, depth: int) -> Node:
        """Return the node that begins with an event; an alias counts as much as its anchor."""
        is_alias, n_before = isinstance(event, events.AliasEvent), self.n_nodes
        if depth > MAX_DEPTH:
            raise _make_error(event, f"more than {MAX_DEPTH} lists and mappings within each other")
        if is_alias and event.anchor not in self.anchors:
            raise _make_error(
                event, f"no anchor &{format_key(event.anchor)} ends before this alias"
            )
        self.n_nodes += self.anchors[event.anchor].size if is_alias else 1
        if self.n_nodes > MAX_NODES:
            raise _make_error(event, f"more than {MAX_NODES} values")
        if is_alias:
            return self.anchors[event.anchor]
        items: dict[Any, Node] = {}
        value: Any
        if isinstance(event, events.ScalarEvent):
            value = _make_scalar(event)
        elif isinstance(event, events.SequenceStartEvent):
            _check_tag(event, ("seq",))
            while not isinstance(start := next(self.events), events.SequenceEndEvent):
                items[len(items)] = self.parse_node(start, depth + 1)
            value = [node.value for node in items.values()]
        else:
            _check_tag(event, ("map",))
            items = self.parse_mapping(depth)
            value = {key: node.value for key, node in items.items()}
        node = Node(value, event.start_mark.line + 1, items, self.n_nodes - n_before)
        if event.anchor:
            self.anchors[event.anchor] = node
        return node

    def parse_mapping(self, depth: int) -> dict[Any, Node]:
        """Return the nodes of a mapping by key, with those of merged mappings as defaults."""
        items: dict[Any, Node] = {}
        merged: dict[Any, Node] = {}
        while not isinstance(event := next(self.events), events.MappingEndEvent):
            key, line = self.parse_node(event, depth + 1).value, event.start_mark.line + 1
            if isinstance(key, dict | list):
                raise _make_error(event, "a key that is not text")
            if key in items:
                lines = f"in lines {items[key].line} and {line}"
                raise _make_error(event, f"{short_repr(key)} given twice, {lines}")
            before = next(reversed(items.values()), None)
            node = self.parse_node(next(self.events), depth + 1)
            is_number = all(type(one) is int for one in (key, before and before.value))
            if is_number and node.value is None and before is not None:
                raise _make_error(
                    event, f"a decimal comma? write {before.value}.{event.value} with a point"
                )
            if key != "<<" or getattr(event, "style", "alias"):
                items[key] = node._replace(line=line)
                continue
            for part in node.items.values() if isinstance(node.value, list) else [node]:
                if not isinstance(part.value, dict):
                    raise _make_error(event, "<< without a mapping")
                merged = {**part.items, **merged}
        return {**merged, **items}


def _make_scalar(event: Any) -> Any:
    """Return the value of a scalar; raise a YAML error for a number that is too long or large."""
    text, kind = event.value, _check_tag(event, ("str", *CORE_SCHEMA))
    if event.tag is None and event.implicit[0]:
        kind = next((name for name, form in CORE_SCHEMA.items() if form.fullmatch(text)), "str")
    if kind in ("int", "float") and len(text) > MAX_NUMBER_CHARS:
        raise _make_error(event, f"a number of more than {MAX_NUMBER_CHARS} digits")
    if kind != "str" and not CORE_SCHEMA[kind].fullmatch(text):
        raise _make_error(event, f"{short_repr(text)} is not of type {kind}")
    if kind == "float":
        value = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        if math.isinf(value) and "inf" not in text.lower():
            raise _make_error(event, f"{short_repr(text)} is too large a number")
        return value
    if kind == "int":
        return int(text, 0 if text[:2] in ("0o", "0x") else 10)
    return {"null": None, "bool": text.lower() == "true"}.get(kind, text)


def _check_tag(event: Any, allowed: tuple[str, ...]) -> str:
    """Return the type that a tag states, by default the first one allowed; reject other tags."""
    kind = (event.tag or "!").removeprefix(_TAG_PREFIX)
    if kind not in ("!", *allowed):
        tag = format_key(event.tag.replace(_TAG_PREFIX, "!!"))
        raise _make_error(event, f"the tag {tag} is not allowed here")
    return allowed[0] if kind == "!" else kind


def _make_error(event: Any, problem: str) -> MarkedYAMLError:
    return MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


@functools.lru_cache(maxsize=64)
def _parse(text: str) -> Node:
    """Return the root node of a YAML text."""
    parser = _Parser(text)
    starts = (event for event in parser.events if isinstance(event, events.DocumentStartEvent))
    if next(starts, None) is None:
        return Node(None, 1, {}, 0)
    root = parser.parse_node(next(parser.events), 1)
    if (event := next(starts, None)) is not None:
        raise _make_error(event, "more than one document")
    return root


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
        text = path.read_text(encoding="utf-8")
        # Parsed once and copied, because many experiments use the same file.
        content = copy.deepcopy(_parse(text).value)
    except OSError as error:
        raise ConfigError(f"{format_key(path)}: cannot be read ({error.strerror})") from None
    except (YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        position = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not text"
        if mark and re.match(r" *\t", "".join(text.splitlines()[mark.line :][:1])):
            problem = "a tab: indent with spaces"
        raise ConfigError(f"{path}{position}: not YAML ({problem})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def find_key(path: Path, message: str) -> tuple[list[Any], int]:
    """Return the key with which a message begins, and its line in a file.

    A key that the file does not have is that of its section, or empty.
    """
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    items, rest, line = _parse(text).items, message, 0
    keys: list[Any] = []
    while True:
        names = {format_key(key): key for key in items}
        known = [name for name in names if name and re.match(re.escape(name) + r"[].[ :]", rest)]
        if not known:
            return keys, line
        name = max(known, key=len)
        keys.append(names[name])
        line, rest = items[keys[-1]].line, rest.removeprefix(name).lstrip("].[")
        items = items[keys[-1]].items


def locate_message(path: Path, message: str) -> str:
    """Return a message that begins with a key, after the file and the line of the key."""
    keys, line = find_key(path, message)
    return f"{path}, line {line}: {message}" if keys else f"{path}: {message}"


class _Dumper(yaml.SafeDumper):
    """Writer of values that YAML 1.1 parsers read as `read_yaml` does."""

    def represent_text(self, text: str) -> Any:
        style = None if _UNAMBIGUOUS_TEXT.fullmatch(text) else "'"
        return self.represent_scalar(f"{_TAG_PREFIX}str", text, style=style)

    def represent_number(self, value: float) -> Any:
        node = self.represent_float(value)
        node.value = node.value if "." in node.value else node.value.replace("e", ".0e")
        return node


_Dumper.add_representer(str, _Dumper.represent_text)
_Dumper.add_representer(float, _Dumper.represent_number)


def dump_yaml(content: dict[str, Any]) -> str:
    """Return the YAML text from which `read_yaml` restores the content."""
    return str(yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True))
