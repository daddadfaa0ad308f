"""Who compiles a kernel while others wait for it: one process of all that share a folder.

Locks are ranges of one empty file, as POSIX has them.  They end with the process that holds them,
however that ends, so that nobody waits for the dead.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has none: processes there compile side by side.
    fcntl = None  # type: ignore[assignment]

FILE = "turns"


@functools.cache
def _opened(folder: Path) -> int:
    """Return the open file of a folder: closing any would end all locks of this process on it."""
    return os.open(folder / FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _place(name: str) -> int:
    """Return a byte that stands for a name, the same in all processes."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")


def take(folder: Path, name: str) -> None:
    """Wait until no other process compiles what is kept under a name, and keep others waiting.

    Where files cannot be locked nobody waits: kernels are then compiled more than once.
    """
    if fcntl is None:
        return
    with suppress(OSError):
        file = _opened(folder)
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(name))
        except (BlockingIOError, PermissionError):
            logging.getLogger(__name__).info("another process compiles kernels: waiting for it")
            fcntl.lockf(file, fcntl.LOCK_EX, 1, _place(name))


def leave(folder: Path, name: str) -> None:
    """Let others go on that wait for a name."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.lockf(_opened(folder), fcntl.LOCK_UN, 1, _place(name))
