"""What a running simulation has reached, and a bar that shows it.

Lines of progress in the terminal and in a file of their own.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, ParamSpec, TextIO, TypeVar

from tqdm import tqdm

from splits.core.compile_notice import listeners
from splits.core.validation import invalid


@dataclass(frozen=True)
class Progress:
    """What a running simulation has reached.

    Attributes
    ----------
    rays : int
        Rays of the present round.
    stderr : float
        Largest standard error so far; 1 or more before the first round is over.  Relative, where
        an instrument works to a relative error.
    target : float
        Error asked for.
    seconds, seconds_left : float
        Time since the start, and about as much still to go (s).
    """

    rays: int
    stderr: float
    target: float
    seconds: float
    seconds_left: float

    @property
    def fraction_done(self) -> float:
        """Part of the whole time that is over, 0 to 1."""
        whole = self.seconds + self.seconds_left
        return self.seconds / whole if whole > 0.0 else 0.0

    def __str__(self) -> str:
        left = f"{self.seconds_left:.0f} s left"
        if self.stderr >= 1.0:
            return f"first round, {left}"
        return f"error {self.stderr:.2g}, wanted {self.target:g}, {left}"


ProgressCallback = Callable[[Progress], None] | bool | None
"""What instruments take as `progress`: a function, True for a bar, or nothing."""


_BAR_FORMAT = "{desc}{percentage:3.0f}%|{bar}|"


class ProgressBar:
    """A bar in the terminal, or in a notebook, for the `progress` of an instrument.

    Parameters
    ----------
    description : str
        Stands before the bar.

    Examples
    --------
    One bar for each call is what ``progress=True`` gives.  A bar of your own serves several:

    >>> import splits
    >>> with splits.ProgressBar("dry snow") as bar:
    ...     ds = splits.spectrophotometer(splits.Snow(), [800], max_stderr=0.05, progress=bar)
    """

    def __init__(self, description: str = "") -> None:
        before = f"{description}: " if description else ""
        where = (
            {} if _is_notebook() else {"file": _SafeStream(sys.stderr), "disable": not sys.stderr}
        )
        form = f"{_BAR_FORMAT} starting"
        self._bar: tqdm = _get_bar_class()(total=1.0, desc=before, bar_format=form, **where)
        listeners.append(self._show_notice)

    def __call__(self, progress: Progress) -> None:
        """Show what has been reached."""
        self._show(progress.fraction_done, str(progress))

    def close(self, *, done: bool = True) -> None:
        """Leave the bar as it is, full if the simulation is done."""
        if self._show_notice in listeners:
            listeners.remove(self._show_notice)
        if done and not self._bar.disable:
            self._show(1.0, "done")
        self._bar.close()

    def _show_notice(self, notice: str) -> None:
        """Show what keeps the simulation from starting."""
        self._show(self._bar.n, notice)

    def _show(self, fraction: float, text: str) -> None:
        self._bar.n = fraction
        self._bar.bar_format = f"{_BAR_FORMAT} {text}"
        self._bar.refresh()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(done=kind is None)


class _SafeStream:
    """A stream whose errors end nothing: a bar that cannot be shown is not shown.

    Parameters
    ----------
    stream : text file
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        """Write a text if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.write(text)

    def flush(self) -> None:
        """Let what was written appear if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _is_notebook() -> bool:
    """Tell whether bars of notebooks can be shown."""
    return "ipykernel" in sys.modules and bool(find_spec("ipywidgets"))


def _get_bar_class() -> type[tqdm]:
    """Return the bar of notebooks where there is one, the terminal's elsewhere."""
    if _is_notebook():
        from tqdm.notebook import tqdm as in_notebooks

        kind: type[tqdm] = in_notebooks
        return kind
    return tqdm


Given = ParamSpec("Given")
Result = TypeVar("Result")


def with_progress(instrument: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let ``progress=True`` of an instrument stand for a bar, and refuse what is no function.

    A function that cannot write what it is told ends no run.
    """

    @wraps(instrument)
    def measured(*args: Given.args, **given: Given.kwargs) -> Result:
        progress: Any = given.get("progress")
        if progress is True:
            with ProgressBar(instrument.__name__) as bar:
                return instrument(*args, **{**given, "progress": bar})  # type: ignore[arg-type]
        if progress is False:
            return instrument(*args, **{**given, "progress": None})  # type: ignore[arg-type]
        if progress is not None and not callable(progress):
            allowed = "True for a bar, or a function that takes a splits.Progress"
            raise invalid("progress", progress, allowed)
        if progress is not None and not isinstance(progress, ProgressBar):
            given["progress"] = _suppress_write_errors(progress)
        return instrument(*args, **given)

    return measured


def _suppress_write_errors(callback: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Return a function that does what another does, and passes over what that cannot write."""

    def told(progress: Progress) -> None:
        with suppress(OSError, UnicodeError):
            callback(progress)

    return told


def write_line(line: str, stream: TextIO | None) -> None:
    """Write a line to a stream of this process if that is possible.

    What says how far a run is must not end it: a stream that fails (a full disk, a reader that has
    gone, a closed terminal) takes nothing from then on, and characters that its encoding does not
    have are escaped.

    Parameters
    ----------
    line : str
    stream : text file or None
        None, as `sys.stderr` is in programs without a terminal, takes nothing.
    """
    if stream is None:
        return
    try:
        encoding = stream.encoding or "utf-8"
        plain = line.encode(encoding, "backslashreplace").decode(encoding)
        print(plain, file=stream, flush=True)
    except (OSError, ValueError):
        # What it still holds would fail again at the end of the process, and be its exit status.
        with suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())


@contextmanager
def open_progress_log(path: str | Path) -> Iterator[Callable[[str], None]]:
    """Give a function that shows a line in the terminal and keeps it in a file.

    Where either cannot be written the other still is, and the run goes on.

    Parameters
    ----------
    path : path
        Of the file, which is written anew.
    """
    with open(path, "w", encoding="utf-8") as log:

        def say(line: str) -> None:
            write_line(line, sys.stderr)
            write_line(line, log)

        yield say
