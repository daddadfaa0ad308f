"""Warnings that are logged once, and notices about compilation, here or in another process.

Notices are written to the terminal or shown in the output of a notebook's cell, or passed to
registered functions such as a progress bar.  Elsewhere, as in the log of a batch job, there are
none.  Errors are ignored, so that a notice never ends a run.
"""

from __future__ import annotations

import functools
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

COMPILING_MESSAGE = "compiling code for this kind of scene, once, which takes up to half a minute"
WAITING_MESSAGE = "waiting for another process that compiles the same code"
DONE_MESSAGE = "compiled"
NOTICE_DELAY_S = 1.0
"""Duration (s) of compilation before the first notice, and of a pause that ends a session."""
_NOTICE_INTERVAL_S = 0.1

listeners: list[Callable[[str], None]] = []
"""Functions that receive every notice, with the elapsed seconds, in place of the terminal."""


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning, once per process."""
    logging.getLogger(__name__).warning(message)


class _NoticeSession:
    """Sequence of kernel compilations, with notices from a separate thread.

    Attributes
    ----------
    activity : str
        Current activity, or an empty text.
    start_time, last_end_time : float
        Start of the session and end of the last compilation.
    """

    def __init__(self) -> None:
        self.activity = ""
        self.start_time = self.last_end_time = time.monotonic()
        self._last_message = ""
        self._notebook_output: Any = None
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def is_over(self) -> bool:
        """Whether no compilation has run for `NOTICE_DELAY_S`."""
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
            if _is_notebook():
                self._show_in_notebook("" if message == DONE_MESSAGE else f"splits: {message}")
            else:
                _write_line(text if message == DONE_MESSAGE else message)
        self._last_message = message

    def _show_in_notebook(self, line: str) -> None:
        """Show a line in the cell's output; an empty one at the end, so that only results stay."""
        with suppress(Exception):
            from IPython.display import DisplayHandle

            content = {"text/plain": line, "text/html": line}
            if self._notebook_output is None:
                self._notebook_output = DisplayHandle()
                self._notebook_output.display(content, raw=True)
            else:
                self._notebook_output.update(content, raw=True)


_session: _NoticeSession | None = None
"""Last session; kernels are compiled one at a time."""


@contextmanager
def announce(activity: str) -> Iterator[None]:
    """Announce an activity if it takes longer than `NOTICE_DELAY_S` and can be shown."""
    global _session
    outermost = _session is None or not _session.activity
    if outermost and (listeners or _is_terminal() or _is_notebook()):
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
    """Return whether standard error is a terminal."""
    with suppress(Exception):
        return sys.stderr.isatty()
    return False


def _is_notebook() -> bool:
    """Return whether standard error is the output of a notebook's cell."""
    return type(sys.stderr).__module__.startswith("ipykernel.")


def _write_line(line: str) -> None:
    # Bypasses Python's buffer, where a failed write would fail again at exit.
    with suppress(Exception):
        os.write(sys.stderr.fileno(), f"splits: {line}\n".encode())
