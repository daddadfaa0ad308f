"""Folders of cached kernels, named after the content of the kernel sources.

Numba notices a change only in the file that holds a kernel, not in the files that it calls.  The
name of a folder therefore contains a digest of all kernel sources, so that stale machine code is
never loaded.  Cached files are unpickled, which could run foreign code: every file must belong to
the user or to root, and so must the folder, unless the user has set it in NUMBA_CACHE_DIR.
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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import llvmlite
import numba
import numpy as np

from splits.core.atomic import atomic_write

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


@dataclass(frozen=True)
class CacheFolder:
    """Folder of cached kernels.

    Attributes
    ----------
    path : Path
    user_defined : bool
        True if the user has set it, so that other users may write to it, too.  Otherwise it is
        created for this user alone, and used only while no other user can write to it.
    """

    path: Path
    user_defined: bool

    def read(self, name: str) -> bytes | None:
        """Return the content of a file, or None if it is missing or not trusted."""
        try:
            if not self._is_trusted():
                warn_once(f"{self.path}: not a folder of the user's own, its kernels are not used")
                return None
            with open(self.path / name, "rb") as file:
                # The open file is checked: another file may have taken its name meanwhile.
                if not _is_trusted(os.fstat(file.fileno())):
                    warn_once(f"{self.path}: holds kernels of other users, which are not used")
                    return None
                return file.read()
        except OSError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically.

        Raises
        ------
        OSError
            If it cannot be written, if the folder is not the user's own, or if a file of that name
            exists and is not trusted.
        """
        self.create()
        with suppress(FileNotFoundError):
            # Users that replace each other's files would have to compile again and again.
            if self.user_defined and not _is_trusted((self.path / name).stat()):
                raise PermissionError("holds kernels of other users")
        with atomic_write(self.path / name) as temporary, open(temporary, "xb") as file:
            file.write(content)

    def create(self) -> None:
        """Create the folder if it is missing, and check that it is trusted.

        Raises
        ------
        OSError
            If it cannot be created, or is not the user's own.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            self.path.mkdir(mode=0o777 if self.user_defined else 0o700)
            if not self.user_defined:
                self._remove_stale_versions()
        if not self._is_trusted():
            raise PermissionError("not a folder of the user's own")

    def remove(self, name: str) -> None:
        """Remove a file; ignore errors."""
        with suppress(OSError):
            (self.path / name).unlink()

    def _remove_stale_versions(self) -> None:
        """Remove the kernels of other versions that are unused for `MAX_UNUSED_AGE_S`."""
        prefix = self.path.name.removesuffix(compute_kernels_digest())
        for other in self.path.parent.glob(f"{glob.escape(prefix)}*"):
            with suppress(OSError):
                if other != self.path and time.time() - other.lstat().st_mtime > MAX_UNUSED_AGE_S:
                    shutil.rmtree(other)

    def _is_trusted(self) -> bool:
        """Return whether the user has set the folder, or no other user can write to it."""
        if self.user_defined:
            return True
        status = self.path.lstat()
        return (
            stat.S_ISDIR(status.st_mode)
            and status.st_uid == _get_user_id()
            and _is_writable_by_owner_only(status)
        )


def _is_trusted(status: os.stat_result) -> bool:
    """Return whether the user or root owns a file, and no other user can write to it."""
    return status.st_uid in (_get_user_id(), 0) and _is_writable_by_owner_only(status)


def _is_writable_by_owner_only(status: os.stat_result) -> bool:
    """Return whether only its owner can write to a file or folder."""
    # Windows has neither user ids nor these permissions.
    return os.name == "nt" or not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _get_user_id() -> int:
    """Return the id of the current user; 0 on Windows, as in the status of files there."""
    return os.getuid() if hasattr(os, "getuid") else 0


@functools.cache
def list_cache_folders() -> tuple[CacheFolder, ...]:
    """Return the cache folders in the order of preference.

    They are the user's cache folder, or that of NUMBA_CACHE_DIR, and one in the folder for
    temporary files.  Kernels are loaded from all of them, and saved to the first that is writable.
    """
    name = f"numba-{compute_kernels_digest()}"
    folders = []
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        configured = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
        folders.append(CacheFolder(configured / "splits" / name, True))
    else:
        user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
        # A user without a home folder has no cache folder.
        if user_cache.is_absolute():
            folders.append(CacheFolder(user_cache / "splits" / name, False))
    with suppress(OSError):
        temporary = Path(tempfile.gettempdir())
        folders.append(CacheFolder(temporary / f"splits-{_get_user_id()}-{name}", False))
    return tuple(folders)


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning about the cache, once per process."""
    logging.getLogger(__name__).warning(message)
