"""Progress of a running simulation: progress bars, progress logs and notices of compilation.

Notices about kernel compilation, in this process or another one, are written to the terminal or
shown in the output of a notebook's cell, or passed to registered functions such as a progress bar.
Elsewhere, as in the log of a batch job, there are none.  Errors are ignored, so that a notice never
ends a run.
"""

from __future__ import annotations

import functools
import logging
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from tqdm import tqdm
from tqdm.utils import ObjectWrapper

from splits.core.validation import ConfigError, InvalidValue, invalid

LogCallback = Callable[[str], None]
"""Function that receives lines of progress."""


@dataclass(frozen=True)
class Progress:
    """State of a running simulation.

    Attributes
    ----------
    rays : int
        Number of rays of the current round.
    stderr : float
        Largest standard error so far, or relative standard error for an instrument with a relative
        target; infinite before the end of the first round.
    target : float
        Requested standard error.
    seconds, seconds_left : float
        Elapsed time and estimated remaining time (s).
    """

    rays: int
    stderr: float
    target: float
    seconds: float
    seconds_left: float

    @property
    def fraction_done(self) -> float:
        """Elapsed fraction of the estimated total time, 0 to 1."""
        total = self.seconds + self.seconds_left
        return self.seconds / total if total > 0.0 else 0.0

    def __str__(self) -> str:
        remaining = f"{self.seconds_left:.0f} s left"
        if math.isinf(self.stderr):
            return f"first round, {remaining}"
        return f"error {self.stderr:.2g}, wanted {self.target:g}, {remaining}"


ProgressCallback = Callable[[Progress], None] | bool | None
"""Type of the argument `progress` of instruments: a function, True for a bar, or None."""


_BAR_FORMAT = "{desc}{percentage:3.0f}%|{bar}|"


class ProgressBar(AbstractContextManager["ProgressBar"]):
    """A bar in the terminal, or in a notebook, for the `progress` of an instrument.

    Parameters
    ----------
    description : str
        Text in front of the bar.

    Examples
    --------
    ``progress=True`` shows one bar per call.  An explicit bar can serve several calls:

    >>> import splits
    >>> with splits.ProgressBar("dry snow") as bar:
    ...     ds = splits.spectrophotometer(splits.Snow(), [800], max_stderr=0.05, progress=bar)
    """

    def __init__(self, description: str = "") -> None:
        output: dict[str, Any] = {"file": _SafeStream(sys.stderr), "disable": not sys.stderr}
        if "ipykernel" in sys.modules and find_spec("ipywidgets"):
            from tqdm.notebook import tqdm as bar_class

            output = {}
        else:
            bar_class = tqdm
        prefix, bar_format = f"{description}: " if description else "", f"{_BAR_FORMAT} starting"
        self._bar: tqdm = bar_class(total=1.0, desc=prefix, bar_format=bar_format, **output)
        listeners.append(self._show_notice)

    def __call__(self, progress: Progress) -> None:
        """Show the state of the simulation."""
        self._show(progress.fraction_done, str(progress))

    def close(self, *, done: bool = True) -> None:
        """Close the bar, filled if the simulation is done."""
        if self._show_notice in listeners:
            listeners.remove(self._show_notice)
        if done and not self._bar.disable:
            self._show(1.0, "done")
        self._bar.close()

    def _show_notice(self, notice: str) -> None:
        """Show a notice about compilation."""
        self._show(self._bar.n, notice)

    def _show(self, fraction: float, text: str) -> None:
        self._bar.n = fraction
        self._bar.bar_format = f"{_BAR_FORMAT} {text}"
        self._bar.refresh()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(done=kind is None)


class _SafeStream(ObjectWrapper):
    """Text stream that ignores write errors, so that a failing progress bar ends no run."""

    def write(self, text: str) -> None:
        """Write a text, ignoring errors."""
        with suppress(OSError, ValueError):
            self._wrapped.write(text)

    def flush(self) -> None:
        """Flush the stream, ignoring errors."""
        with suppress(OSError, ValueError):
            self._wrapped.flush()


@contextmanager
def open_progress(name: str, progress: Any) -> Iterator[Any]:
    """Yield the callback for the `progress` of a call: a bar for True, and None for False.

    Write errors of the callback are ignored.

    Parameters
    ----------
    name : str
        Text in front of the bar.
    progress : callable, bool or None

    Raises
    ------
    ValueError
        For anything else.
    """

    def call_safely(state: Progress) -> None:
        with suppress(OSError, UnicodeError):
            progress(state)

    if progress is True:
        with ProgressBar(name) as bar:
            yield bar
    elif isinstance(progress, ProgressBar) or progress is None or progress is False:
        yield progress or None
    elif callable(progress):
        yield call_safely
    else:
        allowed = "True for a bar, or a function that takes a splits.Progress"
        raise invalid("progress", progress, allowed)


def report_whole_table(
    report: ProgressCallback, start_time: float, n_done: int, n_left: int
) -> ProgressCallback:
    """Return a callback for one run that reports the progress of the whole table, if any.

    Parameters
    ----------
    report : callable or None
        Receives the progress of the table.
    start_time : float
        Of the table, as of `time.perf_counter` (s).
    n_done, n_left : int
        Numbers of runs before and after this one.
    """
    if not callable(report):
        return None

    def show(state: Progress) -> None:
        elapsed_s = time.perf_counter() - start_time
        mean_s = (elapsed_s + state.seconds_left) / (n_done + 1)
        left_s = state.seconds_left + n_left * mean_s
        report(replace(state, seconds=elapsed_s, seconds_left=left_s))

    return show


def write_line(line: str, stream: TextIO | None) -> None:
    """Write a line to a standard stream, ignoring errors.

    A progress message must not end a run.  A stream that fails (full disk, broken pipe, closed
    terminal) is redirected to the null device, and characters outside its encoding are escaped.

    Parameters
    ----------
    line : str
    stream : text file or None
        None, the value of `sys.stderr` in programs without a terminal, discards the line.
    """
    if stream is None:
        return
    try:
        encoding = stream.encoding or "utf-8"
        plain = line.encode(encoding, "backslashreplace").decode(encoding)
        print(plain, file=stream, flush=True)
    except (OSError, ValueError):
        # Buffered text would fail again at exit and change the exit status.
        with suppress(OSError, ValueError), open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), stream.fileno())


@contextmanager
def open_progress_log(path: str | Path) -> Iterator[Callable[[str], None]]:
    """Yield a function that writes a line to the terminal and to a log file.

    Each is written even if the other fails.  An invalid value in the block ends the process with
    one line that names the log file, which is named after the experiment.

    Parameters
    ----------
    path : path
        Log file; an existing file is overwritten.
    """
    with open(path, "w", encoding="utf-8") as log:

        def log_line(line: str) -> None:
            write_line(line, sys.stderr)
            write_line(line, log)

        try:
            yield log_line
        # Values of the user, for whom a traceback explains nothing.
        except (InvalidValue, ConfigError) as error:
            # The other one names the file.
            name = f"{Path(path).stem}: " if isinstance(error, InvalidValue) else ""
            log_line(f"{name}{error}")
            raise SystemExit(1) from None


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
            with suppress(Exception):
                if _is_notebook():
                    from IPython.display import display

                    # An empty line at the end, so that only results stay in the cell's output.
                    line = "" if message == DONE_MESSAGE else f"splits: {message}"
                    display(
                        {"text/plain": line, "text/html": line}, raw=True,
                        display_id=f"splits {self.start_time}", update=bool(self._last_message),
                    )  # fmt: skip
                else:
                    line = text if message == DONE_MESSAGE else message
                    # Bypasses Python's buffer, where a failed write would fail again at exit.
                    os.write(sys.stderr.fileno(), f"splits: {line}\n".encode())
        self._last_message = message


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
