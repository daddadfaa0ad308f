"""Atomic writes, and removal of temporary files left by killed processes.

A writer holds a lock on a separate file beside its output.  The operating system releases the lock
when the process exits.  Host names and process numbers cannot identify a live writer, because
containers and cluster nodes reuse them.  A lock set on another machine, or through another mount,
may not be visible here; the age of the files decides then.
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
except ImportError:  # Not available on Windows, where age alone decides.
    fcntl = None  # type: ignore[assignment]

DAMAGED_SUFFIX = ".damaged"
"""Suffix of a damaged file after renaming."""
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers of a full disk or an exceeded quota."""
ABANDONED_AFTER_S = 7 * 86_400.0
"""Time (s) without a change after which a file of unknown lock state is abandoned."""
_TEMPORARY_NAME_PATTERN = re.compile(
    r"(?P<lock>\.aside\.[0-9a-f]{16}\.[0-9a-f]{16})(\.[0-9a-f]{8}\..+)?"
)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path; the file written there replaces `path` if the block succeeds.

    If the block raises, the temporary file is deleted and `path` is unchanged.  Verify the written
    file at the end of the block.  The parent folder is created, and stale files in it are removed
    (see `remove_stale_files`).

    Parameters
    ----------
    path : path

    Yields
    ------
    Path
        Hidden path in the same folder, with the same suffix.
    """
    path = expand_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _reserve_temporary_path(path) as temporary, track_unfinished_file(temporary):
        yield temporary
        os.replace(temporary, path)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a new temporary folder; it is renamed to `path` if the block succeeds.

    If the block raises, the temporary folder is deleted with its content.  Stale files beside it
    are removed (see `remove_stale_files`).

    Parameters
    ----------
    path : path
        Must not exist or be an empty folder; its parent folder must exist.

    Yields
    ------
    Path
        Hidden path in the same parent folder.
    """
    path = expand_path(path)
    with _reserve_temporary_path(path) as temporary:
        temporary.mkdir()
        try:
            yield temporary
            if path.exists():
                path.rmdir()
            temporary.rename(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _reserve_temporary_path(path: Path) -> Iterator[Path]:
    """Yield a locked temporary path beside `path`, after removing stale files there.

    Errors of writing name `path`, not the hidden temporary path.
    """
    remove_stale_files(path.parent)
    lock = path.with_name(f".aside.{_get_lock_domain(path.parent)}.{secrets.token_hex(8)}")
    # File names are limited to 255 bytes.  The second random number makes the name unpredictable.
    temporary = path.with_name(f"{lock.name}.{secrets.token_hex(4)}.{path.name[-40:]}")
    try:
        with track_unfinished_file(lock), open(lock, "xb") as file:
            if fcntl:
                # On file systems without locks, age decides.
                with suppress(OSError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield temporary
    except OSError as error:
        # Errors in the middle of a write carry no file name.
        nameless = error.filename is None and error.errno in DISK_FULL_ERRORS
        if not nameless and str(error.filename) not in (str(lock), str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def remove_stale_files(folder: str | Path) -> list[Path]:
    """Delete temporary files in a folder whose writers have ended.

    Locked files are kept.  Files written on another machine, through another mount or on a file
    system without locks are kept until they are unchanged for `ABANDONED_AFTER_S`.

    Parameters
    ----------
    folder : path
        Need not exist; subfolders are not searched.

    Returns
    -------
    list of Path
        Deleted files and folders.
    """
    stale: dict[Path, list[Path]] = {}
    for path in Path(folder).glob(".aside.*"):
        if match := _TEMPORARY_NAME_PATTERN.fullmatch(path.name):
            stale.setdefault(path.with_name(match["lock"]), []).append(path)
    deleted = []
    for lock, paths in stale.items():
        with suppress(OSError):
            ended = _has_writer_ended(lock)
            if not (_is_abandoned(paths) if ended is None else ended):
                continue
        # The lock file last, because files without one are judged by age.
        for path in sorted(paths, key=lambda entry: entry == lock):
            with suppress(OSError):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
                deleted.append(path)
    return deleted


def _has_writer_ended(lock: Path) -> bool | None:
    """Return whether the writer that held a lock has ended, or None if unknown."""
    if fcntl is None:
        return None
    try:
        # NFS requires write access for locking.
        with open(lock, "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True if lock.name.split(".")[2] == _get_lock_domain(lock.parent) else None


def _is_abandoned(paths: Sequence[Path]) -> bool:
    """Return whether files and folders are unchanged for `ABANDONED_AFTER_S`."""
    entries = [entry for path in paths for entry in (path, *path.rglob("*"))]
    return time.time() - max(entry.lstat().st_mtime for entry in entries) > ABANDONED_AFTER_S


def _get_lock_domain(folder: Path) -> str:
    """Return an identifier of the running system and of the mount of a folder.

    Processes with the same identifier see each other's locks.
    """
    domain = f"{_get_boot_id()} {folder.stat().st_dev}"
    return hashlib.sha256(domain.encode()).hexdigest()[:16]


@functools.cache
def _get_boot_id() -> str:
    """Return an identifier of the running system that does not depend on the host name."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except (OSError, ValueError):
        return f"{socket.gethostname()} {uuid.getnode()}"


def check_writable(path: str | Path) -> None:
    """Create the folder of a file and check that the file can be written.

    The check precedes long computations, whose results would otherwise be lost.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    with _reserve_temporary_path(path) as temporary, track_unfinished_file(temporary):
        temporary.touch()


def check_disk_space(path: Path, n_bytes: int) -> None:
    """Check that a file of given size fits on the disk by allocating it temporarily.

    The file is left empty.

    Parameters
    ----------
    path : path
        New file.
    n_bytes : int
        Size in bytes.

    Raises
    ------
    OSError
        If the space is not available.
    """
    with open(path, "wb") as file:
        try:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, n_bytes)
            elif shutil.disk_usage(path.parent).free < n_bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        except OSError as error:
            # Some file systems do not support preallocation.
            if error.errno in DISK_FULL_ERRORS:
                raise
        finally:
            file.truncate(0)


def rename_damaged_file(path: str | Path) -> Path:
    """Rename a damaged file to ``NAME.damaged``, replacing an earlier one; return the new path."""
    path = Path(path)
    return path.replace(path.with_name(path.name + DAMAGED_SUFFIX))
