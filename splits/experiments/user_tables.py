"""Users' own tables of indices, grounds and impurities that an experiment's settings name."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from splits.paths import expand_path

KEYS = ("refractive_index", "ground", "impurities_ng_g")


def renamed(settings: Any, replace: Callable[[str], str], inside: bool = False) -> Any:
    """Return settings with the path of every user's table replaced.

    Parameters
    ----------
    settings : mapping, list or value
        An experiment or medium, or a part of it, as YAML gives it.
    name : callable
        Takes a path, returns what stands in its place.
    inside : bool
        Whether `settings` stands below one of `KEYS`.
    """
    if isinstance(settings, dict):
        return {k: renamed(v, replace, inside or _named(k)) for k, v in settings.items()}
    if isinstance(settings, (list, tuple)):
        return [renamed(value, replace, inside) for value in settings]
    if inside and isinstance(settings, str) and settings.endswith(".csv"):
        return replace(settings)
    return settings


def _named(key: Any) -> bool:
    """Tell whether a key, or the last part of a path, is one of `KEYS`."""
    return str(key).rpartition(".")[2] in KEYS


def by_content(path: str) -> str:
    """Return the name of a table without its folder, and the SHA-256 of its content.

    A medium's table that every point of a grid replaces need not exist.
    """
    file = expand_path(path)
    digest = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "unused"
    return f"{file.name} sha256:{digest}"


def tables_in(settings: Any) -> list[str]:
    """Return the paths of all users' tables that settings name."""
    found: set[str] = set()

    def note(path: str) -> str:
        found.add(path)
        return path

    renamed(settings, note)
    return sorted(found)
