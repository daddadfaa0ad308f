"""Files and folders that appear whole or not at all, and what killed writers have left."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splits.interrupts import half_written
from splits.paths import expand_path

DAMAGED = ".damaged"
"""What the name of a file gets at its end when it is set aside."""
_ASIDE = re.compile(r"\.aside\.(?P<host>[^.]+)\.(?P<process>\d+)\.[0-9a-f]{8}\..+")
_OPEN: set[str] = set()
"""Names that this process is writing to."""


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Give a name to write to; that file takes the place of `path` when the block ends well.

    If the block raises, the file is deleted and what was at `path` stays.  A check of what was
    written belongs at the end of the block.  The folder is made, and leftovers in it are removed
    (see `sweep`).

    Parameters
    ----------
    path : path

    Yields
    ------
    Path
        In the same folder, with the same suffix; a hidden name that carries host and process.
    """
    path = expand_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _beside(path) as aside, half_written(aside):
        yield aside
        os.replace(aside, path)


@contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Give a new folder to write into; it gets the name `path` when the block ends well.

    If the block raises, the folder is deleted with all that is in it.  Leftovers beside it are
    removed (see `sweep`).

    Parameters
    ----------
    path : path
        Must not exist, or be an empty folder; the folder that it stands in must exist.

    Yields
    ------
    Path
        In the same folder; a hidden name that carries host and process.
    """
    path = expand_path(path)
    with _beside(path) as aside:
        aside.mkdir()
        try:
            yield aside
            if path.exists():
                path.rmdir()
            aside.rename(path)
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Give a name beside a path that `sweep` knows, where leftovers are removed first."""
    sweep(path.parent)
    # Names of files may have 255 bytes; a host's name can take 64 of them.
    name = path.name[-40:]
    aside = path.with_name(f".aside.{_host()}.{os.getpid()}.{secrets.token_hex(4)}.{name}")
    _OPEN.add(aside.name)
    try:
        yield aside
    finally:
        _OPEN.discard(aside.name)


def sweep(folder: str | Path) -> list[Path]:
    """Delete what processes of this host that are gone have left unfinished in a folder.

    What is of running processes and of other hosts stays: nobody here can tell whether those run.

    Parameters
    ----------
    folder : path
        Need not exist; folders in it are left alone.

    Returns
    -------
    list of Path
        What was deleted.
    """
    gone = []
    for path in Path(folder).glob(".aside.*"):
        found = _ASIDE.fullmatch(path.name)
        if not found or found["host"] != _host() or path.name in _OPEN:
            continue
        process = int(found["process"])
        # A file of a process with our own number that we did not open is of one before us.
        if process != os.getpid() and _runs(process):
            continue
        with suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
            gone.append(path)
    return gone


def set_aside(path: str | Path) -> Path:
    """Rename a damaged file to ``NAME.damaged``, over an earlier one, and return its new name."""
    path = Path(path)
    return path.replace(path.with_name(path.name + DAMAGED))


def _host() -> str:
    return socket.gethostname().replace(".", "_") or "unknown"


def _runs(process: int) -> bool:
    """Tell whether a process of that number runs on this host, whosoever it is."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
