"""Lines of progress in the terminal and in a file of their own."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO


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
def progress_log(path: str | Path) -> Iterator[Callable[[str], None]]:
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
