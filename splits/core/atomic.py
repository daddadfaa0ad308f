"""Atomic writes of files and folders.

Content is written under a hidden name in the folder of its target, which it then replaces in one
step.  A killed process leaves the old target or the new one, and perhaps a file of such a name,
which a later write in that folder removes.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splits.core.validation import expand_path

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers of a full disk or an exceeded quota."""
ABANDONED_AFTER_S = 86_400.0
"""Time (s) without a change after which a temporary file is abandoned; no write takes as long."""
_ABANDONED_PATTERN = ".aside." + 16 * "[0-9a-f]" + ".*"


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path; the file or folder made there replaces `path` if the block succeeds.

    If the block raises, the temporary file is deleted and `path` is unchanged.  Verify the written
    file at the end of the block.  Processes may write the same target at the same time: it is that
    of the last one.  Errors of writing name `path`.

    Parameters
    ----------
    path : path
        Its folder is created.  A folder that is replaced must be empty.

    Yields
    ------
    Path
        Hidden path in the same folder, with the same suffix.
    """
    path = expand_path(path)
    with _reserve_temporary_path(path) as temporary:
        yield temporary
        if temporary.is_dir():
            with suppress(FileNotFoundError):
                path.rmdir()
        else:
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
        os.replace(temporary, path)


@contextmanager
def _reserve_temporary_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, and remove what is there afterwards.

    The temporary files of killed processes in the folder are removed, too.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for abandoned in path.parent.glob(_ABANDONED_PATTERN):
        with suppress(FileNotFoundError):
            if time.time() - abandoned.lstat().st_mtime > ABANDONED_AFTER_S:
                _remove(abandoned)
    # File names are limited to 255 bytes.
    temporary = path.with_name(f".aside.{secrets.token_hex(8)}.{path.name[-40:]}")
    try:
        yield temporary
    except OSError as error:
        # Errors in the middle of a write carry no file name.
        nameless = error.filename is None and error.errno in DISK_FULL_ERRORS
        if not nameless and str(error.filename) != str(temporary):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        _remove(temporary)


def _remove(path: Path) -> None:
    """Remove a file or a folder as far as this is possible."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


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
    with _reserve_temporary_path(path) as temporary:
        temporary.touch()
