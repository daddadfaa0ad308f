"""Instruments by name: the files of ``splits/instruments``, each imported on first use."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "instruments"


def is_instrument(name: str) -> bool:
    """Return whether a file ``NAME.py`` defines an instrument of its own name."""
    path = FOLDER / f"{name}.py"
    return path.is_file() and f"\n@declare_function\ndef {name}(" in path.read_text(
        encoding="utf-8"
    )


@cache
def list_instrument_names() -> tuple[str, ...]:
    """Return the names of all instruments in alphabetic order."""
    return tuple(filter(is_instrument, sorted(path.stem for path in FOLDER.glob("*.py"))))


def load_instrument(name: str) -> Any:
    """Return an instrument by its name."""
    return getattr(import_module(f"splits.instruments.{name}"), name)


def load_instruments() -> dict[str, Any]:
    """Return all instruments by their names."""
    return {name: load_instrument(name) for name in list_instrument_names()}
