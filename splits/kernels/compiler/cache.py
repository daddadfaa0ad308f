"""Cache of compiled kernels on disk, with checksums.

Numba loads any file that it finds; here every kernel has a file of its own that begins with its
checksum.  Files that fail the check are removed and the kernel is compiled again.  If a file cannot
be written, the computation continues without it.  Of several processes that need the same kernel at
the same time, one compiles it.
"""

from __future__ import annotations

import glob
import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import serialize
from numba.core.caching import CompileResultCacheImpl, FunctionCache

from splits.core.atomic import atomic_write
from splits.core.compile_notice import COMPILING_MESSAGE, announce
from splits.kernels.compiler import cache_lock
from splits.kernels.compiler.cache_folder import find_cache_folder, warn_once

_DIGEST_BYTES = hashlib.sha256().digest_size


def enable_caching(kernel: Any) -> Any:
    """Enable the cache on disk for a compiled function, and return that function."""
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        kernel._cache = cache = KernelCache(kernel.py_func)
        kernel._compiler.compile = cache.release_locks_on_failure(kernel._compiler.compile)
    return kernel


class _CacheLocator:
    """Locator required by Numba; `CacheFiles` manages the files."""

    def __init__(self, first_line: int) -> None:
        self.first_line = first_line

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _CacheLocator:
        return cls(py_func.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Do nothing: folders are created when a file is written."""

    def get_cache_path(self) -> str:
        return str(find_cache_folder() or "")

    def get_source_stamp(self) -> str:
        # The name of the folder contains the digest of the sources.
        return ""

    def get_disambiguator(self) -> str:
        return str(self.first_line)


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes: Any = (_CacheLocator,)


class KernelCache(FunctionCache):
    """Numba's cache of a function, in files with checksums."""

    _impl_class = _KernelCacheImpl

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        self._cache_file = CacheFiles(self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code of a signature, or None if this process has to compile it."""
        overload = self._load_cached(sig, target_context)
        if overload is not None or not self._cache_file.acquire_lock(sig):
            return overload
        # Another process may have compiled it meanwhile.
        overload = self._load_cached(sig, target_context)
        if overload is not None:
            self._cache_file.release_lock(sig)
        return overload

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code of a signature, and release its lock."""
        try:
            super().save_overload(sig, data)
        finally:
            self._cache_file.release_lock(sig)

    def release_locks_on_failure(self, compile: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap `compile` so that locks are released if it fails or is interrupted."""

        def compile_or_release(*args: Any) -> Any:
            try:
                with announce(COMPILING_MESSAGE):
                    return compile(*args)
            except BaseException:
                self._cache_file.release_all_locks()
                raise

        return compile_or_release

    def _load_cached(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            # The file is intact but unusable; compiling again repairs it, whatever the reason.
            warn_once(f"{self.cache_path}: kernels are compiled again ({error})")
            return None


class CacheFiles:
    """Files of the compiled code of a function, one per signature.

    Files are written atomically and without an index, so that processes can write concurrently.

    Parameters
    ----------
    name : str
        Prefix of the file names.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._locked: dict[Any, Path] = {}

    def make_file_name(self, key: Any) -> str:
        """Return the file name of a key."""
        return f"{self.name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """Return the data saved under a key, or None; remove damaged files."""
        folder = find_cache_folder()
        if folder is None:
            return None
        path = folder / self.make_file_name(key)
        try:
            content = path.read_bytes()
        except OSError:
            return None
        try:
            payload = content[_DIGEST_BYTES:]
            if hashlib.sha256(payload).digest() != content[:_DIGEST_BYTES]:
                raise ValueError("checksum differs")
            saved, data = pickle.loads(payload)
        except Exception:
            warn_once(f"{folder}: damaged compiled kernels are removed and compiled again")
            with suppress(OSError):
                path.unlink()
            return None
        # Different types may have the same name.
        return data if saved == key else None

    def save(self, key: Any, data: Any) -> None:
        """Save data under a key; without success, the kernel serves this process only."""
        folder = find_cache_folder()
        if folder is None:
            return
        payload = serialize.dumps((key, data))
        try:
            with atomic_write(folder / self.make_file_name(key)) as path, open(path, "xb") as file:
                file.write(hashlib.sha256(payload).digest() + payload)
        except OSError as error:
            reason = f"{folder}: {error.strerror or error}"
            warn_once(f"compiled kernels are not kept for the next process ({reason})")

    def acquire_lock(self, sig: Any) -> bool:
        """Lock a signature while this process compiles it; return whether the lock is held.

        Another process may have compiled the signature during the wait.
        """
        folder = find_cache_folder()
        if folder is None or not cache_lock.acquire_lock(folder, f"{self.name} {sig}"):
            return False
        self._locked[sig] = folder
        return True

    def release_lock(self, sig: Any) -> None:
        """Release the lock of a signature."""
        if sig in self._locked:
            cache_lock.release_lock(self._locked.pop(sig), f"{self.name} {sig}")

    def release_all_locks(self) -> None:
        """Release the locks of all signatures."""
        for sig in list(self._locked):
            self.release_lock(sig)

    def flush(self) -> None:
        """Remove all files of the function."""
        folder = find_cache_folder()
        for path in folder.glob(f"{glob.escape(self.name)}.*.nbc") if folder else ():
            path.unlink(missing_ok=True)
