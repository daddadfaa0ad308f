"""Paths that users give."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from splits.core.validation import invalid


def expand_path(value: Any, key: str = "path", hint: str = "") -> Path:
    """Return a path whose ``~`` or ``~NAME`` at the beginning is the home of that user.

    Every path that a user gives goes through here: the shell leaves a ``~`` as it is in
    ``--output=~/results``, and Python and YAML leave it everywhere.

    Parameters
    ----------
    value : str or path
    key : str
        What the user knows it by.
    hint : str
        What to do with a value that is no path.

    Raises
    ------
    ValueError
        For what is no path, and where no home is known.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise invalid(key, type(value).__name__, "the path of a file or a folder", hint)
    path = Path(os.path.expanduser(text))
    if not str(path).startswith("~"):
        return path
    if text.startswith("~"):
        hint = "write it in full, or with ./ in front if it lies here"
        raise invalid(key, text, "a path whose home is known", hint)
    # Here lies what has that name, and whoever expands the path again must not take it for a home.
    return Path.cwd() / path
