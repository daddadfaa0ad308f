"""Packages that a plain installation leaves out, asked for where they are needed."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

DISTRIBUTION_NAME = "splits-optics"
"""What this package is called on the package index; it is imported as `splits`."""


def import_optional(module: str, extra: str, purpose: str) -> ModuleType:
    """Return a module of an optional package.

    Parameters
    ----------
    module : str
        Its name, such as "pvlib.spectrum".
    extra : str
        The extra of this package that brings it.
    purpose : str
        What needs it, as the beginning of a sentence: "clear skies need".

    Raises
    ------
    ModuleNotFoundError
        If the package is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if (error.name or "").partition(".")[0] != package:
            raise
        raise ModuleNotFoundError(
            f"{purpose} the package {package}: pip install '{DISTRIBUTION_NAME}[{extra}]'",
            name=error.name,
        ) from None
