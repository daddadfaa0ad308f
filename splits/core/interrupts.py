"""Handling of SIGINT and SIGTERM: a prompt exit that leaves no unfinished files.

An interrupted Snakemake waits for its jobs without forwarding the signal, so it is made to forward
it.  Python handles a signal only between two bytecode instructions; while a kernel runs or is
compiled, that may take minutes.  A separate thread therefore ends the process.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType

GRACE_PERIOD_S = 1.0
"""Time (s) that a job has to end after a signal before it is ended."""
INTERRUPTED_EXIT_STATUS = 130
"""Exit status of an interrupted job, the one shells report for SIGINT."""
HANDLED_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_unfinished_files: set[Path] = set()


@contextmanager
def track_unfinished_file(path: Path) -> Iterator[None]:
    """Remove a file at the end of the block, also if a signal ends the process within it."""
    _unfinished_files.add(path)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        _unfinished_files.discard(path)


def exit_on_signals(name: str, resume_hint: str = "") -> None:
    """End this process within about `GRACE_PERIOD_S` of SIGINT or SIGTERM.

    Call it once, in the main thread of a process that runs a single job.  A process that ignores
    SIGINT, such as a background process of a shell, continues to do so.

    Parameters
    ----------
    name : str
        Program name in the line that reports the interruption.
    resume_hint : str, optional
        Second line of the report.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        # A second signal must not interrupt the clean-up after the first.
        for handled in HANDLED_SIGNALS:
            signal.signal(handled, signal.SIG_IGN)
        raise KeyboardInterrupt

    def watch() -> None:
        receiver.recv(1)
        time.sleep(GRACE_PERIOD_S)
        exit_process()

    def exit_process() -> None:
        # Only the first thread to arrive continues.
        exit_lock.acquire()
        for path in list(_unfinished_files):
            with suppress(OSError):
                path.unlink(missing_ok=True)
        # os._exit: the regular exit of Python waits for threads and for the compiler lock.
        message = f"{name}: interrupted\n" + (f"{resume_hint}\n" if resume_hint else "")
        with suppress(OSError):
            os.write(2, message.encode(errors="backslashreplace"))
        os._exit(INTERRUPTED_EXIT_STATUS)

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            exit_process()
        sys.__excepthook__(kind, error, trace)

    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    exit_lock = threading.Lock()
    sender, receiver = socket.socketpair()
    sender.setblocking(False)
    # The wakeup descriptor is written at once; Python-level handlers wait for the main thread.
    signal.set_wakeup_fd(sender.detach(), warn_on_full_buffer=False)
    for number in HANDLED_SIGNALS:
        signal.signal(number, interrupt)
    sys.excepthook = hook
    threading.Thread(target=watch, daemon=True).start()


def forward_interrupts() -> None:
    """Forward SIGINT to all descendant processes, then handle it in this process.

    No effect outside the main thread or if SIGINT is ignored.
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
