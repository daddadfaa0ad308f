"""Notices that kernels are compiled, here or by another process, where a person sees them.

They go to a terminal as lines, or to whoever listens, such as a progress bar.  Nothing here can end
a run: what cannot be shown is left out.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

COMPILING_MESSAGE = "compiling code for this kind of scene, once, which takes up to half a minute"
WAITING_MESSAGE = "waiting for another process that compiles the same code"
DONE_MESSAGE = "compiled"
NOTICE_DELAY_S = 1.0
"""How long compilation takes before a notice, and pauses before it counts as over."""
_NOTICE_INTERVAL_S = 0.1

listeners: list[Callable[[str], None]] = []
"""Receive every notice in place of the terminal, each with the seconds so far."""


class _NoticeSession:
    """Kernels that are compiled one after the other: notices by a thread of its own.

    Attributes
    ----------
    activity : str
        What goes on, or nothing.
    start_time, last_end_time : float
        When the session began, and when it last ended to compile.
    """

    def __init__(self) -> None:
        self.activity = ""
        self.start_time = self.last_end_time = time.monotonic()
        self._last_message = ""
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def is_over(self) -> bool:
        """Whether nothing has been compiled for a while."""
        return not self.activity and time.monotonic() - self.last_end_time > NOTICE_DELAY_S

    def _run(self) -> None:
        while not self.is_over:
            time.sleep(_NOTICE_INTERVAL_S)
            now, seconds = self.activity, time.monotonic() - self.start_time
            if now and seconds > NOTICE_DELAY_S:
                self._publish(now, seconds)
        if self._last_message:
            self._publish(DONE_MESSAGE, self.last_end_time - self.start_time)

    def _publish(self, message: str, seconds: float) -> None:
        text = f"{message}: {seconds:.0f} s"
        for listener in list(listeners):
            with suppress(Exception):
                listener(text)
        if message != self._last_message and not listeners:
            _write_line(text if message == DONE_MESSAGE else message)
        self._last_message = message


_session: _NoticeSession | None = None
"""The last one; kernels are compiled one at a time."""


@contextmanager
def announce(activity: str) -> Iterator[None]:
    """Say what goes on meanwhile, if it takes longer than `NOTICE_DELAY_S` and a person sees it."""
    global _session
    outermost = _session is None or not _session.activity
    if outermost and (listeners or _is_terminal()):
        with suppress(RuntimeError):
            if _session is None or _session.is_over:
                _session = _NoticeSession()
            _session.activity = activity
    try:
        yield
    finally:
        if outermost and _session is not None:
            _session.activity, _session.last_end_time = "", time.monotonic()


def _is_terminal() -> bool:
    """Tell whether errors go to a terminal."""
    with suppress(Exception):
        return sys.stderr.isatty()
    return False


def _write_line(line: str) -> None:
    # Not by way of Python's buffer: what fails there fails again when the process ends.
    with suppress(Exception):
        os.write(sys.stderr.fileno(), f"splits: {line}\n".encode())
