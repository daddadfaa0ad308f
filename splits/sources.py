"""Which files of this package the numbers of a simulation depend on.

Plots, tables and the reading of configuration files are not among them: they may change without
a simulation being run again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent
FOLDERS = ("materials", "media", "transport", "instruments")
RUNNING = ("experiments/run.py",)
FITTING = ("experiments/fit.py", "experiments/parameters.py", "experiments/run_fit.py")


def physics_sources(fit: bool = False) -> list[Path]:
    """Return the sources that numbers depend on, relative to the package.

    Parameters
    ----------
    fit : bool
        Whether the numbers are those of a fit to measured spectra.
    """
    found = [path.relative_to(PACKAGE) for f in FOLDERS for path in (PACKAGE / f).rglob("*.py")]
    return sorted([*found, *map(Path, RUNNING + (FITTING if fit else ()))])


@cache
def physics_digest(fit: bool = False) -> str:
    """Return the SHA-256 (first 16 hex digits) of `physics_sources`: their names and contents.

    It does not depend on where the package lies nor on the age of its files.
    """
    return files_digest(PACKAGE, physics_sources(fit))


def files_digest(folder: Path, names: Iterable[str | Path]) -> str:
    """Return the SHA-256 (first 16 hex digits) of files of a folder: names and contents."""
    digest = hashlib.sha256()
    for name in names:
        content = (folder / name).read_bytes()
        digest.update(f"{Path(name).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]
