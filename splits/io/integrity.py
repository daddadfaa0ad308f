"""Checksums of netCDF files, for detection of damage.

A file has two checksums.  The attribute `CHECKSUM_ATTRIBUTE` is the SHA-256 of its content: of all
other attributes, and of all variables with names, dimensions, types, values and attributes.  It
does not depend on the storage (chunks, compression, order), so it remains valid in a copy by
another program.  It covers attributes of the run, such as the date, so two runs with the same
numbers have different checksums.

The last bytes of a file, after those that netCDF reads, are the SHA-256 of all bytes before them.
HDF5 crashes or hangs on some damaged files, so the bytes are verified before HDF5 opens the file.
Only this package writes them.  A file without them is of another program, which may have copied
the attribute from a file of this package: if it does not match the content, the program changed the
content, and the file counts as one without checksums.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from splits.core.atomic import atomic_write, check_disk_space
from splits.core.locks import make_lock

CHECKSUM_ATTRIBUTE = "content_sha256"
NETCDF_LOCK = make_lock()
"""Lock for all reading and writing, because the HDF5 library is not thread-safe."""
REMEDY_HINT = "make it again; a run of snakemake does so automatically"
_TRAILER_MARK = b"splits-sha256:"
_TRAILER_SIZE = len(_TRAILER_MARK) + 64
_CHUNK_BYTES = 2**24
"""Number of bytes read at a time."""
_OVERHEAD_BYTES = 2**20
"""Upper bound of the bytes of a file besides its values: structure, attributes and text."""
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class DamagedFileError(ValueError):
    """Damaged file: its content differs from what was written; the message is one line."""


def hash_content(file: netCDF4.Dataset) -> str:
    """Return the checksum of the content of an open netCDF file."""
    file.set_auto_maskandscale(False)
    digest = hashlib.sha256(_encode_attributes(file))
    for name in sorted(file.variables):
        variable = file.variables[name]
        digest.update(_encode_json([name, *variable.dimensions]))
        digest.update(_encode_attributes(variable))
        for chunk in _encode_variable(variable):
            digest.update(chunk)
    return digest.hexdigest()


@contextmanager
def atomic_netcdf(path: Path, n_bytes: int) -> Iterator[Path]:
    """Yield a temporary path of a netCDF file that then replaces `path`; see `atomic_write`.

    Parameters
    ----------
    path : path
    n_bytes : int
        Size of the values in bytes.

    Raises
    ------
    OSError
        If the disk is full, or the file cannot be written.
    """
    with NETCDF_LOCK, atomic_write(path) as temporary:
        # HDF5 never closes a file that it cannot complete on a full disk.
        check_disk_space(temporary, n_bytes + n_bytes // 16 + _OVERHEAD_BYTES)
        try:
            yield temporary
        except RuntimeError as error:
            # Frees the space in case another program has filled the disk meanwhile.
            os.truncate(temporary, 0)
            problem = f"cannot be written, perhaps no space is left ({error})"
            raise OSError(errno.EIO, problem, str(path)) from None


def write_checksums(path: str | Path) -> None:
    """Write both checksums into a netCDF file."""
    with NETCDF_LOCK, netCDF4.Dataset(path, "a") as file:
        file.setncattr(CHECKSUM_ATTRIBUTE, hash_content(file))
    digest = _hash_bytes(path, Path(path).stat().st_size)
    with open(path, "ab") as file:
        file.write(_TRAILER_MARK + digest.encode())


def verify_checksums(path: str | Path) -> dict[str, Any]:
    """Verify the checksums of a netCDF file and return its attributes.

    The attributes lack `CHECKSUM_ATTRIBUTE` if another program wrote or changed the content, which
    then cannot be verified.

    Raises
    ------
    DamagedFileError
        If bytes differ from those that this package wrote, or the file cannot be read as netCDF.
    OSError
        If the file cannot be opened.
    """
    # Outside the try block: disk errors and missing permissions are not damage.
    start, mark, size = _read_ends(path)
    has_trailer = mark.startswith(_TRAILER_MARK)
    if (
        has_trailer
        and mark[len(_TRAILER_MARK) :] != _hash_bytes(path, size - _TRAILER_SIZE).encode()
    ):
        raise _make_damaged_error(path, "the checksum of its bytes differs")
    if not size:
        raise _make_damaged_error(path, "the file is empty")
    # The HDF5 superblock (versions 2 and 3) holds the length of the file.
    if not has_trailer and start.startswith(_HDF5_SIGNATURE) and start[8:9] in (b"\2", b"\3"):
        expected_size = int.from_bytes(start[28:36], "little")
        if expected_size != size:
            raise _make_damaged_error(path, f"{size} bytes instead of {expected_size}")
    try:
        with NETCDF_LOCK, netCDF4.Dataset(path) as file:
            attributes = {name: file.getncattr(name) for name in file.ncattrs()}
            digest = "" if has_trailer else hash_content(file)
    # Damaged bytes cause errors of almost any type in the HDF5 and netCDF libraries.
    except Exception as error:
        text = str(error).replace(f": {str(path)!r}", "")
        problem = " ".join(text.split()) or type(error).__name__
        raise _make_damaged_error(path, f"cannot be read: {problem}") from None
    if not has_trailer and attributes.get(CHECKSUM_ATTRIBUTE) != digest:
        attributes.pop(CHECKSUM_ATTRIBUTE, None)
    return attributes


def find_damage(path: str | Path, experiment: str = "") -> str:
    """Return a one-line reason why a file is not a dataset of a workflow, or an empty text.

    Parameters
    ----------
    path : path
    experiment : str
        Experiment whose dataset the file must hold, or "" for none.
    """
    try:
        attributes = verify_checksums(path)
    except DamagedFileError as error:
        return str(error)
    if CHECKSUM_ATTRIBUTE not in attributes:
        return f"{path}: another program wrote or changed it ({REMEDY_HINT})"
    owner = attributes.get("experiment", "")
    if owner != experiment:
        content = f"the dataset of experiment {owner}" if owner else "no experiment's dataset"
        return f"{path}: holds {content}, not of {experiment or 'several'} ({REMEDY_HINT})"
    return ""


def _read_ends(path: str | Path) -> tuple[bytes, bytes, int]:
    """Return the first and last bytes of a file, and its size."""
    with open(path, "rb") as file:
        start = file.read(_TRAILER_SIZE)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _TRAILER_SIZE, 0))
        return start, file.read(), size


def _hash_bytes(path: str | Path, n_bytes: int) -> str:
    """Return the checksum of the first bytes of a file, read in chunks."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while n_bytes > 0 and (chunk := file.read(min(n_bytes, _CHUNK_BYTES))):
            digest.update(chunk)
            n_bytes -= len(chunk)
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
    """Yield the encoding of a variable (see `_encode_values`) in chunks."""
    if variable.dtype is str or variable.dtype.kind not in "biuf" or not variable.ndim:
        yield _encode_values(variable[...])
        return
    shape, width = list(variable.shape), variable.dtype.itemsize
    yield _encode_json([variable.dtype.newbyteorder("<").str, shape])
    yield _encode_length(width * math.prod(shape))
    # First axis whose rows are smaller than a chunk.
    rows = [width * math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    axis = next((axis for axis, row in enumerate(rows) if row <= _CHUNK_BYTES), len(shape) - 1)
    step = max(1, _CHUNK_BYTES // max(rows[axis], 1))
    for outer_index in np.ndindex(*shape[:axis]):
        for first in range(0, shape[axis], step):
            yield _to_little_endian(
                np.asarray(variable[(*outer_index, slice(first, first + step))])
            ).tobytes()


def _encode_values(values: Any) -> bytes:
    """Return the machine-independent encoding of numbers or text with type and shape."""
    array = np.asarray(values)
    if array.dtype.kind in "OUS":
        return _encode_json([list(array.shape), [str(value) for value in array.ravel()]])
    little = _to_little_endian(array)
    return _encode_json([little.dtype.str, list(array.shape)]) + _prefix_length(little.tobytes())


def _to_little_endian(array: np.ndarray) -> np.ndarray:
    """Return numbers in little-endian byte order."""
    return array.astype(array.dtype.newbyteorder("<"), copy=False)


def _encode_json(content: list[Any]) -> bytes:
    return _prefix_length(json.dumps(content).encode())


def _prefix_length(content: bytes) -> bytes:
    """Return bytes prefixed by their number, which makes concatenations unambiguous."""
    return _encode_length(len(content)) + content


def _encode_length(count: int) -> bytes:
    return count.to_bytes(8, "little")
