"""Labelled results: CF attributes, provenance, netCDF in and out.

The layout of datasets in files has a number, and only files of the present number are read.

The number goes up when variables, dimensions or attributes get another name or meaning; a new
variable alone is no reason.
"""

from __future__ import annotations

import platform
import warnings
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.paths import expand_path
from splits.core.provenance import get_git_commit, get_package_version
from splits.core.validation import (
    check_choice,
    check_number,
    invalid,
    join_names,
    reject_unknown_arguments,
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
"""Attribute that holds the number; files from before there was one are of schema 0."""
SCHEMA_VERSION = 2


def check_schema(dataset: xr.Dataset, path: str | Path) -> None:
    """Refuse a dataset in another layout than that of this version.

    Parameters
    ----------
    dataset : xarray.Dataset
        As it was read.
    path : path
        Of the file, for messages.

    Raises
    ------
    ValueError
        If the number is none, or an older or newer version of this package wrote the file.
    """
    found = dataset.attrs.get(SCHEMA_ATTRIBUTE, 0)
    if not isinstance(found, (int, np.integer)) or found < 0:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {found!r}: must be a whole number, 0 or more"
        )
    by = dataset.attrs.get("splits_version", "unknown")
    if found > SCHEMA_VERSION:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {int(found)}: must be at most {SCHEMA_VERSION}; a newer "
            f"version of the package wrote it ({by}): pip install --upgrade splits-optics"
        )
    if found < SCHEMA_VERSION:
        raise ValueError(
            f"{path}: {SCHEMA_ATTRIBUTE} = {int(found)}: must be {SCHEMA_VERSION}; an older "
            f"version of the package wrote it ({by}): run the experiment again, or read it with "
            "that version"
        )


CF_CONVENTIONS = "CF-1.11"
RUN_SPECIFIC_ATTRIBUTES = ("date_created", "history", "wall_time_s", "threads", "host_cpu")
"""Attributes that differ between runs of one and the same simulation."""
NETCDF_SUFFIXES = (".nc", ".nc4", ".netcdf")
"""What names of datasets end in."""
ANCILLARY_ATTRIBUTE = "ancillary_variables"
"""Attribute of a variable: names of those that say more of its values, such as errors and flags."""


def make_provenance(action: str = "dataset made") -> dict[str, Any]:
    """Return the attributes that say which program made a dataset, when and where.

    Parameters
    ----------
    action : str
        What the program did, for the attribute ``history``: "experiment fig08_grain_size".
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
    """Return `values` as netCDF attributes: numbers, strings and flat lists of numbers."""

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
    """Return a copy without the attributes that name the occasion of a run (see `RUN_SPECIFIC_ATTRIBUTES`)."""
    copy = dataset.copy()
    copy.attrs = {k: v for k, v in dataset.attrs.items() if k not in RUN_SPECIFIC_ATTRIBUTES}
    return copy


@reject_unknown_arguments
def save(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset to netCDF so that the file appears whole or not at all.

    Every array has checksums of its own (fletcher32), and the whole file has those of
    `splits.io.integrity`, which `load` checks.  Coordinates whose values are texts, or numbers in
    no order, are auxiliary coordinates in the file, ``medium_label(medium)`` and
    ``depth_m_value(depth_m)``, as the CF conventions (section 5) want them; `load` makes them
    coordinates of their dimension again.  Names have letters, digits and underscores in the file
    (section 2.3): ``layers.0.depth_m`` is ``layers_0_depth_m`` there, and `load` gives it its own
    name again.  A dataset without provenance, such as a part of another one, gets that of the file.

    Parameters
    ----------
    dataset : xarray.Dataset
        What a function of this package returns, or what was made from that.  Values are finite,
        or NaN where a variable of flags that ``ancillary_variables`` names is not 0.
    path : path
        Its suffix is one of `NETCDF_SUFFIXES`.

    Raises
    ------
    ValueError
        For something else than a dataset, a value that is not finite, or another suffix.
    OSError
        If the file cannot be written, or does not hold the dataset afterwards.
    """
    path = expand_path(path)
    if path.suffix not in NETCDF_SUFFIXES:
        hint = "this writes netCDF; tables come from dataset.to_dataframe().to_csv(…)"
        raise invalid("path", str(path), "a name that ends in " + ", ".join(NETCDF_SUFFIXES), hint)
    dataset = _check_dataset(dataset, path.name)
    stored = encode_for_netcdf(dataset)
    stored.attrs = {**make_provenance("dataset saved"), **stored.attrs}
    # HDF5 has checksums for arrays of numbers only.
    encoding = {
        name: {
            "_FillValue": np.nan if v.dtype.kind == "f" and v.isnull().any() else None,
            "fletcher32": bool(v.size and v.ndim and v.dtype.kind in "biuf"),
        }
        for name, v in stored.variables.items()
    }
    with atomic_netcdf(path, stored.nbytes) as aside:
        stored.to_netcdf(aside, engine="netcdf4", encoding=encoding)
        write_checksums(aside)
        if not _read_file(aside).equals(dataset):
            raise OSError(f"{path}: the file written does not hold the dataset")


def _check_dataset(dataset: Any, name: str) -> xr.Dataset:
    """Return a dataset in memory, or refuse what a file cannot hold or nobody could read in it."""
    if not isinstance(dataset, xr.Dataset):
        hint = "write its dataset: save(….dataset, path)" if hasattr(dataset, "dataset") else ""
        if isinstance(dataset, xr.DataArray):
            hint = f"write array.to_dataset(name={str(dataset.name or 'reflectance')!r})"
        raise invalid("dataset", type(dataset).__name__, "an xarray.Dataset", hint)
    # What is not computed yet would be at every look.
    dataset = dataset.compute()
    for key, variable in dataset.data_vars.items():
        if not np.issubdtype(variable.dtype, np.number):
            continue
        bad = ~np.isfinite(variable)
        for beside in str(variable.attrs.get(ANCILLARY_ATTRIBUTE, "")).split():
            if beside in dataset and "flag_meanings" in dataset[beside].attrs:
                bad &= ~((dataset[beside] != 0) & np.isnan(variable))
        if bad.any():
            raise ValueError(f"{name}: {key} holds values that are not finite")
    return dataset


@reject_unknown_arguments
def load(path: str | Path) -> xr.Dataset:
    """Read a dataset into memory and check that this package wrote it and that it is undamaged.

    A dataset in the layout of an older version is refused (see `splits.io.netcdf`).  One without
    checksum is read with a warning.

    Raises
    ------
    splits.io.integrity.DamagedFileError
        A ValueError: if the file cannot be read, or holds something else than was written.
    ValueError
        If the file has no provenance of this package, or another version wrote it in another
        layout.
    OSError
        If the file cannot be opened.
    """
    return _check_origin(_read_file(path), path)


def open_lazily(path: str | Path) -> xr.Dataset:
    """Return what `load` would, whose values stay in the file until they are asked for.

    For what does not fit into memory.  The file is checked whole when it is opened.
    """
    return _check_origin(_read_file(path, lazy=True), path)


def _check_origin(dataset: xr.Dataset, path: str | Path) -> xr.Dataset:
    """Return a dataset of the present schema, or refuse one that this package has not written."""
    if "splits_version" not in dataset.attrs:
        raise ValueError(f"{path}: not a dataset written by splits")
    check_schema(dataset, path)
    if CHECKSUM_ATTRIBUTE not in dataset.attrs:
        older = "an older version or another program wrote it"
        warnings.warn(f"{path}: has no checksum, damage would go unseen ({older})", stacklevel=2)
    dataset.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    return dataset


def _read_file(path: str | Path, *, lazy: bool = False) -> xr.Dataset:
    """Return what a file holds, its checksum included, with coordinates that label dimensions."""
    path = expand_path(path)
    with NETCDF_LOCK:
        verify_checksums(path)
        dataset = xr.open_dataset(path, engine="netcdf4")
        if not lazy:
            with dataset as file:
                dataset = file.load()
    for variable in dataset.variables.values():
        # Or it would be written again, whatever coordinates there are by then.
        variable.encoding.pop("coordinates", None)
    return decode_from_netcdf(dataset)


def select_points(dataset: xr.Dataset, coordinates: Mapping[str, float | str]) -> xr.Dataset:
    """Return the part of a dataset at coordinates of its grid.

    Parameters
    ----------
    dataset : xarray.Dataset
    coordinates : mapping
        From dimensions to coordinates: numbers, up to rounding, or labels.

    Raises
    ------
    ValueError
        For a dimension or a coordinate that the dataset does not have.
    """
    for dimension, given in coordinates.items():
        check_choice("at", dimension, map(str, dataset.dims))
        values = dataset[dimension].values
        if np.issubdtype(values.dtype, np.number):
            wanted = check_number(f"at.{dimension}", given)
            place = int(np.abs(values - wanted).argmin())
            found = bool(np.isclose(values[place], wanted, rtol=1e-12, atol=0.0))
        else:
            place = int((values == str(given)).argmax())
            found = bool(values[place] == str(given))
        if not found:
            raise invalid(f"at.{dimension}", given, "one of " + join_names(values.tolist()))
        dataset = dataset.isel({dimension: place}, drop=True)
    return dataset
