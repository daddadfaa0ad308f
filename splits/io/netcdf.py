"""Datasets in netCDF files: CF attributes, provenance, schema versions, reading and writing.

Datasets in files have a schema version, and only files of the current version are read.
The version increases when variables, dimensions or attributes change their name or meaning, but not
for a new variable.
"""

from __future__ import annotations

import platform
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.paths import expand_path
from splits.core.provenance import get_git_commit, get_package_version
from splits.core.validation import (
    InvalidValue,
    check_choice,
    check_number,
    invalid,
    join_names,
)
from splits.io.cf_encoding import decode_from_netcdf, encode_for_netcdf
from splits.io.integrity import (
    CHECKSUM_ATTRIBUTE,
    NETCDF_LOCK,
    atomic_netcdf,
    verify_checksums,
    write_checksums,
)

SCHEMA_ATTRIBUTE = "splits_schema"
"""Attribute of the schema version; files without it are of version 0."""
SCHEMA_VERSION = 2


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


CF_CONVENTIONS = "CF-1.11"
RUN_SPECIFIC_ATTRIBUTES = ("date_created", "history", "wall_time_s", "threads", "host_cpu")
"""Attributes that differ between runs of the same simulation."""
NETCDF_SUFFIXES = (".nc", ".nc4", ".netcdf")
"""Suffixes of netCDF files."""
ANCILLARY_ATTRIBUTE = "ancillary_variables"
"""CF attribute that names the variables of errors and flags of a variable."""


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


def drop_run_specific_attributes(dataset: xr.Dataset) -> xr.Dataset:
    """Return a copy of a dataset without `RUN_SPECIFIC_ATTRIBUTES`."""
    copy = dataset.copy()
    copy.attrs = {k: v for k, v in dataset.attrs.items() if k not in RUN_SPECIFIC_ATTRIBUTES}
    return copy


@reject_unknown_arguments
def save(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset to a netCDF file atomically.

    Every array has a checksum (fletcher32), and the file has those of `splits.io.integrity`, which
    `load` verifies.  Coordinates of text or of unordered numbers are auxiliary coordinates in the
    file, ``medium_label(medium)`` and ``depth_m_value(depth_m)``, as the CF conventions (section 5)
    require; `load` restores them as coordinates of their dimension.  Names in the file consist of
    letters, digits and underscores (section 2.3): ``layers.0.depth_m`` is ``layers_0_depth_m``
    there, and `load` restores the name.  A dataset without provenance, such as a part of another
    one, gets new provenance attributes.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset returned by this package or derived from one.  Values are finite, or NaN where a
        flag variable named in ``ancillary_variables`` is not 0.
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
    dataset = _check_dataset(dataset, path.name)
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
        write_checksums(temporary)
        if not _read_file(temporary).equals(dataset):
            raise OSError(f"{path}: the file written does not hold the dataset")


def _check_dataset(dataset: Any, name: str) -> xr.Dataset:
    """Return a dataset in memory after checking its type and values."""
    if not isinstance(dataset, xr.Dataset):
        hint = "write its dataset: save(….dataset, path)" if hasattr(dataset, "dataset") else ""
        if isinstance(dataset, xr.DataArray):
            hint = f"write array.to_dataset(name={str(dataset.name or 'reflectance')!r})"
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
            raise ValueError(f"{name}: {key} holds values that are not finite")
    return dataset


@reject_unknown_arguments
def load(path: str | Path) -> xr.Dataset:
    """Read a dataset into memory, and verify its origin and its checksums.

    A file of another schema version raises an error.  A file that another program wrote or changed
    gives a warning, because damage of it cannot be detected.

    Raises
    ------
    splits.io.integrity.DamagedFileError
        A ValueError: if the file cannot be read, or its bytes differ from what was written.
    ValueError
        If the file has no provenance of this package, or another schema version.
    OSError
        If the file cannot be opened.
    """
    return _check_origin(_read_file(path), path)


def open_lazily(path: str | Path) -> xr.Dataset:
    """Open a dataset as `load` does, with values read from the file on access.

    For datasets larger than memory.  Checksums of the whole file are verified on opening.
    """
    return _check_origin(_read_file(path, lazy=True), path)


def _check_origin(dataset: xr.Dataset, path: str | Path) -> xr.Dataset:
    """Return a dataset after checking that this version of the package can have written it."""
    if "splits_version" not in dataset.attrs:
        raise ValueError(f"{path}: not a dataset written by splits")
    check_schema(dataset, path)
    if CHECKSUM_ATTRIBUTE not in dataset.attrs:
        reason = "another program wrote or changed it"
        warnings.warn(
            f"{path}: has no valid checksum, so damage cannot be detected ({reason})", stacklevel=2
        )
    dataset.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    return dataset


def _read_file(path: str | Path, *, lazy: bool = False) -> xr.Dataset:
    """Return the dataset in a file with its coordinates restored, and its checksum if valid."""
    path = expand_path(path)
    with NETCDF_LOCK:
        attributes = verify_checksums(path)
        try:
            dataset = xr.open_dataset(path, engine="netcdf4")
            if not lazy:
                with dataset as file:
                    dataset = file.load()
        except (ValueError, OverflowError) as error:
            raise _make_read_error("path", path, error) from None
    for variable in dataset.variables.values():
        # Otherwise a later write would repeat it, even after coordinates have changed.
        variable.encoding.pop("coordinates", None)
    if CHECKSUM_ATTRIBUTE not in attributes:
        dataset.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    return decode_from_netcdf(dataset)


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
            raise _make_read_error(key, path, error) from None


def _make_read_error(key: str, path: Path, error: Exception) -> InvalidValue:
    """Return the error for a file that a library cannot read."""
    text = " ".join(str(error).replace(f": {str(path.absolute())!r}", "").split())
    return invalid(key, str(path), "a netCDF file that can be read", text)


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
