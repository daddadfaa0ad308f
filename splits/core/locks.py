"""Locks of the process that do not hang a forked child."""

from __future__ import annotations

import os
import threading


def make_lock() -> threading.RLock:
    """Return a reentrant lock that is free, or of the calling thread, in a forked child.

    Only the thread that forks exists in the child.  A lock of another thread would never be
    released there, so that forking waits for it.
    """
    lock = threading.RLock()
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(
            before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
        )
    return lock
