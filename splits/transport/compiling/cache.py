"""Where compiled kernels are kept between processes, and how they come back whole.

Numba only notices a change in the file that holds a kernel, not in the files it calls: the folder
is named after the content of all kernel sources, so that edited physics never meets stale machine
code.  Numba loads what it finds: here every kernel has a file of its own that begins with its
checksum.  What fails the check is dropped and compiled again.  What cannot be written is not kept,
and the computation goes on.  Python objects are loaded from these files, which could run foreign
code: the folder must belong to the user, unless the user has named it in NUMBA_CACHE_DIR.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import logging
import os
import pickle
import shutil
import socket
import stat
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import serialize
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_DIGEST_BYTES = hashlib.sha256().digest_size
KEPT_S = 90 * 86_400.0
"""How long kernels of other versions are left alone."""


@functools.cache
def kernels_digest() -> str:
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
class Folder:
    """A folder of kernels.

    Attributes
    ----------
    path : Path
    named : bool
        Whether the user has named it, and says so that it may be trusted; otherwise it is made for
        this user alone, and used only as long as it is so.
    """

    path: Path
    named: bool

    def read(self, name: str) -> bytes | None:
        """Return the content of a file, or None."""
        try:
            if not self._own():
                tell(f"{self.path}: not a folder of the user's own, its kernels are not used")
                return None
            with open(self.path / name, "rb") as file:
                # A folder of the user's own may hold a file of somebody else's.
                mine = self.named or os.fstat(file.fileno()).st_uid == _user()
                return file.read() if mine else None
        except OSError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file that appears whole or not at all.

        Raises
        ------
        OSError
            If it cannot be written, or the folder is not the user's own.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            self.path.mkdir(mode=0o777 if self.named else 0o700)
            if not self.named:
                self._sweep()
        if not self._own():
            raise PermissionError("not a folder of the user's own")
        self._tidy()
        handle, aside = tempfile.mkstemp(prefix=f".{_host()}.{os.getpid()}.", dir=self.path)
        try:
            with open(handle, "wb") as file:
                file.write(content)
            os.replace(aside, self.path / name)
        finally:
            with suppress(OSError):
                os.unlink(aside)

    def drop(self, name: str) -> None:
        """Remove a file, if that is possible."""
        with suppress(OSError):
            (self.path / name).unlink()

    def _tidy(self) -> None:
        """Remove what processes of this host that were killed have left half written."""
        for left in self.path.glob(f".{glob.escape(_host())}.*"):
            process = left.name.split(".")[2]
            with suppress(OSError):
                if process.isdigit() and not _runs(int(process)):
                    left.unlink()

    def _sweep(self) -> None:
        """Remove what other versions have kept here and not added to for `KEPT_S`."""
        prefix = self.path.name.removesuffix(kernels_digest())
        for other in self.path.parent.glob(f"{glob.escape(prefix)}*"):
            with suppress(OSError):
                if other != self.path and time.time() - other.lstat().st_mtime > KEPT_S:
                    shutil.rmtree(other)

    def _own(self) -> bool:
        """Return whether the user has named the folder, or nobody else can put files into it."""
        if self.named:
            return True
        about = self.path.lstat()
        # Windows knows neither users' numbers nor these permissions.
        closed = os.name == "nt" or not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        return stat.S_ISDIR(about.st_mode) and about.st_uid == _user() and closed


def _user() -> int:
    """Return the number of the user who runs this; 0, as files have it, on Windows."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _host() -> str:
    """Return the name of this machine, without dots."""
    return socket.gethostname().replace(".", "_")


def _runs(process: int) -> bool:
    """Tell whether a process of that number runs on this host; on Windows nobody can be asked."""
    if os.name == "nt":
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True


@functools.cache
def folders() -> tuple[Folder, ...]:
    """Return where kernels are looked for, and kept in the first that takes them.

    The user's cache folder, or that of NUMBA_CACHE_DIR; then one in the folder for temporary files.
    """
    name = f"numba-{kernels_digest()}"
    found = []
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        named = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
        found.append(Folder(named / "splits" / name, True))
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
        # A user without a home has none either.
        if home.is_absolute():
            found.append(Folder(home / "splits" / name, False))
    with suppress(OSError):
        shared = Path(tempfile.gettempdir())
        found.append(Folder(shared / f"splits-{_user()}-{name}", False))
    return tuple(found)


def keep(kernel: Any) -> Any:
    """Let what a compiled function is compiled to be kept, and return the function."""
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        kernel._cache = KernelCache(kernel.py_func)
    return kernel


class _Place:
    """What Numba asks of a place of cached functions; `Entries` knows the files."""

    def __init__(self, line: int) -> None:
        self.line = line

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _Place:
        return cls(py_func.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Do nothing: folders are made when something is written."""

    def get_cache_path(self) -> str:
        return str(folders()[0].path) if folders() else ""

    def get_source_stamp(self) -> str:
        # The folder's name says it.
        return ""

    def get_disambiguator(self) -> str:
        return str(self.line)


class _Parts(CompileResultCacheImpl):
    _locator_classes: Any = (_Place,)


class KernelCache(FunctionCache):
    """Numba's cache of a function, in checked files."""

    _impl_class = _Parts

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        self._cache_file = Entries(self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was kept for a signature, or None."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            # Whole, and yet of no use: whatever it is, compiling anew mends it.
            tell(f"{self.cache_path}: kernels are compiled again ({error})")
            return None


class Entries:
    """Files of what a function was compiled to, one for each signature.

    Processes that write at once do not meet: a file appears whole, and no index names it.

    Parameters
    ----------
    name : str
        What names of files begin with.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def file(self, key: Any) -> str:
        """Return the name of a key's file."""
        return f"{self.name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved under a key, or None; drop what is damaged."""
        name = self.file(key)
        for folder in folders():
            content = folder.read(name)
            if content is None:
                continue
            whole = content[_DIGEST_BYTES:]
            try:
                if hashlib.sha256(whole).digest() != content[:_DIGEST_BYTES]:
                    raise ValueError("checksum does not fit")
                saved, data = pickle.loads(whole)
            except Exception:
                tell(f"{folder.path}: damaged compiled kernels are dropped and compiled again")
                folder.drop(name)
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
        for folder in folders():
            try:
                folder.write(self.file(key), content)
                return
            except OSError as error:
                reasons.append(f"{folder.path}: {error.strerror or error}")
        tell(f"compiled kernels are not kept for the next process ({'; '.join(reasons)})")

    def flush(self) -> None:
        """Forget what was saved."""
        for folder in folders():
            for path in folder.path.glob(f"{glob.escape(self.name)}.*.nbc"):
                folder.drop(path.name)


@functools.cache
def tell(line: str) -> None:
    """Say something about the cache, once in a process."""
    logging.getLogger(__name__).warning(line)
