"""How compiled kernels are kept between processes, and how they come back whole.

Numba loads what it finds: here every kernel has a file of its own that begins with its checksum.
What fails the check is dropped and compiled again.  What cannot be written is not kept, and the
computation goes on.  Processes that need the same kernel at the same time let one of them compile.
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

from splits.core.compile_notice import COMPILING_MESSAGE, announce
from splits.kernels.compiler import cache_lock
from splits.kernels.compiler.cache_folders import list_cache_folders, warn_once

_DIGEST_BYTES = hashlib.sha256().digest_size


def enable_caching(kernel: Any) -> Any:
    """Let what a compiled function is compiled to be kept, and return the function."""
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        kernel._cache = cache = KernelCache(kernel.py_func)
        kernel._compiler.compile = cache.release_locks_on_failure(kernel._compiler.compile)
    return kernel


class _CacheLocator:
    """What Numba asks of a place of cached functions; `CacheFiles` knows the files."""

    def __init__(self, first_line: int) -> None:
        self.first_line = first_line

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _CacheLocator:
        return cls(py_func.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Do nothing: folders are made when something is written."""

    def get_cache_path(self) -> str:
        return str(list_cache_folders()[0].path) if list_cache_folders() else ""

    def get_source_stamp(self) -> str:
        # The folder's name says it.
        return ""

    def get_disambiguator(self) -> str:
        return str(self.first_line)


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes: Any = (_CacheLocator,)


class KernelCache(FunctionCache):
    """Numba's cache of a function, in checked files."""

    _impl_class = _KernelCacheImpl

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        self._cache_file = CacheFiles(self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was kept for a signature, or None: then it is this process's to compile."""
        found = self._load_cached(sig, target_context)
        if found is not None or not self._cache_file.acquire_lock(sig):
            return found
        # Another process may have compiled it meanwhile.
        found = self._load_cached(sig, target_context)
        if found is not None:
            self._cache_file.release_lock(sig)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for a signature, and let those go on that wait for it."""
        try:
            super().save_overload(sig, data)
        finally:
            self._cache_file.release_lock(sig)

    def release_locks_on_failure(self, compile: Callable[..., Any]) -> Callable[..., Any]:
        """Return what compiles, and lets others go on if that fails or is interrupted."""

        def compiled(*given: Any) -> Any:
            try:
                with announce(COMPILING_MESSAGE):
                    return compile(*given)
            except BaseException:
                self._cache_file.release_all_locks()
                raise

        return compiled

    def _load_cached(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            # Whole, and yet of no use: whatever it is, compiling anew mends it.
            warn_once(f"{self.cache_path}: kernels are compiled again ({error})")
            return None


class CacheFiles:
    """Files of what a function was compiled to, one for each signature.

    Processes that write at once do not meet: a file appears whole, and no index names it.

    Parameters
    ----------
    name : str
        What names of files begin with.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._locked_folders: dict[Any, Path] = {}

    def make_file_name(self, key: Any) -> str:
        """Return the name of a key's file."""
        return f"{self.name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved under a key, or None; drop what is damaged."""
        name = self.make_file_name(key)
        for folder in list_cache_folders():
            content = folder.read(name)
            if content is None:
                continue
            whole = content[_DIGEST_BYTES:]
            try:
                if hashlib.sha256(whole).digest() != content[:_DIGEST_BYTES]:
                    raise ValueError("checksum does not fit")
                saved, data = pickle.loads(whole)
            except Exception:
                warn_once(f"{folder.path}: damaged compiled kernels are dropped and compiled again")
                folder.remove(name)
                continue
            # Names of types may coincide where types do not.
            if saved == key:
                return data
        return None

    def save(self, key: Any, data: Any) -> None:
        """Keep data under a key, in the first folder that takes it."""
        whole = serialize.dumps((key, data))
        content = hashlib.sha256(whole).digest() + whole
        reasons = []
        for folder in list_cache_folders():
            try:
                folder.write(self.make_file_name(key), content)
                return
            except OSError as error:
                reasons.append(f"{folder.path}: {error.strerror or error}")
        warn_once(f"compiled kernels are not kept for the next process ({'; '.join(reasons)})")

    def acquire_lock(self, sig: Any) -> bool:
        """Wait until no other process compiles for a signature; tell whether one may have."""
        for folder in list_cache_folders():
            with suppress(OSError):
                folder.create()
                if cache_lock.acquire_lock(folder.path, f"{self.name} {sig}"):
                    self._locked_folders[sig] = folder.path
                    return True
        return False

    def release_lock(self, sig: Any) -> None:
        """Let others compile for a signature, or find what this process has compiled."""
        if sig in self._locked_folders:
            cache_lock.release_lock(self._locked_folders.pop(sig), f"{self.name} {sig}")

    def release_all_locks(self) -> None:
        """Let others compile for all signatures."""
        for sig in list(self._locked_folders):
            self.release_lock(sig)

    def flush(self) -> None:
        """Forget what was saved."""
        for folder in list_cache_folders():
            for path in folder.path.glob(f"{glob.escape(self.name)}.*.nbc"):
                folder.remove(path.name)
