"""Folders of compiled kernels: which ones, and whose.

Numba only notices a change in the file that holds a kernel, not in the files it calls: a folder is
named after the content of all kernel sources, so that edited physics never meets stale machine
code.  Python objects are loaded from these files, which could run foreign code: each file must
belong to the user or to root, and so must the folder, unless the user has named it in
NUMBA_CACHE_DIR.
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
"""How long kernels of other versions are left alone."""


@functools.cache
def compute_kernels_digest() -> str:
    """Return the SHA-256 (first 16 hex digits) of all kernel sources and of what compiles them."""
    compilers = (numba, llvmlite, np)
    made_with = [sys.implementation.cache_tag, *(package.__version__ for package in compilers)]
    digest = hashlib.sha256("\0".join(made_with).encode())
    root = Path(__file__).parents[1]
    for source in sorted(root.rglob("*.py")):
        digest.update(f"\0{source.relative_to(root).as_posix()}\0".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class CacheFolder:
    """A folder of kernels.

    Attributes
    ----------
    path : Path
    user_defined : bool
        Whether the user has named it, so that others may write to it, too; otherwise it is made
        for this user alone, and used only as long as it is so.
    """

    path: Path
    user_defined: bool

    def read(self, name: str) -> bytes | None:
        """Return the content of a file, or None."""
        try:
            if not self._is_trusted():
                warn_once(f"{self.path}: not a folder of the user's own, its kernels are not used")
                return None
            with open(self.path / name, "rb") as file:
                # The file that is open, whatever takes its name meanwhile.
                if not _is_trusted(os.fstat(file.fileno())):
                    warn_once(f"{self.path}: holds kernels of other users, which are not used")
                    return None
                return file.read()
        except OSError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file that appears whole or not at all.

        Raises
        ------
        OSError
            If it cannot be written, the folder is not the user's own, or the name is taken by a
            file that is not trusted.
        """
        self.create()
        with suppress(FileNotFoundError):
            # Users that replaced each other's files would compile again and again.
            if self.user_defined and not _is_trusted((self.path / name).stat()):
                raise PermissionError("holds kernels of other users")
        with atomic_write(self.path / name) as aside, open(aside, "xb") as file:
            file.write(content)

    def create(self) -> None:
        """Make the folder if there is none, and see that it may be used.

        Raises
        ------
        OSError
            If it cannot be made, or is not the user's own.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            self.path.mkdir(mode=0o777 if self.user_defined else 0o700)
            if not self.user_defined:
                self._remove_stale_versions()
        if not self._is_trusted():
            raise PermissionError("not a folder of the user's own")

    def remove(self, name: str) -> None:
        """Remove a file, if that is possible."""
        with suppress(OSError):
            (self.path / name).unlink()

    def _remove_stale_versions(self) -> None:
        """Remove what other versions have kept here and not added to for `MAX_UNUSED_AGE_S`."""
        prefix = self.path.name.removesuffix(compute_kernels_digest())
        for other in self.path.parent.glob(f"{glob.escape(prefix)}*"):
            with suppress(OSError):
                if other != self.path and time.time() - other.lstat().st_mtime > MAX_UNUSED_AGE_S:
                    shutil.rmtree(other)

    def _is_trusted(self) -> bool:
        """Return whether the user has named the folder, or nobody else can put files into it."""
        if self.user_defined:
            return True
        about = self.path.lstat()
        return (
            stat.S_ISDIR(about.st_mode)
            and about.st_uid == _get_user_id()
            and _is_writable_by_owner_only(about)
        )


def _is_trusted(status: os.stat_result) -> bool:
    """Return whether the user or root owns a file, and nobody else can write to it."""
    return status.st_uid in (_get_user_id(), 0) and _is_writable_by_owner_only(status)


def _is_writable_by_owner_only(status: os.stat_result) -> bool:
    """Return whether only its owner can write to a file or folder."""
    # Windows knows neither users' numbers nor these permissions.
    return os.name == "nt" or not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _get_user_id() -> int:
    """Return the number of the user who runs this; 0, as files have it, on Windows."""
    return os.getuid() if hasattr(os, "getuid") else 0


@functools.cache
def list_cache_folders() -> tuple[CacheFolder, ...]:
    """Return where kernels are looked for, and kept in the first that takes them.

    The user's cache folder, or that of NUMBA_CACHE_DIR; then one in the folder for temporary files.
    """
    name = f"numba-{compute_kernels_digest()}"
    found = []
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        named = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
        found.append(CacheFolder(named / "splits" / name, True))
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
        # A user without a home has none either.
        if home.is_absolute():
            found.append(CacheFolder(home / "splits" / name, False))
    with suppress(OSError):
        shared = Path(tempfile.gettempdir())
        found.append(CacheFolder(shared / f"splits-{_get_user_id()}-{name}", False))
    return tuple(found)


@functools.cache
def warn_once(message: str) -> None:
    """Say something about the cache, once in a process."""
    logging.getLogger(__name__).warning(message)
