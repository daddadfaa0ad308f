"""Checksums of datasets: what a netCDF file holds is what was written into it.

The attribute `CHECKSUM` of a file is the SHA-256 of its content: of all attributes but itself, and
of all variables with names, dimensions, types, values and attributes.  How the content is stored
(chunks, compression, order) does not count.  Attributes that name the occasion of a run count, so
that no flipped byte goes unnoticed: two runs that agree in all numbers differ in their checksums.

Only netCDF4 and NumPy are needed, so that a workflow can check all its files when it starts.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

CHECKSUM = "content_sha256"
REMEDY = "make it again; a run of snakemake does so by itself"


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
    """Write the checksum of a netCDF file's content into it."""
    with netCDF4.Dataset(path, "a") as file:
        file.setncattr(CHECKSUM, content_sha256(file))


def checked_attributes(path: str | Path) -> dict[str, Any]:
    """Return the attributes of a netCDF file if its content is what was written.

    A file without a checksum passes; see `CHECKSUM` among what is returned.

    Raises
    ------
    DamagedError
        If the file cannot be read as netCDF, or its content does not have its checksum.
    OSError
        If the file cannot be opened.
    """
    # From memory: a disk that fails, a missing right or a file in use is no damage.
    content = Path(path).read_bytes()
    if not content:
        raise DamagedError(f"{path}: damaged, the file is empty ({REMEDY})")
    try:
        with netCDF4.Dataset("memory", memory=content) as file:
            attributes = {name: file.getncattr(name) for name in file.ncattrs()}
            found = content_sha256(file)
    # Damaged bytes make the libraries underneath raise errors of almost any kind.
    except Exception as error:
        what = " ".join(str(error).replace(": 'memory'", "").split()) or type(error).__name__
        raise DamagedError(f"{path}: damaged, cannot be read: {what} ({REMEDY})") from None
    if attributes.get(CHECKSUM, found) != found:
        raise DamagedError(f"{path}: damaged, its content has another checksum ({REMEDY})")
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
        found = checked_attributes(path).get("experiment", "")
    except DamagedError as error:
        return str(error)
    if found != experiment:
        held = f"the dataset of experiment {found}" if found else "no experiment's dataset"
        return f"{path}: holds {held}, not of {experiment or 'several'} ({REMEDY})"
    return ""


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
