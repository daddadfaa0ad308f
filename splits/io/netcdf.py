"""Datasets in netCDF files: CF attributes, provenance, schema versions, reading and writing.

Datasets in files have a schema version, and only files of the current version are read.
The version increases when variables, dimensions or attributes change their name or meaning, but not
for a new variable.

CF coordinates of dimensions are strictly monotonic numbers.  Coordinates of text or of unordered
numbers are auxiliary coordinates in the file, ``medium_label(medium)`` and
``depth_m_value(depth_m)``.  Names consist of letters, digits and underscores.

The arrays of a file have the checksums of HDF5 (fletcher32).  They do not cover text and the
structure of the file, and HDF5 crashes or hangs on some damaged files.  The last bytes of a file,
after those that netCDF reads, are therefore the SHA-256 of all bytes before them, verified before
HDF5 opens the file.  Other programs do not write them: damage of a file without them is detected
only as far as HDF5 does.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import re
import shlex
import shutil
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import splits.core.uncertainty  # noqa: F401  registers the accessor of errors
from splits.core.atomic import atomic_write
from splits.core.keywords import declare_function
from splits.core.process import make_lock
from splits.core.provenance import get_git_commit, get_package_version
from splits.core.validation import (
    InvalidValue,
    check_choice,
    check_number,
    expand_path,
    invalid,
    join_names,
)

SCHEMA_ATTRIBUTE = "splits_schema"
"""Attribute of the schema version; files without it are of version 0."""
SCHEMA_VERSION = 3
CF_CONVENTIONS = "CF-1.11"
NETCDF_SUFFIXES = (".nc", ".nc4", ".netcdf")
"""Suffixes of netCDF files."""
ANCILLARY_ATTRIBUTE = "ancillary_variables"
"""CF attribute that names the variables of errors and flags of a variable."""
NETCDF_LOCK = make_lock()
"""Lock for all reading and writing, because the HDF5 library is not thread-safe."""
LABEL_SUFFIX = "_label"
VALUE_SUFFIX = "_value"
"""Suffixes of auxiliary coordinates in a file, after the name of the dimension."""
DOTTED_NAMES_ATTRIBUTE = "names_with_dots"
"""File attribute: names with dots, which are underscores in the file."""
RENAMED_NAMES_ATTRIBUTE = "names_in_file"
"""File attribute: other names in the file with those of the dataset (JSON)."""
INDEX_LEVELS_ATTRIBUTE = "levels_of_dimensions"
"""File attribute: dimensions with a multi-index and the names of its levels (JSON)."""
_CHECKSUM_MARK = b"splits-sha256:"
_CHECKSUM_BYTES = len(_CHECKSUM_MARK) + 64
_CHUNK_BYTES = 2**24
"""Number of bytes read at a time."""
_OVERHEAD_BYTES = 2**20
"""Upper bound of the bytes of a file besides its values: structure, attributes and text."""
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class DamagedFileError(ValueError):
    """Damaged file (path) and its problem; the message is one line."""

    def __str__(self) -> str:
        path, problem = self.args
        return f"{path}: damaged, {problem} (delete it, and run again what made it)"


def check_schema(dataset: xr.Dataset, path: str | Path) -> None:
    """Check that a dataset has the current schema version.

    Parameters
    ----------
    dataset : xarray.Dataset
        As read from a file.
    path : path
        Path of the file, for messages.

    Raises
    ------
    ValueError
        If the schema version is invalid, or another version of this package wrote the file.
    """
    version = dataset.attrs.get(SCHEMA_ATTRIBUTE, 0)
    if not isinstance(version, (int, np.integer)) or version < 0:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {version!r}: must be a whole number, 0 or more"
        )
    written_by = dataset.attrs.get("splits_version", "unknown")
    if version > SCHEMA_VERSION:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {int(version)}: must be at most {SCHEMA_VERSION}; "
            f"a newer version of the package wrote it ({written_by}): "
            "update the copy of the repository, and run pip install . there"
        )
    if version < SCHEMA_VERSION:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {int(version)}: must be {SCHEMA_VERSION}; an older "
            f"version of the package wrote it ({written_by}): run the experiment again, or read it "
            "with that version"
        )


def make_provenance(action: str = "dataset made") -> dict[str, Any]:
    """Return the provenance attributes of a dataset: program, versions, date and history.

    Parameters
    ----------
    action : str
        Action for the attribute ``history``, such as "experiment fig08_grain_size".
    """
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": CF_CONVENTIONS,
        "source": f"splits {get_package_version()}",
        SCHEMA_ATTRIBUTE: SCHEMA_VERSION,
        "splits_version": get_package_version(),
        "splits_commit": get_git_commit(),
        "python_version": platform.python_version(),
        "numpy_version": np.__version__,
        "date_created": now,
        "history": f"{now} splits {get_package_version()}: {action}",
    }


def to_netcdf_attributes(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as netCDF attributes: numbers, strings and flat lists of numbers."""

    def plain(value: Any) -> Any:
        if value is None:
            return "none"
        if isinstance(value, (bool, np.bool_)):
            return "true" if value else "false"
        if isinstance(value, (tuple, list, np.ndarray)):
            return np.asarray(value)
        return value

    return {key: plain(value) for key, value in values.items()}


@declare_function
def save(dataset: Any, path: str | Path) -> None:
    """Write a dataset to a netCDF file atomically.

    Every array has a checksum (fletcher32), and the file has one of all its bytes; `load` verifies
    them.  Coordinates of text or of unordered numbers are auxiliary coordinates in the
    file, ``medium_label(medium)`` and ``depth_m_value(depth_m)``, as the CF conventions (section 5)
    require; `load` restores them as coordinates of their dimension.  Names in the file consist of
    letters, digits and underscores (section 2.3): ``layers.0.depth_m`` is ``layers_0_depth_m``
    there, and `load` restores the name.  A dataset without provenance, such as a part of another
    one, gets new provenance attributes.

    Parameters
    ----------
    dataset : xarray.Dataset or object with one
        Dataset returned by this package or derived from one; or the result of a retrieval or a
        `splits.Table`, of which the dataset is written.  Values are finite, or NaN where a flag
        variable named in ``ancillary_variables`` is not 0.
    path : path
        File with one of `NETCDF_SUFFIXES`.

    Raises
    ------
    ValueError
        For an object that is not a dataset, a value that is not finite, or another suffix.
    OSError
        If the file cannot be written, or does not hold the dataset afterwards.
    """
    path = expand_path(path)
    if path.suffix not in NETCDF_SUFFIXES:
        hint = "this writes netCDF; use dataset.to_dataframe().to_csv(…) for CSV"
        raise invalid("path", str(path), "a name that ends in " + ", ".join(NETCDF_SUFFIXES), hint)
    dataset = getattr(dataset, "dataset", dataset)
    if not isinstance(dataset, xr.Dataset):
        is_array = isinstance(dataset, xr.DataArray)
        name = str(dataset.name or "reflectance") if is_array else ""
        hint = f"write array.to_dataset(name={name!r})" if is_array else ""
        raise invalid("dataset", type(dataset).__name__, "an xarray.Dataset", hint)
    # Lazy arrays would otherwise be computed several times.
    dataset = dataset.compute()
    for key, variable in dataset.data_vars.items():
        if not np.issubdtype(variable.dtype, np.number):
            continue
        invalid_values = ~np.isfinite(variable)
        for flag_name in str(variable.attrs.get(ANCILLARY_ATTRIBUTE, "")).split():
            if flag_name in dataset and "flag_meanings" in dataset[flag_name].attrs:
                invalid_values &= ~((dataset[flag_name] != 0) & np.isnan(variable))
        if invalid_values.any():
            raise ValueError(f"{path.name}: {key} holds values that are not finite")
    encoded = encode_for_netcdf(dataset)
    encoded.attrs = {**make_provenance("dataset saved"), **encoded.attrs}
    # HDF5 supports checksums of numeric arrays only.
    encoding = {
        name: {
            "_FillValue": np.nan if v.dtype.kind == "f" and v.isnull().any() else None,
            "fletcher32": bool(v.size and v.ndim and v.dtype.kind in "biuf"),
        }
        for name, v in encoded.variables.items()
    }
    with atomic_netcdf(path, encoded.nbytes) as temporary:
        encoded.to_netcdf(temporary, engine="netcdf4", encoding=encoding)
        append_checksum(temporary)
        if not _read_file(temporary)[0].equals(dataset):
            raise OSError(f"{path}: the file written does not hold the dataset")


@declare_function
def load(path: str | Path) -> xr.Dataset:
    """Read a dataset into memory, and verify its origin and its checksums.

    A file of another schema version raises an error.  A file that another program wrote or changed
    gives a warning, because not every damage of it can be detected.

    Raises
    ------
    splits.io.netcdf.DamagedFileError
        A ValueError: if the file cannot be read, or its bytes differ from what was written.
    ValueError
        If the file has no provenance of this package, or another schema version.
    OSError
        If the file cannot be opened.
    """
    return _check_origin(*_read_file(path), path)


def open_lazily(path: str | Path) -> xr.Dataset:
    """Open a dataset as `load` does, with values read from the file on access.

    For datasets larger than memory.  The checksum of the whole file is verified on opening.
    """
    return _check_origin(*_read_file(path, lazy=True), path)


def _check_origin(dataset: xr.Dataset, has_checksum: bool, path: str | Path) -> xr.Dataset:
    """Return a dataset after checking that this version of the package can have written it."""
    if "splits_version" not in dataset.attrs:
        raise ValueError(f"{path}: not a dataset written by splits")
    check_schema(dataset, path)
    if not has_checksum:
        reason = "another program wrote or changed it"
        warnings.warn(
            f"{path}: has no checksum, so damage may not be detected ({reason})", stacklevel=2
        )
    return dataset


def _read_file(path: str | Path, *, lazy: bool = False) -> tuple[xr.Dataset, bool]:
    """Return the dataset in a file with its coordinates restored, and whether it is verified."""
    path = expand_path(path)
    has_checksum = verify_checksum(path)
    with NETCDF_LOCK:
        try:
            dataset = xr.open_dataset(path, engine="netcdf4")
            if not lazy:
                with dataset as file:
                    dataset = file.load()
        except MemoryError:
            raise
        # Damaged bytes cause errors of almost any type in the HDF5 and netCDF libraries.
        except Exception as error:
            with path.open("rb") as opened:
                is_named = path.suffix in NETCDF_SUFFIXES
                # A damaged file may not begin as netCDF files do.
                if not (is_named or opened.read(4).startswith((b"\x89HDF", b"CDF"))):
                    raise invalid("path", str(path), "a netCDF file") from None
            raise DamagedFileError(path, _describe_read_error(path, error)) from None
    for variable in dataset.variables.values():
        # Otherwise a later write would repeat it, even after coordinates have changed.
        variable.encoding.pop("coordinates", None)
    return decode_from_netcdf(dataset), has_checksum


@contextmanager
def open_foreign(key: str, path: str | Path) -> Iterator[xr.Dataset]:
    """Open a netCDF file of another program, to select and load variables in the block.

    Parameters
    ----------
    key : str
        Key named in error messages.
    path : path

    Raises
    ------
    ValueError
        If the file cannot be read or decoded, such as times in unknown units.
    """
    path = expand_path(path, key)
    with NETCDF_LOCK:
        try:
            with xr.open_dataset(path, engine="netcdf4") as dataset:
                yield dataset
        except InvalidValue:
            raise
        # The libraries raise errors of almost any type.
        except Exception as error:
            hint = _describe_read_error(path, error)
            raise invalid(key, str(path), "a netCDF file that can be read", hint) from None


def _describe_read_error(path: Path, error: Exception) -> str:
    """Return the message of a library that cannot read a file, on one line."""
    text = " ".join(str(error).replace(f": {str(path.absolute())!r}", "").split())
    return f"cannot be read: {text or type(error).__name__}"


def select_points(dataset: xr.Dataset, coordinates: Mapping[str, float | str]) -> xr.Dataset:
    """Select nodes of a dataset by their coordinates.

    Parameters
    ----------
    dataset : xarray.Dataset
    coordinates : mapping
        Coordinate by dimension: a number, matched up to rounding, or a label.

    Raises
    ------
    ValueError
        For an unknown dimension or coordinate.
    """
    for dimension, value in coordinates.items():
        check_choice("at", dimension, map(str, dataset.dims))
        values = dataset[dimension].values
        if np.issubdtype(values.dtype, np.number):
            target = check_number(f"at.{dimension}", value)
            position = int(np.abs(values - target).argmin())
            is_node = bool(np.isclose(values[position], target, rtol=1e-12, atol=0.0))
        else:
            position = int((values == str(value)).argmax())
            is_node = bool(values[position] == str(value))
        if not is_node:
            raise invalid(f"at.{dimension}", value, "one of " + join_names(values.tolist()))
        dataset = dataset.isel({dimension: position}, drop=True)
    return dataset


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
        needed = n_bytes + n_bytes // 16 + _OVERHEAD_BYTES
        if shutil.disk_usage(temporary.parent).free < needed:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        try:
            yield temporary
        except RuntimeError as error:
            # Frees the space in case another program has filled the disk meanwhile.
            os.truncate(temporary, 0)
            problem = f"cannot be written, perhaps no space is left ({error})"
            raise OSError(errno.EIO, problem, str(path)) from None


def append_checksum(path: str | Path) -> None:
    """Append the checksum of its bytes to a file."""
    digest = _hash_bytes(path, Path(path).stat().st_size)
    with open(path, "ab") as file:
        file.write(_CHECKSUM_MARK + digest)


def verify_checksum(path: str | Path) -> bool:
    """Return whether a file has a checksum of its bytes, which is then right.

    Raises
    ------
    DamagedFileError
        If the checksum is wrong, or the file has not the length that it states.
    OSError
        If the file cannot be opened.
    """
    with open(path, "rb") as file:
        start = file.read(_CHECKSUM_BYTES)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _CHECKSUM_BYTES, 0))
        end = file.read()
    if end.startswith(_CHECKSUM_MARK):
        if end != _CHECKSUM_MARK + _hash_bytes(path, size - _CHECKSUM_BYTES):
            raise DamagedFileError(path, "the checksum of its bytes differs")
        return True
    if not size:
        raise DamagedFileError(path, "the file is empty")
    # The HDF5 superblock (versions 2 and 3) holds the length of the file.
    if start.startswith(_HDF5_SIGNATURE) and start[8:9] in (b"\2", b"\3"):
        expected_size = int.from_bytes(start[28:36], "little")
        if expected_size != size:
            raise DamagedFileError(path, f"{size} bytes instead of {expected_size}")
    return False


def _hash_bytes(path: str | Path, n_bytes: int) -> bytes:
    """Return the SHA-256 (hexadecimal) of the first bytes of a file, read in chunks."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while n_bytes > 0 and (chunk := file.read(min(n_bytes, _CHUNK_BYTES))):
            digest.update(chunk)
            n_bytes -= len(chunk)
    return digest.hexdigest().encode()


def exit_if_damaged(paths: Iterable[str]) -> None:
    """End a job with one line if a dataset among its input files is damaged.

    The workflow makes a removed file again.
    """
    for path in paths:
        if path.endswith(NETCDF_SUFFIXES):
            try:
                _read_file(path, lazy=True)
            except DamagedFileError as error:
                command = shlex.join(["rm", path])
                sys.exit(f"{path}: damaged, {error.args[1]} (type: {command}, and run again)")


def encode_for_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset encoded for a netCDF file."""
    levels = {
        str(dimension): list(index.names)
        for dimension in dataset.dims
        if isinstance(index := dataset.get_index(dimension), pd.MultiIndex)
    }
    dataset = dataset.reset_index(list(levels))
    auxiliary_names, reserved = {}, set()
    for dimension in map(str, dataset.dims):
        if dimension not in dataset.coords:
            # Another variable of such a name would be decoded as its coordinate.
            reserved |= {
                _to_identifier(dimension) + suffix for suffix in (LABEL_SUFFIX, VALUE_SUFFIX)
            }
            continue
        coordinate_variable = dataset[dimension]
        index = coordinate_variable.to_index()
        text = coordinate_variable.dtype.kind in "OUS"
        ordered = index.is_monotonic_increasing or index.is_monotonic_decreasing
        if text or not (ordered and index.is_unique):
            auxiliary_names[dimension] = _to_identifier(dimension) + (
                LABEL_SUFFIX if text else VALUE_SUFFIX
            )
            reserved.add(auxiliary_names[dimension])
    names = {}
    for own in sorted(map(str, {*dataset.variables, *dataset.dims})):
        name = _to_identifier(own)
        while name in reserved:
            name += "_"
        reserved.add(name)
        names[own] = name
    encoded = dataset.rename({own: name for own, name in names.items() if own != name})
    for own, auxiliary in auxiliary_names.items():
        coordinate_variable = encoded[names[own]]
        coordinate = (names[own], coordinate_variable.values, coordinate_variable.attrs)
        encoded = encoded.drop_vars(names[own]).assign_coords({auxiliary: coordinate})
    dotted = [own for own, name in names.items() if own != name == own.replace(".", "_")]
    renamed = {name: own for own, name in names.items() if own != name and own not in dotted}
    encoding_attrs = {
        DOTTED_NAMES_ATTRIBUTE: " ".join(dotted),
        RENAMED_NAMES_ATTRIBUTE: renamed,
        INDEX_LEVELS_ATTRIBUTE: levels,
    }
    for key, value in encoding_attrs.items():
        if value:
            encoded.attrs[key] = value if isinstance(value, str) else json.dumps(value)
    return encoded


def decode_from_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset decoded from a netCDF file; the inverse of `encode_for_netcdf`."""
    for dimension in {str(d) for d in dataset.dims if d not in dataset.coords}:
        for name in (dimension + LABEL_SUFFIX, dimension + VALUE_SUFFIX):
            if name in dataset.coords and dataset[name].dims == (dimension,):
                axis = (dimension, dataset[name].values, dataset[name].attrs)
                dataset = dataset.drop_vars(name).assign_coords({dimension: axis})
    original_names = {
        _to_identifier(name): name
        for name in str(dataset.attrs.pop(DOTTED_NAMES_ATTRIBUTE, "")).split()
    }
    original_names |= json.loads(dataset.attrs.pop(RENAMED_NAMES_ATTRIBUTE, "{}"))
    present = {*dataset.variables, *dataset.dims}
    dataset = dataset.rename(
        {name: original for name, original in original_names.items() if name in present}
    )
    return dataset.set_index(json.loads(dataset.attrs.pop(INDEX_LEVELS_ATTRIBUTE, "{}")))


def _to_identifier(name: str) -> str:
    """Return a name with all characters but letters and digits replaced by underscores."""
    return re.sub(r"\W", "_", name)
