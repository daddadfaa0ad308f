"""File locks, so that one process compiles a kernel while the others wait for it.

Locks are POSIX locks on byte ranges of one empty file per folder.  The operating system releases
the lock when the holding process exits.
"""

from __future__ import annotations

import functools
import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path

from splits.core.compile_notice import WAITING_MESSAGE, announce

try:
    import fcntl
except ImportError:  # Windows lacks it: processes there compile the same kernel side by side.
    fcntl = None  # type: ignore[assignment]

LOCK_FILE = "compile.lock"
MAX_WAIT_S = 300.0
"""Longest wait for another process: ten times the compile time of the largest kernel."""
_LOCK_POLL_INTERVAL_S = 0.05


@functools.cache
def _open_lock_file(folder: Path) -> int:
    """Return the open lock file of a folder.

    It stays open: closing it would release all locks of this process.
    """
    return os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _compute_lock_offset(name: str) -> int:
    """Return the byte offset that represents a name, the same in all processes."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")


def acquire_lock(folder: Path, name: str) -> bool:
    """Acquire the lock of a name, so that no other process compiles the same kernel.

    After `MAX_WAIT_S`, and where files cannot be locked, the lock is not acquired and the kernel is
    compiled more than once.

    Returns
    -------
    bool
        Whether the lock is held.
    """
    if fcntl is None:
        return False
    start_time = time.monotonic()
    try:
        file = _open_lock_file(folder)
        with announce(WAITING_MESSAGE):
            while time.monotonic() - start_time <= MAX_WAIT_S:
                with suppress(BlockingIOError, PermissionError):
                    fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _compute_lock_offset(name))
                    return True
                time.sleep(_LOCK_POLL_INTERVAL_S)
    except OSError:
        pass
    return False


def release_lock(folder: Path, name: str) -> None:
    """Release the lock of a name."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.lockf(_open_lock_file(folder), fcntl.LOCK_UN, 1, _compute_lock_offset(name))
