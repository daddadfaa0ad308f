"""The layout of datasets in files has a number, and files of every older number can be read.

The number goes up when variables, dimensions or attributes get another name or meaning; a new
variable alone is no reason.  Whoever raises `VERSION` adds to `READERS` what turns the layout
before into the new one, and keeps a file of the layout before among the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

SCHEMA = "splits_schema"
"""Attribute that holds the number; files from before there was one are of schema 0."""
VERSION = 1


def _numbered(dataset: xr.Dataset) -> xr.Dataset:
    """Give a file of schema 0 its number: nothing else has changed."""
    return dataset


READERS: Mapping[int, Callable[[xr.Dataset], xr.Dataset]] = {0: _numbered}
"""From an older schema: what turns its datasets into those of the next."""


def upgraded(dataset: xr.Dataset, path: str | Path) -> xr.Dataset:
    """Return a dataset in the layout of this version.

    Parameters
    ----------
    dataset : xarray.Dataset
        As it was read.
    path : path
        Of the file, for messages.

    Raises
    ------
    ValueError
        If the number is none, or a newer version of this package wrote the file.
    """
    found = dataset.attrs.get(SCHEMA, 0)
    if not isinstance(found, (int, np.integer)) or found < 0:
        raise ValueError(f"{path}: {SCHEMA} = {found!r}: must be a whole number, 0 or more")
    if found > VERSION:
        by = dataset.attrs.get("splits_version", "unknown")
        raise ValueError(
            f"{path}: {SCHEMA} = {int(found)}: must be at most {VERSION}; a newer version of the "
            f"package wrote it ({by}): pip install --upgrade splits-optics"
        )
    for number in range(int(found), VERSION):
        dataset = READERS[number](dataset)
    return dataset.assign_attrs({SCHEMA: VERSION})
