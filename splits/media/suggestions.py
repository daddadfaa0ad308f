"""Hints for values that are given in place of a medium."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from splits.core.validation import suggest_name

NAMED_MEDIA_FOLDER = Path(__file__).with_name("named")
NAMED_MEDIA = tuple(sorted(path.stem for path in NAMED_MEDIA_FOLDER.glob("*.toml")))
"""Names of the media of the package, see `splits.media.named_media`."""


def suggest_medium(value: object, names: Sequence[str]) -> str:
    """Return a hint for a value that is not a medium, or "".

    Parameters
    ----------
    value : object
    names : sequence of str
        Names of the allowed media.
    """
    if callable(value):
        name = getattr(value, "__qualname__", "")
        return f"did you mean splits.{name}()?" if name in names else f"call it: {name}(…)"
    if isinstance(value, list | tuple):
        return "layers on each other are a splits.Stack(layers), several media have one call each"
    if isinstance(value, Mapping):
        return "several media have one call each"
    name = str(getattr(value, "kind", value))
    by_class = suggest_name(name.title().replace("_", ""), names)
    by_file = suggest_name(name, NAMED_MEDIA)
    if by_class or not by_file:
        return re.sub(r"mean (\w+)", r"mean splits.\1()", by_class)
    return re.sub(r"mean (\w+)", r"mean splits.load_medium('\1')", by_file)
