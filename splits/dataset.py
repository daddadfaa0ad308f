"""Labelled results: CF attributes, provenance, netCDF in and out."""

from __future__ import annotations

import os
import platform
import subprocess
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.checks import listed, number, one_of, refuse
from splits.interrupts import half_written

CONVENTIONS = "CF-1.11"
VOLATILE = ("date_created", "wall_time_s", "threads", "host_cpu")
"""Attributes that differ between runs of one and the same simulation."""


def package_version() -> str:
    """Return the installed version of this package."""
    try:
        return version("splits")
    except PackageNotFoundError:
        return "unknown"


@cache
def commit() -> str:
    """Return the git commit of the source tree, "-dirty" if it has changes, or "unknown"."""

    def git(*arguments: str) -> str:
        folder = Path(__file__).parent
        result = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True
        )
        return result.stdout.strip()

    try:
        head = git("rev-parse", "HEAD")
        return head + ("-dirty" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def provenance() -> dict[str, Any]:
    """Return the attributes that say which program made a dataset, when and where."""
    return {
        "Conventions": CONVENTIONS,
        "source": f"splits {package_version()}",
        "splits_version": package_version(),
        "splits_commit": commit(),
        "python_version": platform.python_version(),
        "numpy_version": np.__version__,
        "date_created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def attributes(values: Mapping[str, Any]) -> dict[str, Any]:
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


def without_volatile(dataset: xr.Dataset) -> xr.Dataset:
    """Return a copy without the attributes that name the occasion of a run (see `VOLATILE`)."""
    copy = dataset.copy()
    copy.attrs = {k: v for k, v in dataset.attrs.items() if k not in VOLATILE}
    return copy


def save(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset to netCDF so that the file appears whole or not at all.

    Raises
    ------
    ValueError
        If a data variable holds a value that is not finite.
    """
    path = Path(path)
    for name, variable in dataset.data_vars.items():
        if np.issubdtype(variable.dtype, np.number) and not np.isfinite(variable).all():
            raise ValueError(f"{path.name}: {name} holds values that are not finite")
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}.nc")
    with half_written(aside):
        encoding = {name: {"_FillValue": None} for name in dataset.variables}
        dataset.to_netcdf(aside, engine="netcdf4", encoding=encoding)
        with xr.open_dataset(aside) as written:
            if set(written.variables) != set(dataset.variables):
                raise OSError(f"{path}: written file lacks variables")
        os.replace(aside, path)


def load(path: str | Path) -> xr.Dataset:
    """Read a dataset into memory and check that this package wrote it.

    Raises
    ------
    ValueError
        If the file has no provenance of this package.
    """
    with xr.open_dataset(path, engine="netcdf4") as file:
        dataset = file.load()
    if "splits_version" not in dataset.attrs:
        raise ValueError(f"{path}: not a dataset written by splits")
    return dataset


def at_points(dataset: xr.Dataset, at: Mapping[str, float | str]) -> xr.Dataset:
    """Return the part of a dataset at coordinates of its grid.

    Parameters
    ----------
    dataset : xarray.Dataset
    at : mapping
        From dimensions to coordinates: numbers, up to rounding, or labels.

    Raises
    ------
    ValueError
        For a dimension or a coordinate that the dataset does not have.
    """
    for dimension, given in at.items():
        one_of("at", dimension, map(str, dataset.dims))
        values = dataset[dimension].values
        if np.issubdtype(values.dtype, np.number):
            wanted = number(f"at.{dimension}", given)
            place = int(np.abs(values - wanted).argmin())
            found = bool(np.isclose(values[place], wanted, rtol=1e-12, atol=0.0))
        else:
            place = int((values == str(given)).argmax())
            found = bool(values[place] == str(given))
        if not found:
            raise refuse(f"at.{dimension}", given, "one of " + listed(values.tolist()))
        dataset = dataset.isel({dimension: place}, drop=True)
    return dataset
