"""Folder of cached kernels, named after the content of the kernel sources.

Numba notices a change only in the file that holds a kernel, not in the files that it calls.  The
name of the folder therefore contains a digest of all kernel sources, so that stale machine code is
never loaded.  Cached files are unpickled, which could run foreign code: the folder belongs to the
user, and no other user can write to it.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import logging
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import llvmlite
import numba
import numpy as np

MAX_UNUSED_AGE_S = 90 * 86_400.0
"""Age after which unused kernels of other versions are removed."""


@functools.cache
def compute_kernels_digest() -> str:
    """Return the SHA-256 (first 16 hex digits) of kernel sources and compiler versions."""
    compilers = (numba, llvmlite, np)
    versions = [sys.implementation.cache_tag, *(package.__version__ for package in compilers)]
    digest = hashlib.sha256("\0".join(versions).encode())
    root = Path(__file__).parents[1]
    for source in sorted(root.rglob("*.py")):
        digest.update(f"\0{source.relative_to(root).as_posix()}\0".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def find_cache_folder() -> Path | None:
    """Return the folder of this user's kernels, made if it is missing, or None without one.

    It is in the folder that the user has set in NUMBA_CACHE_DIR, or in the user's cache folder, or
    else in the folder for temporary files.
    """
    reasons = []
    for folder in _list_candidates():
        try:
            make_private_folder(folder)
            return folder
        except OSError as error:
            reasons.append(f"{folder}: {error.strerror or error}")
    warn_once(f"compiled kernels are not kept for the next process ({'; '.join(reasons)})")
    return None


def _list_candidates() -> Iterator[Path]:
    """Yield the possible cache folders in the order of preference."""
    name = f"numba-{compute_kernels_digest()}"
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        yield Path(numba.config.CACHE_DIR) / f"splits-{_get_user_id()}-{name}"  # type: ignore[attr-defined]
    else:
        user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
        # A user without a home folder has no cache folder.
        if user_cache.is_absolute():
            yield user_cache / "splits" / name
    with suppress(OSError):
        yield Path(tempfile.gettempdir()) / f"splits-{_get_user_id()}-{name}"


def make_private_folder(folder: Path) -> None:
    """Make a folder for this user alone, and remove unused ones of other versions beside it.

    Raises
    ------
    OSError
        If the folder cannot be made, or if another user can write to it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
        _remove_stale_versions(folder)
    if not _is_private(folder.lstat()):
        warn_once(f"{folder}: not a folder of the user's own, its kernels are not used")
        raise PermissionError("not a folder of the user's own")
    if not os.access(folder, os.W_OK):
        raise PermissionError("not writable")


def _remove_stale_versions(folder: Path) -> None:
    """Remove the kernels of other versions that are unused for `MAX_UNUSED_AGE_S`."""
    prefix = folder.name.removesuffix(compute_kernels_digest())
    for other in folder.parent.glob(f"{glob.escape(prefix)}*"):
        with suppress(OSError):
            if other != folder and time.time() - other.lstat().st_mtime > MAX_UNUSED_AGE_S:
                shutil.rmtree(other)


def _is_private(status: os.stat_result) -> bool:
    """Return whether a folder belongs to the user, and no other user can write to it."""
    # Windows has neither user ids nor these permissions.
    open_to_others = os.name != "nt" and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == _get_user_id() and not open_to_others


def _get_user_id() -> int:
    """Return the id of the current user; 0 on Windows, as in the status of files there."""
    return os.getuid() if hasattr(os, "getuid") else 0


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning about the cache, once per process."""
    logging.getLogger(__name__).warning(message)
