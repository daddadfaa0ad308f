"""Checksums of datasets: what a netCDF file holds is what was written into it.

A file has two.  The attribute `CHECKSUM_ATTRIBUTE` is the SHA-256 of its content: of all attributes but
itself, and of all variables with names, dimensions, types, values and attributes.  How the content
is stored (chunks, compression, order) does not count, so that it stays right in a copy by another
program.  Attributes that name the occasion of a run count, so that no change goes unnoticed: two
runs that agree in all numbers differ in their checksums.

The last bytes of a file, behind what netCDF reads, are the SHA-256 of all bytes before them.  HDF5
crashes or never comes back from some damaged files, so the bytes are checked before it sees them.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from splits.core.atomic import atomic_write, check_disk_space

CHECKSUM_ATTRIBUTE = "content_sha256"
NETCDF_LOCK = threading.RLock()
"""Held wherever files are written or read: the libraries underneath bear one thread at a time."""
REMEDY_HINT = "make it again; a run of snakemake does so by itself"
_TRAILER_MARK = b"splits-sha256:"
_TRAILER_SIZE = len(_TRAILER_MARK) + 64
_CHUNK_BYTES = 2**24
"""Bytes of a file that are read at a time."""
_OVERHEAD_BYTES = 2**20
"""Bytes of a file besides its values, more than enough: its structure, attributes and texts."""
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class DamagedFileError(ValueError):
    """A file that does not hold what was written into it; the message is one line."""


def hash_content(file: netCDF4.Dataset) -> str:
    """Return the checksum of the content of an open netCDF file."""
    file.set_auto_maskandscale(False)
    digest = hashlib.sha256(_encode_attributes(file))
    for name in sorted(file.variables):
        variable = file.variables[name]
        digest.update(_encode_json([name, *variable.dimensions]))
        digest.update(_encode_attributes(variable))
        for part in _encode_variable(variable):
            digest.update(part)
    return digest.hexdigest()


@contextmanager
def atomic_netcdf(path: Path, n_bytes: int) -> Iterator[Path]:
    """Give a name to write a netCDF file to, which then takes the place of a path; see `atomic_write`.

    Parameters
    ----------
    path : path
    n_bytes : int
        Bytes of its values.

    Raises
    ------
    OSError
        If there is no space for it, or it cannot be written.
    """
    with NETCDF_LOCK, atomic_write(path) as aside:
        # HDF5 keeps a file open for good that a full disk does not let it complete.
        check_disk_space(aside, n_bytes + n_bytes // 16 + _OVERHEAD_BYTES)
        try:
            yield aside
        except RuntimeError as error:
            # So that at least its space is free, if another program took what was left meanwhile.
            os.truncate(aside, 0)
            what = f"cannot be written, perhaps no space is left ({error})"
            raise OSError(errno.EIO, what, str(path)) from None


def write_checksums(path: str | Path) -> None:
    """Write both checksums into a netCDF file."""
    with NETCDF_LOCK, netCDF4.Dataset(path, "a") as file:
        file.setncattr(CHECKSUM_ATTRIBUTE, hash_content(file))
    digest = _hash_bytes(path, Path(path).stat().st_size)
    with open(path, "ab") as file:
        file.write(_TRAILER_MARK + digest.encode())


def verify_checksums(path: str | Path) -> dict[str, Any]:
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
    start, mark, size = _read_ends(path)
    sealed = mark.startswith(_TRAILER_MARK)
    if sealed and mark[len(_TRAILER_MARK) :] != _hash_bytes(path, size - _TRAILER_SIZE).encode():
        raise _make_damaged_error(path, "its bytes have another checksum")
    if not size:
        raise _make_damaged_error(path, "the file is empty")
    # HDF5's superblock (versions 2 and 3) says how long the file is.
    if not sealed and start.startswith(_HDF5_SIGNATURE) and start[8:9] in (b"\2", b"\3"):
        told = int.from_bytes(start[28:36], "little")
        if told != size:
            raise _make_damaged_error(path, f"{size} bytes where {told} belong")
    try:
        with NETCDF_LOCK, netCDF4.Dataset(path) as file:
            attributes = {name: file.getncattr(name) for name in file.ncattrs()}
            found = "" if sealed else hash_content(file)
    # Damaged bytes make the libraries underneath raise errors of almost any kind.
    except Exception as error:
        text = str(error).replace(f": {str(path)!r}", "")
        what = " ".join(text.split()) or type(error).__name__
        raise _make_damaged_error(path, f"cannot be read: {what}") from None
    if not sealed and attributes.get(CHECKSUM_ATTRIBUTE, found) != found:
        raise _make_damaged_error(path, "its content has another checksum")
    return attributes


def find_damage(path: str | Path, experiment: str = "") -> str:
    """Return what is wrong with a dataset of a workflow in one line, or nothing.

    Parameters
    ----------
    path : path
    experiment : str
        Whose dataset it must be; "" for one of none.
    """
    try:
        found = verify_checksums(path).get("experiment", "")
    except DamagedFileError as error:
        return str(error)
    if found != experiment:
        held = f"the dataset of experiment {found}" if found else "no experiment's dataset"
        return f"{path}: holds {held}, not of {experiment or 'several'} ({REMEDY_HINT})"
    return ""


def _read_ends(path: str | Path) -> tuple[bytes, bytes, int]:
    """Return the first and last bytes of a file, and how many it has."""
    with open(path, "rb") as file:
        start = file.read(_TRAILER_SIZE)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _TRAILER_SIZE, 0))
        return start, file.read(), size


def _hash_bytes(path: str | Path, n_bytes: int) -> str:
    """Return the checksum of the first bytes of a file, which need not fit into memory."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while n_bytes > 0 and (part := file.read(min(n_bytes, _CHUNK_BYTES))):
            digest.update(part)
            n_bytes -= len(part)
    return digest.hexdigest()


def _make_damaged_error(path: str | Path, problem: str) -> DamagedFileError:
    return DamagedFileError(f"{path}: damaged, {problem} ({REMEDY_HINT})")


def _encode_attributes(owner: netCDF4.Dataset | netCDF4.Variable) -> bytes:
    parts = []
    for name in sorted(owner.ncattrs()):
        if name != CHECKSUM_ATTRIBUTE:
            parts += [_encode_json([name]), _encode_values(owner.getncattr(name))]
    return _prefix_length(b"".join(parts))


def _encode_variable(variable: netCDF4.Variable) -> Iterator[bytes]:
    """Yield what `_encode_values` returns of a variable, which need not fit into memory."""
    if variable.dtype is str or variable.dtype.kind not in "biuf" or not variable.ndim:
        yield _encode_values(variable[...])
        return
    shape, width = list(variable.shape), variable.dtype.itemsize
    yield _encode_json([variable.dtype.newbyteorder("<").str, shape])
    yield _encode_length(width * math.prod(shape))
    # The first axis whose rows are small enough to be read several at a time.
    rows = [width * math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    axis = next((axis for axis, row in enumerate(rows) if row <= _CHUNK_BYTES), len(shape) - 1)
    step = max(1, _CHUNK_BYTES // max(rows[axis], 1))
    for before in np.ndindex(*shape[:axis]):
        for first in range(0, shape[axis], step):
            yield _to_little_endian(
                np.asarray(variable[(*before, slice(first, first + step))])
            ).tobytes()


def _encode_values(values: Any) -> bytes:
    """Return numbers or texts with their type and shape, the same on every machine."""
    array = np.asarray(values)
    if array.dtype.kind in "OUS":
        return _encode_json([list(array.shape), [str(value) for value in array.ravel()]])
    little = _to_little_endian(array)
    return _encode_json([little.dtype.str, list(array.shape)]) + _prefix_length(little.tobytes())


def _to_little_endian(array: np.ndarray) -> np.ndarray:
    """Return numbers in the order of bytes that most machines have."""
    return array.astype(array.dtype.newbyteorder("<"), copy=False)


def _encode_json(content: list[Any]) -> bytes:
    return _prefix_length(json.dumps(content).encode())


def _prefix_length(content: bytes) -> bytes:
    """Return bytes after their number, so that no two contents join to the same bytes."""
    return _encode_length(len(content)) + content


def _encode_length(count: int) -> bytes:
    return count.to_bytes(8, "little")
