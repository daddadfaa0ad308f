"""Expansion of paths given by users."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from splits.core.validation import invalid


def expand_path(value: Any, key: str = "path", hint: str = "") -> Path:
    """Return a path with a leading ``~`` or ``~NAME`` expanded to the home directory.

    All paths given by users pass through this function: the shell does not expand ``~`` in
    ``--output=~/results``, and neither Python nor YAML expands it at all.

    Parameters
    ----------
    value : str or path
    key : str
        Key named in error messages.
    hint : str
        Hint for a value that is not a path.

    Raises
    ------
    ValueError
        If the value is not a path, or the home directory is unknown.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise invalid(key, type(value).__name__, "the path of a file or a folder", hint)
    # The second characters are those of os.fsdecode for bytes that are no text.
    if "\0" in text or any(
        "\ud800" <= one <= "\udfff" and not "\udc80" <= one <= "\udcff" for one in text
    ):
        raise invalid(key, ascii(text), "a path of characters that file names may have")
    path = Path(os.path.expanduser(text))
    if not str(path).startswith("~"):
        return path
    if text.startswith("~"):
        hint = "write it in full, or with ./ in front if it lies here"
        raise invalid(key, text, "a path whose home is known", hint)
    # A relative path that begins with ~ after expansion is made absolute, so that a second
    # expansion leaves it unchanged.
    return Path.cwd() / path
