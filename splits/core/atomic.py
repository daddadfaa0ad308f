"""Files and folders that appear whole or not at all, and what killed writers have left.

A writer holds a lock on a file of its own beside what it writes.  Locks end with the process that
holds them, however that ends, and wherever it is seen from: neither names of hosts nor numbers of
processes tell whether a writer lives, since containers and nodes share them.  A lock that was set
on another machine, or through another mount, need not be seen here: there age decides.
"""

from __future__ import annotations

import errno
import functools
import hashlib
import os
import re
import secrets
import shutil
import socket
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from splits.core.interrupts import track_unfinished_file
from splits.core.paths import expand_path

try:
    import fcntl
except ImportError:  # Windows has none: age alone decides there.
    fcntl = None  # type: ignore[assignment]

DAMAGED_SUFFIX = ".damaged"
"""What the name of a file gets at its end when it is set aside."""
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)
"""Numbers of errors that say that no space is left."""
ABANDONED_AFTER_S = 7 * 86_400.0
"""Time without a change after which a file is abandoned whose lock says nothing."""
_TEMPORARY_NAME_PATTERN = re.compile(
    r"(?P<lock>\.aside\.[0-9a-f]{16}\.[0-9a-f]{16})(\.[0-9a-f]{8}\..+)?"
)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a name to write to; that file takes the place of `path` when the block ends well.

    If the block raises, the file is deleted and what was at `path` stays.  A check of what was
    written belongs at the end of the block.  The folder is made, and leftovers in it are removed
    (see `remove_stale_files`).

    Parameters
    ----------
    path : path

    Yields
    ------
    Path
        In the same folder, with the same suffix; a hidden name.
    """
    path = expand_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _reserve_temporary_path(path) as aside, track_unfinished_file(aside):
        yield aside
        os.replace(aside, path)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Give a new folder to write into; it gets the name `path` when the block ends well.

    If the block raises, the folder is deleted with all that is in it.  Leftovers beside it are
    removed (see `remove_stale_files`).

    Parameters
    ----------
    path : path
        Must not exist, or be an empty folder; the folder that it stands in must exist.

    Yields
    ------
    Path
        In the same folder; a hidden name.
    """
    path = expand_path(path)
    with _reserve_temporary_path(path) as aside:
        aside.mkdir()
        try:
            yield aside
            if path.exists():
                path.rmdir()
            aside.rename(path)
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _reserve_temporary_path(path: Path) -> Iterator[Path]:
    """Give a name beside a path that `remove_stale_files` knows, where leftovers are removed first.

    What cannot be written is reported with the name of the path, not with the hidden one.
    """
    remove_stale_files(path.parent)
    lock = path.with_name(f".aside.{_get_lock_domain(path.parent)}.{secrets.token_hex(8)}")
    # Names of files may have 255 bytes.  The second number keeps others from foreseeing this one.
    aside = path.with_name(f"{lock.name}.{secrets.token_hex(4)}.{path.name[-40:]}")
    try:
        with track_unfinished_file(lock), open(lock, "xb") as file:
            if fcntl:
                # Where files cannot be locked, age decides.
                with suppress(OSError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield aside
    except OSError as error:
        # What fails in the midst of a file knows no name.
        nameless = error.filename is None and error.errno in DISK_FULL_ERRORS
        if not nameless and str(error.filename) not in (str(lock), str(aside)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def remove_stale_files(folder: str | Path) -> list[Path]:
    """Delete what writers that have ended left unfinished in a folder.

    What is locked stays.  So does what was written on another machine or through another mount, or
    where files cannot be locked, until nothing has changed there for `ABANDONED_AFTER_S`.

    Parameters
    ----------
    folder : path
        Need not exist; folders in it are left alone.

    Returns
    -------
    list of Path
        What was deleted.
    """
    left: dict[Path, list[Path]] = {}
    for path in Path(folder).glob(".aside.*"):
        if found := _TEMPORARY_NAME_PATTERN.fullmatch(path.name):
            left.setdefault(path.with_name(found["lock"]), []).append(path)
    gone = []
    for lock, paths in left.items():
        with suppress(OSError):
            ended = _has_writer_ended(lock)
            if not (_is_abandoned(paths) if ended is None else ended):
                continue
        # The lock last: what is without one is judged by its age.
        for path in sorted(paths, key=lambda one: one == lock):
            with suppress(OSError):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
                gone.append(path)
    return gone


def _has_writer_ended(lock: Path) -> bool | None:
    """Return whether the writer that held a lock has ended; None where that cannot be known."""
    if fcntl is None:
        return None
    try:
        # NFS locks only what is open for writing.
        with open(lock, "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True if lock.name.split(".")[2] == _get_lock_domain(lock.parent) else None


def _is_abandoned(paths: Sequence[Path]) -> bool:
    """Return whether nothing in some files and folders has changed for `ABANDONED_AFTER_S`."""
    every = [one for path in paths for one in (path, *path.rglob("*"))]
    return time.time() - max(one.lstat().st_mtime for one in every) > ABANDONED_AFTER_S


def _get_lock_domain(folder: Path) -> str:
    """Return a name of the running system and of the mount that a folder is on.

    Processes that agree in it see each other's locks.
    """
    seen = f"{_get_boot_id()} {folder.stat().st_dev}"
    return hashlib.sha256(seen.encode()).hexdigest()[:16]


@functools.cache
def _get_boot_id() -> str:
    """Return what tells a running system from all others, whatever its host is called."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except (OSError, ValueError):
        return f"{socket.gethostname()} {uuid.getnode()}"


def check_writable(path: str | Path) -> None:
    """Make the folder of a file, and refuse a path at which no file can be put.

    What takes long to compute is not to be lost at its end.

    Raises
    ------
    OSError
        As writing there would.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    with _reserve_temporary_path(path) as aside, track_unfinished_file(aside):
        aside.touch()


def check_disk_space(path: Path, n_bytes: int) -> None:
    """Take the space that a file needs for a moment, and leave the file empty.

    Parameters
    ----------
    path : path
        Of a new file.
    n_bytes : int
        Bytes.

    Raises
    ------
    OSError
        If no such space is left.
    """
    with open(path, "wb") as file:
        try:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, n_bytes)
            elif shutil.disk_usage(path.parent).free < n_bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        except OSError as error:
            # Not all file systems take space in advance.
            if error.errno in DISK_FULL_ERRORS:
                raise
        finally:
            file.truncate(0)


def rename_damaged_file(path: str | Path) -> Path:
    """Rename a damaged file to ``NAME.damaged``, over an earlier one, and return its new name."""
    path = Path(path)
    return path.replace(path.with_name(path.name + DAMAGED_SUFFIX))
