"""Lines of progress in the terminal and in a file of their own."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def progress_log(path: str | Path) -> Iterator[Callable[[str], None]]:
    """Give a function that shows a line in the terminal and keeps it in a file.

    Parameters
    ----------
    path : path
        Of the file, which is written anew.
    """
    with open(path, "w", encoding="utf-8") as log:

        def say(line: str) -> None:
            print(line, file=sys.stderr, flush=True)
            print(line, file=log, flush=True)

        yield say
