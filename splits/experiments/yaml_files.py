"""Reading YAML files that anyone may have written: bounded, and refused in one line."""

from __future__ import annotations

import copy
import functools
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from splits.checks import named, shown

MOST_BYTES = 2**20
"""Size of a file."""
MOST_NODES = 50_000
"""Values in a file, those that aliases stand for counted each time."""
DEEPEST = 32
"""Lists and mappings within each other."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names file, key, value and range."""


class _Loader(yaml.SafeLoader):
    """A YAML loader with bounds, which refuses a key given twice instead of forgetting the first.

    What PyYAML's constructors raise of their own is told as an error of the file.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0
        self.sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node and count what it holds; an alias holds what its anchor does."""
        mark = self.peek_event().start_mark
        self.depth += 1
        if self.depth > DEEPEST:
            raise _bad(mark, f"more than {DEEPEST} lists and mappings within each other")
        alias = self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        self.depth -= 1
        if alias and id(node) not in self.sizes:
            raise _bad(mark, "an alias within its own anchor")
        if not alias:
            self.sizes[id(node)] = 1 + sum(self.sizes[id(part)] for part in _parts(node))
        if self.sizes[id(node)] > MOST_NODES:
            raise _bad(mark, f"more than {MOST_NODES} values")
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Construct what a node stands for, or refuse it."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
            what = shown(node.value) if isinstance(node.value, str) else "a list or mapping"
            tag = str(node.tag).rpartition(":")[2]
            raise _bad(node.start_mark, f"{what} is no {named(tag)}") from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping whose keys are plain and differ."""
        seen = set()
        for part, _ in node.value:
            if part.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(part, deep=True)
            if not isinstance(key, Hashable) or isinstance(key, tuple):
                raise _bad(part.start_mark, "a key that is no text")
            if key in seen:
                raise _bad(node.start_mark, f"{named(key)} given twice")
            seen.add(key)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Writes what `_Loader` reads."""


# YAML 1.1 takes 1e5 for text, which nobody means.
for _yaml in (_Loader, _Dumper):
    _yaml.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"[-+]?(\d[\d_]*\.?\d*|\.\d+)[eE][-+]?\d+$"),
        [*"-+.0123456789"],
    )


def _bad(mark: yaml.Mark | None, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _parts(node: yaml.Node | None) -> list[yaml.Node]:
    """Return the nodes that a list or a mapping holds, none for a single value."""
    if isinstance(node, yaml.SequenceNode):
        return list(node.value)
    return [x for pair in node.value for x in pair] if isinstance(node, yaml.MappingNode) else []


@functools.lru_cache(maxsize=64)
def _parsed(text: str) -> Any:
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
        if path.stat().st_size > MOST_BYTES:
            raise ConfigError(f"{path}: must be at most {MOST_BYTES // 1024} KiB")
        # Many experiments rest on the same file.
        content = copy.deepcopy(_parsed(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ConfigError(f"{named(path)}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not text"
        raise ConfigError(f"{path}{where}: not YAML ({problem})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def yaml_of(content: dict[str, Any]) -> str:
    """Return the text that `read_yaml` takes for that content."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
