"""Checksums of datasets: what a netCDF file holds is what was written into it.

A file has two.  The attribute `CHECKSUM` is the SHA-256 of its content: of all attributes but
itself, and of all variables with names, dimensions, types, values and attributes.  How the content
is stored (chunks, compression, order) does not count, so that it stays right in a copy by another
program.  Attributes that name the occasion of a run count, so that no change goes unnoticed: two
runs that agree in all numbers differ in their checksums.

The last bytes of a file, behind what netCDF reads, are the SHA-256 of all bytes before them.  HDF5
crashes or never comes back from some damaged files, so the bytes are checked before it sees them.
"""

from __future__ import annotations

import hashlib
import json
import threading
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

CHECKSUM = "content_sha256"
LOCK = threading.RLock()
"""Held wherever files are written or read: the libraries underneath bear one thread at a time."""
REMEDY = "make it again; a run of snakemake does so by itself"
_SEAL = b"splits-sha256:"
_SEAL_SIZE = len(_SEAL) + 64
_HDF5 = b"\x89HDF\r\n\x1a\n"


class DamagedError(ValueError):
    """A file that does not hold what was written into it; the message is one line."""


def content_sha256(file: netCDF4.Dataset) -> str:
    """Return the checksum of the content of an open netCDF file."""
    file.set_auto_maskandscale(False)
    digest = hashlib.sha256(_attributes(file))
    for name in sorted(file.variables):
        variable = file.variables[name]
        digest.update(_text([name, *variable.dimensions]))
        digest.update(_attributes(variable))
        digest.update(_values(variable[...]))
    return digest.hexdigest()


def seal(path: str | Path) -> None:
    """Write both checksums into a netCDF file."""
    with LOCK, netCDF4.Dataset(path, "a") as file:
        file.setncattr(CHECKSUM, content_sha256(file))
    with open(path, "rb+") as file:
        digest = hashlib.sha256(file.read()).hexdigest()
        file.write(_SEAL + digest.encode())


def check(path: str | Path) -> dict[str, Any]:
    """Return the attributes of a netCDF file if it holds what was written into it.

    A file that has neither checksum passes if it can be read.

    Raises
    ------
    DamagedError
        If the bytes or the content do not have their checksum, or cannot be read as netCDF.
    OSError
        If the file cannot be opened.
    """
    # Read here: a disk that fails, a missing right or a file in use is no damage.
    content = Path(path).read_bytes()
    body, mark = content[:-_SEAL_SIZE], content[-_SEAL_SIZE:]
    sealed = mark.startswith(_SEAL)
    if sealed and mark[len(_SEAL) :] != hashlib.sha256(body).hexdigest().encode():
        raise _damaged(path, "its bytes have another checksum")
    if not content:
        raise _damaged(path, "the file is empty")
    # HDF5's superblock (versions 2 and 3) says how long the file is.
    if not sealed and content.startswith(_HDF5) and content[8:9] in (b"\2", b"\3"):
        size = int.from_bytes(content[28:36], "little")
        if size != len(content):
            raise _damaged(path, f"{len(content)} bytes where {size} belong")
    try:
        with LOCK, netCDF4.Dataset("memory", memory=content) as file:
            attributes = {name: file.getncattr(name) for name in file.ncattrs()}
            found = "" if sealed else content_sha256(file)
    # Damaged bytes make the libraries underneath raise errors of almost any kind.
    except Exception as error:
        what = " ".join(str(error).replace(": 'memory'", "").split()) or type(error).__name__
        raise _damaged(path, f"cannot be read: {what}") from None
    if not sealed and attributes.get(CHECKSUM, found) != found:
        raise _damaged(path, "its content has another checksum")
    return attributes


def damage(path: str | Path, experiment: str = "") -> str:
    """Return what is wrong with a dataset of a workflow in one line, or nothing.

    Parameters
    ----------
    path : path
    experiment : str
        Whose dataset it must be; "" for one of none.
    """
    try:
        found = check(path).get("experiment", "")
    except DamagedError as error:
        return str(error)
    if found != experiment:
        held = f"the dataset of experiment {found}" if found else "no experiment's dataset"
        return f"{path}: holds {held}, not of {experiment or 'several'} ({REMEDY})"
    return ""


def _damaged(path: str | Path, what: str) -> DamagedError:
    return DamagedError(f"{path}: damaged, {what} ({REMEDY})")


def _attributes(owner: netCDF4.Dataset | netCDF4.Variable) -> bytes:
    parts = []
    for name in sorted(owner.ncattrs()):
        if name != CHECKSUM:
            parts += [_text([name]), _values(owner.getncattr(name))]
    return _counted(b"".join(parts))


def _values(values: Any) -> bytes:
    """Return numbers or texts with their type and shape, the same on every machine."""
    array = np.asarray(values)
    if array.dtype.kind in "OUS":
        return _text([list(array.shape), [str(value) for value in array.ravel()]])
    little = array.astype(array.dtype.newbyteorder("<"))
    return _text([little.dtype.str, list(array.shape)]) + _counted(little.tobytes())


def _text(content: list[Any]) -> bytes:
    return _counted(json.dumps(content).encode())


def _counted(content: bytes) -> bytes:
    """Return bytes after their number, so that no two contents join to the same bytes."""
    return len(content).to_bytes(8, "little") + content
