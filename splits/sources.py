"""Which files of the package the numbers of a dataset depend on: one list for all who ask.

The workflow runs a simulation again when one of them changes, and every dataset carries their
digest.
"""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

PACKAGE = Path(__file__).parent
PHYSICS = ("materials", "media", "transport", "instruments", "experiments/run.py")
"""Folders and files, relative to the package, behind every simulation."""
FITTING = ("experiments/fit.py", "experiments/parameters.py", "experiments/run_fit.py")
"""Files behind a fit besides."""


def sources(*, fit: bool = False) -> list[Path]:
    """Return the Python files that a simulation, or a fit, depends on, in a fixed order."""
    found = []
    for name in PHYSICS + (FITTING if fit else ()):
        path = PACKAGE / name
        found += sorted(path.rglob("*.py"), key=_relative) if path.is_dir() else [path]
    return found


@functools.cache
def physics_digest(*, fit: bool = False) -> str:
    """Return the SHA-256 (first 16 hex digits) of the sources of a simulation, or of a fit.

    The same on every machine: of paths relative to the package, and of content, however lines end.
    """
    digest = hashlib.sha256()
    for path in sources(fit=fit):
        content = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{_relative(path)}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


def _relative(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()
