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

COMPILING = "compiling code for this kind of scene, once, which takes up to half a minute"
WAITING = "waiting for another process that compiles the same code"
DONE = "compiled"
FIRST_S = 1.0
"""How long compilation takes before a notice, and pauses before it counts as over."""
_STEP_S = 0.1

listeners: list[Callable[[str], None]] = []
"""Receive every notice in place of the terminal, each with the seconds so far."""


class _Session:
    """Kernels that are compiled one after the other: notices by a thread of its own.

    Attributes
    ----------
    now : str
        What goes on, or nothing.
    begun, ended : float
        When the session began, and when it last ended to compile.
    """

    def __init__(self) -> None:
        self.now = ""
        self.begun = self.ended = time.monotonic()
        self._told = ""
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def over(self) -> bool:
        """Whether nothing has been compiled for a while."""
        return not self.now and time.monotonic() - self.ended > FIRST_S

    def _watch(self) -> None:
        while not self.over:
            time.sleep(_STEP_S)
            now, seconds = self.now, time.monotonic() - self.begun
            if now and seconds > FIRST_S:
                self._tell(now, seconds)
        if self._told:
            self._tell(DONE, self.ended - self.begun)

    def _tell(self, what: str, seconds: float) -> None:
        text = f"{what}: {seconds:.0f} s"
        for listener in list(listeners):
            with suppress(Exception):
                listener(text)
        if what != self._told and not listeners:
            _write(text if what == DONE else what)
        self._told = what


_session: _Session | None = None
"""The last one; kernels are compiled one at a time."""


@contextmanager
def notice(what: str) -> Iterator[None]:
    """Say what goes on meanwhile, if it takes longer than `FIRST_S` and a person sees it."""
    global _session
    outermost = _session is None or not _session.now
    if outermost and (listeners or _terminal()):
        with suppress(RuntimeError):
            if _session is None or _session.over:
                _session = _Session()
            _session.now = what
    try:
        yield
    finally:
        if outermost and _session is not None:
            _session.now, _session.ended = "", time.monotonic()


def _terminal() -> bool:
    """Tell whether errors go to a terminal."""
    with suppress(Exception):
        return sys.stderr.isatty()
    return False


def _write(line: str) -> None:
    # Not by way of Python's buffer: what fails there fails again when the process ends.
    with suppress(Exception):
        os.write(sys.stderr.fileno(), f"splits: {line}\n".encode())
