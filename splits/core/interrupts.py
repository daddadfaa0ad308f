"""How SIGINT and SIGTERM end a run of the workflow soon, and leave nothing half done.

Snakemake waits for its jobs when it is interrupted, but does not tell them: it is made to pass the
signal on.  A job hears of a signal only between two steps of Python; while a kernel runs or is
compiled, that may take minutes: a thread of its own ends the process then.
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
"""How long a job may take to end by itself after a signal."""
INTERRUPTED_EXIT_STATUS = 130
"""Exit status of a job that a signal has ended: what shells give for SIGINT."""
HANDLED_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_unfinished_files: set[Path] = set()


@contextmanager
def track_unfinished_file(path: Path) -> Iterator[None]:
    """Remove a file at the end of this, also when a signal ends the process meanwhile."""
    _unfinished_files.add(path)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        _unfinished_files.discard(path)


def exit_on_signals(name: str, resume_hint: str = "") -> None:
    """Let SIGINT and SIGTERM end this process within about `GRACE_PERIOD_S`, with a line of `name`.

    To be called once, in the main thread of a process that does nothing but one job.  A process
    that ignores SIGINT, as shells start those in the background, goes on to do so.

    Parameters
    ----------
    name : str
    resume_hint : str, optional
        A last line.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        # A second one would break off what the first makes end.
        for known in HANDLED_SIGNALS:
            signal.signal(known, signal.SIG_IGN)
        raise KeyboardInterrupt

    def watch() -> None:
        told.recv(1)
        time.sleep(GRACE_PERIOD_S)
        end()

    def end() -> None:
        # Of two threads that come here, the first.
        ending.acquire()
        for path in list(_unfinished_files):
            with suppress(OSError):
                path.unlink(missing_ok=True)
        # Not by way of Python's own end, which waits for threads and for whoever is compiling.
        said = f"{name}: interrupted\n" + (f"{resume_hint}\n" if resume_hint else "")
        with suppress(OSError):
            os.write(2, said.encode(errors="backslashreplace"))
        os._exit(INTERRUPTED_EXIT_STATUS)

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            end()
        sys.__excepthook__(kind, error, trace)

    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    ending = threading.Lock()
    tell, told = socket.socketpair()
    tell.setblocking(False)
    # Written to at once, whatever the main thread is at; Python's own handler has to wait for it.
    signal.set_wakeup_fd(tell.detach(), warn_on_full_buffer=False)
    for number in HANDLED_SIGNALS:
        signal.signal(number, interrupt)
    sys.excepthook = hook
    threading.Thread(target=watch, daemon=True).start()


def forward_interrupts() -> None:
    """Let SIGINT interrupt all processes that this one has started, then this one.

    In other threads than the main one, or where SIGINT is ignored, nothing is done.
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
