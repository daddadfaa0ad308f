"""Optional dependencies, imported where they are needed."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

DISTRIBUTION_NAME = "splits-optics"
"""Name of the distribution; the import name is `splits`."""


def import_optional(module: str, extra: str, purpose: str) -> ModuleType:
    """Return a module of an optional package.

    Parameters
    ----------
    module : str
        Name of the module, such as "pvlib.spectrum".
    extra : str
        Extra of this package that installs it.
    purpose : str
        Start of the error message, such as "clear skies need".

    Raises
    ------
    ModuleNotFoundError
        If the package is not installed; the message gives the command that installs it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if (error.name or "").partition(".")[0] != package:
            raise
        command = f"pip install '.[{extra}]' in a copy of the repository"
        raise ModuleNotFoundError(
            f"{purpose} the package {package}: {command}", name=error.name
        ) from None
