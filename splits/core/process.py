"""Signals and locks of a process: a prompt exit, and locks that do not hang a forked child."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

INTERRUPTED_EXIT_STATUS = 130
"""Exit status of an interrupted job, the one shells report for SIGINT."""


def count_cpus() -> int:
    """Return the number of CPUs this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    # macOS and Windows; Python 3.13 has a count that heeds PYTHON_CPU_COUNT.
    count: Callable[[], int | None] = getattr(os, "process_cpu_count", os.cpu_count)
    return count() or 1


def exit_on_signals(name: str, resume_hint: str = "") -> None:
    """End this process at once on SIGINT or SIGTERM, with a line that reports the interruption.

    Python handles a signal only between two bytecode instructions; while a kernel runs or is
    compiled, that may take minutes.  A separate thread therefore ends the process, without its
    regular exit, which waits for other threads and for the compiler lock.  Files are written
    atomically, so that none is left half written.

    Call it once, in the main thread of a process that runs a single job.  A process that ignores
    SIGINT, such as a background process of a shell, continues to do so.

    Parameters
    ----------
    name : str
        Program name in the line.
    resume_hint : str, optional
        Second line of the report.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    sender, receiver = socket.socketpair()
    sender.setblocking(False)

    def watch() -> None:
        receiver.recv(1)
        message = f"{name}: interrupted\n" + (f"{resume_hint}\n" if resume_hint else "")
        with suppress(OSError):
            os.write(2, message.encode(errors="backslashreplace"))
        os._exit(INTERRUPTED_EXIT_STATUS)

    # The wakeup descriptor is written at once; Python-level handlers wait for the main thread.
    signal.set_wakeup_fd(sender.detach(), warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: None)
    threading.Thread(target=watch, daemon=True).start()


def forward_interrupts() -> None:
    """Forward SIGINT to all descendant processes, then handle it in this process.

    An interrupted Snakemake would wait for its jobs.  No effect outside the main thread or if
    SIGINT is ignored.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    import psutil

    def interrupt(number: int, frame: FrameType | None) -> None:
        for child in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                child.send_signal(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupt)


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
