"""Who compiles a kernel while others wait for it: one process of all that share a folder.

Locks are ranges of one empty file, as POSIX has them.  They end with the process that holds them,
however that ends, so that nobody waits for the dead.
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
except ImportError:  # Windows has none: processes there compile side by side.
    fcntl = None  # type: ignore[assignment]

LOCK_FILE = "turns"
MAX_WAIT_S = 300.0
"""How long a process waits for another: ten times what the largest kernel takes."""
_LOCK_POLL_INTERVAL_S = 0.05


@functools.cache
def _open_lock_file(folder: Path) -> int:
    """Return the open file of a folder: closing any would end all locks of this process on it."""
    return os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _compute_lock_offset(name: str) -> int:
    """Return a byte that stands for a name, the same in all processes."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")


def acquire_lock(folder: Path, name: str) -> bool:
    """Wait until no other process compiles what is kept under a name, and keep others waiting.

    Nobody waits longer than `MAX_WAIT_S`, nor where files cannot be locked: kernels are then
    compiled more than once.

    Returns
    -------
    bool
        Whether others wait for this process now.
    """
    if fcntl is None:
        return False
    begun = time.monotonic()
    try:
        file = _open_lock_file(folder)
        with announce(WAITING_MESSAGE):
            while time.monotonic() - begun <= MAX_WAIT_S:
                with suppress(BlockingIOError, PermissionError):
                    fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _compute_lock_offset(name))
                    return True
                time.sleep(_LOCK_POLL_INTERVAL_S)
    except OSError:
        pass
    return False


def release_lock(folder: Path, name: str) -> None:
    """Let others go on that wait for a name."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.lockf(_open_lock_file(folder), fcntl.LOCK_UN, 1, _compute_lock_offset(name))
