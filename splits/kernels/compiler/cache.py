"""Compiled kernels on disk: Numba's own cache, in a folder named after the content of all sources.

Numba notices a change only in the file that holds a kernel, not in the files that it calls.  The
name of the folder therefore contains a digest of all kernel sources, so that stale machine code is
never loaded.  Of several processes that need the same kernel at the same time, one compiles it.  A
damaged file is compiled again, and one that cannot be written serves this process only.

Cached files are unpickled, which could run foreign code: the folder belongs to the user, and no
other user can write to it.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import os
import pickle
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from filelock import FileLock, Timeout
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock

from splits.core.progress import COMPILING_MESSAGE, WAITING_MESSAGE, announce, warn_once

MAX_UNUSED_AGE_S = 90 * 86_400.0
"""Age after which unused kernels of other versions are removed."""
MAX_WAIT_S = 300.0
"""Longest wait for another process: ten times the compile time of the largest kernel."""
_CHECKSUM_BYTES = hashlib.sha256().digest_size


def enable_caching(kernel: Any) -> Any:
    """Enable the cache on disk for a compiled function, and return that function."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return kernel
    compile_kernel = kernel.compile

    def compile_once(signature: Any) -> Any:
        # Threads take turns before processes do, so that none waits for a lock of its own process.
        with global_compiler_lock:
            if not isinstance(kernel._cache, KernelCache) and find_cache_folder():
                kernel._cache = KernelCache(kernel.py_func)
            hold_lock = getattr(kernel._cache, "hold_lock", nullcontext)
            with hold_lock(), announce(COMPILING_MESSAGE):
                return compile_kernel(signature)

    kernel.compile = compile_once
    return kernel


class _CacheLocator:
    """Locator of the files of a function, as Numba requires it."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file, self._first_line = py_file, py_func.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _CacheLocator:
        return cls(py_func, py_file)

    def ensure_cache_path(self) -> None:
        """Do nothing: `find_cache_folder` has made the folder."""

    def get_cache_path(self) -> str:
        return str(find_cache_folder())

    def get_source_stamp(self) -> str:
        """Return the digest of the own file, which need not be in `splits.kernels`."""
        return _hash_file(self._py_file)

    def get_disambiguator(self) -> str:
        return f"{Path(self._py_file).parent.name}-{self._first_line}"


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes: Any = (_CacheLocator,)


class _CheckedFiles(IndexDataCacheFile):
    """Numba's files of a function, with checksums: damaged machine code would run otherwise."""

    def _save_data(self, name: str, data: Any) -> None:
        payload = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(payload).digest() + payload)

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        payload = content[_CHECKSUM_BYTES:]
        if hashlib.sha256(payload).digest() != content[:_CHECKSUM_BYTES]:
            raise ValueError("damaged")
        return pickle.loads(payload)


class KernelCache(FunctionCache):
    """Numba's cache of a function, which never ends a computation."""

    _impl_class = _KernelCacheImpl

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        name, stamp = self._impl.filename_base, self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedFiles(self.cache_path, name, stamp)
        self._file_lock = FileLock(Path(self.cache_path, f"{name}.lock"))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code of a signature, or None if it has to be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            # Compiling again repairs it, whatever the reason.
            warn_once(f"{self.cache_path}: kernels are compiled again ({error})")
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code of a signature; without success, it serves this process only."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            reason = f"{self.cache_path}: {error.strerror or error}"
            warn_once(f"compiled kernels are not kept for the next process ({reason})")

    @contextmanager
    def hold_lock(self) -> Iterator[None]:
        """Let no other process compile this function in the block.

        After `MAX_WAIT_S`, and where files cannot be locked, it may be compiled more than once.
        """
        with suppress(OSError, NotImplementedError):
            try:
                self._file_lock.acquire(blocking=False)
            except Timeout:
                with announce(WAITING_MESSAGE):
                    self._file_lock.acquire(timeout=MAX_WAIT_S)
        try:
            yield
        finally:
            self._file_lock.release()


@functools.cache
def _hash_file(path: str) -> str:
    """Return the SHA-256 of a source file, an empty text for generated code."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if os.path.exists(path) else ""


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
        prefix = folder.name.removesuffix(compute_kernels_digest())
        for other in folder.parent.glob(f"{glob.escape(prefix)}*"):
            with suppress(OSError):
                if other != folder and time.time() - other.lstat().st_mtime > MAX_UNUSED_AGE_S:
                    shutil.rmtree(other)
    if not _is_private(folder.lstat()):
        warn_once(f"{folder}: not a folder of the user's own, its kernels are not used")
        raise PermissionError("not a folder of the user's own")
    if not os.access(folder, os.W_OK):
        raise PermissionError("not writable")


def _is_private(status: os.stat_result) -> bool:
    """Return whether a folder belongs to the user, and no other user can write to it."""
    # Windows has neither user ids nor these permissions.
    open_to_others = os.name != "nt" and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == _get_user_id() and not open_to_others


def _get_user_id() -> int:
    """Return the id of the current user; 0 on Windows, as in the status of files there."""
    return os.getuid() if hasattr(os, "getuid") else 0
