"""Provenance: package version, git commit and digest of the sources of a simulation.

The digest covers the files that determine the numbers of a dataset.  Every dataset holds it, and
the workflow runs a simulation again when it changes.  Figures, tables and studies have digests of
their own sources.
"""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from splits.core.optional import DISTRIBUTION_NAME

PACKAGE_FOLDER = Path(__file__).parents[1]
SIMULATION_SOURCES = (
    "kernels", "materials", "illumination", "media", "simulation", "discrete_ordinates",
    "instruments", "core/uncertainty.py", "core/declarations.py", "core/inputs.py",
    "core/spacing.py",
    "tables/axes.py", "tables/blocks.py", "tables/build.py",
    "experiments/config/instruments.py", "experiments/config/media.py",
    "experiments/config/simulation.py", "experiments/run.py", "experiments/run_table.py",
)  # fmt: skip
"""Folders and files, relative to the package, that determine every simulation."""
RETRIEVAL_SOURCES = (
    "analysis/theory/kokhanovsky_zege.py", "experiments/config/retrieval.py",
    "experiments/run_retrieve.py", "tables/interpolation.py", "tables/comparison.py",
    "tables/axes.py", "tables/table.py", "tables/located_quantity.py", "tables/views.py",
    "materials/impurities.csv", "materials/impurities.py", "media/snow.py",
    "retrieval/state_vector.py", "retrieval/optimal_estimation.py", "retrieval/forward_model.py",
    "retrieval/linearization.py", "retrieval/measurement.py", "retrieval/retrieve.py",
    "retrieval/medium_model.py",
    "illumination/bands.py", "illumination/sensors.csv",
)  # fmt: skip
"""Files that determine retrievals from a table."""
RETURN_SOURCES = (*RETRIEVAL_SOURCES, "retrieval/retrieve_return.py")
"""Files that determine retrievals from a table of returns."""
TABLE_SOURCES = (
    "tables/blocks.py", "tables/build.py", "tables/comparison.py", "tables/interpolation.py",
)  # fmt: skip
"""Files that determine how a table is made from its simulated parts."""
FIGURE_SOURCES = (
    "plotting/*.py", "plotting/*.mplstyle", "analysis/*.py", "media/parameters.py",
)  # fmt: skip
"""Files that determine figures."""
STUDY_SOURCES = (
    "analysis/theory", "illumination", "retrieval", "core/uncertainty.py", *FIGURE_SOURCES,
)  # fmt: skip
"""Folders and files that determine studies, besides their functions and the physics."""


@cache
def hash_physics_sources() -> str:
    """Return the SHA-256 (first 16 hex digits) of the sources of a simulation."""
    return hash_sources(SIMULATION_SOURCES)


def hash_sources(names: Iterable[str]) -> str:
    """Return the digest of files, and of the sources in folders, of the package.

    Names may be patterns.
    """
    files = []
    for name in names:
        folder = PACKAGE_FOLDER / name
        sources = [path for end in ("*.py", "*.csv", "*.nc") for path in folder.rglob(end)]
        found = sources if folder.is_dir() else list(PACKAGE_FOLDER.glob(name))
        files += sorted(path.relative_to(PACKAGE_FOLDER).as_posix() for path in found)
    return hash_files(PACKAGE_FOLDER, files)


def hash_files(folder: Path, names: Iterable[str]) -> str:
    """Return the SHA-256 (first 16 hex digits) of files of a folder.

    The digest covers names relative to the folder and content with normalized line endings, so it
    is the same on every machine.
    """
    digest = hashlib.sha256()
    for name in names:
        content = (folder / name).read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


@cache
def get_package_version() -> str:
    """Return the installed version of this package."""
    try:
        return version(DISTRIBUTION_NAME)
    except PackageNotFoundError:
        return "unknown"


@cache
def get_git_commit() -> str:
    """Return the git commit of the source tree, "-dirty" if it has changes, or "unknown"."""
    try:
        head = _run_git("rev-parse", "HEAD")
        return head + ("-dirty" if _run_git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


@cache
def get_commit_date() -> str:
    """Return the date of the git commit of the source tree, such as 2026-01-31, or "unknown"."""
    try:
        return _run_git("log", "-1", "--format=%cs")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _run_git(*arguments: str) -> str:
    """Return the output of git in the source tree."""
    command = ["git", "-C", str(PACKAGE_FOLDER), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


__version__ = get_package_version()
