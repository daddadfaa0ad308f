"""Which files of the package the numbers of a dataset depend on: one list for all who ask.

The workflow runs a simulation again when their digest changes, and every dataset carries it.
Plots, tables and the reading of configuration files may change without that.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

PACKAGE = Path(__file__).parent
PHYSICS = (
    "materials", "media", "transport", "instruments", "diffusion.py", "uncertainty.py", "names.py",
    "lookup/axes.py", "lookup/block.py", "lookup/plan.py",
    "experiments/coordinates.py", "experiments/run.py", "experiments/run_points.py",
)  # fmt: skip
"""Folders and files, relative to the package, behind every simulation."""
FITTING = (
    "experiments/fit.py",
    "experiments/parameters.py",
    "experiments/run_fit.py",
    "lookup/interpolation.py",
    "retrieval/coordinates.py", "retrieval/estimation.py", "retrieval/least_squares.py",
    "retrieval/line.py", "retrieval/measurement.py", "retrieval/misfit.py",
    "retrieval/posterior.py", "retrieval/result.py", "retrieval/search.py",
)  # fmt: skip
"""Files behind a fit besides."""
RETRIEVING = (
    "analysis/law_tables.py", "experiments/retrieve_section.py", "experiments/run_retrieve.py",
    "lookup/formats.py", "lookup/interpolation.py", "lookup/order.py", "lookup/reading.py",
    "materials/impurities.csv", "materials/impurities.py", "media/measured_inputs.py",
    "retrieval/coordinates.py", "retrieval/cubics.py", "retrieval/design.py",
    "retrieval/estimation.py", "retrieval/forward.py", "retrieval/importance.py",
    "retrieval/least_squares.py", "retrieval/line.py", "retrieval/measurement.py",
    "retrieval/misfit.py", "retrieval/posterior.py", "retrieval/result.py", "retrieval/retrieve.py",
    "skies/bands.py",
)  # fmt: skip
"""Files behind retrievals from a table."""


def sources(*, fit: bool = False) -> list[str]:
    """Return the files that a simulation, or a fit, depends on, relative to the package."""
    found = []
    for name in PHYSICS + (FITTING if fit else ()):
        path = PACKAGE / name
        every = [f for end in ("*.py", "*.csv") for f in path.rglob(end)]
        files = sorted(map(_relative, every)) if path.is_dir() else [name]
        found += files
    return found


@functools.cache
def physics_digest(*, fit: bool = False) -> str:
    """Return the SHA-256 (first 16 hex digits) of the sources of a simulation, or of a fit."""
    return files_digest(PACKAGE, sources(fit=fit))


def files_digest(folder: Path, names: Iterable[str]) -> str:
    """Return the SHA-256 (first 16 hex digits) of files of a folder.

    The same on every machine: of names relative to the folder, and of content, however lines end.
    """
    digest = hashlib.sha256()
    for name in names:
        content = (folder / name).read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


def _relative(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()
