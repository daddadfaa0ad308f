"""Snowpacks from a file of any supported format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from splits.core.paths import expand_path
from splits.core.validation import invalid
from splits.io.crocus import THICKNESS
from splits.io.netcdf import NETCDF_SUFFIXES, SCHEMA_ATTRIBUTE, load
from splits.media.snow_pack_input import DEFAULT_LABEL
from splits.media.snow_pack_readers import read_caaml, read_crocus
from splits.media.snow_packs import SnowPacks

CAAML_SUFFIXES = (".caaml", ".xml")
PACK_SUFFIXES = (".csv", *NETCDF_SUFFIXES, *CAAML_SUFFIXES)
"""Suffixes of files of snowpacks."""


def read_snow_packs(
    file: str | Sequence[str], ground: Any = None, point: int | None = None
) -> SnowPacks:
    """Read snowpacks from a file.

    Parameters
    ----------
    file : str or sequence of str
        A CSV file with the columns of `splits.SnowPacks`, of which ``time`` holds dates; a netCDF
        file of such a dataset, or of the model Crocus (`splits.read_crocus`); or one or several
        CAAML files (`splits.read_caaml`).
    ground : number, str, mapping or path, optional
        Ground below all snowpacks, as for `splits.SnowPacks`, in place of that of the file.
    point : int, optional
        Position along the points of Crocus.

    Raises
    ------
    ValueError
        For a missing file, an unknown suffix, and invalid content.
    """
    files = [expand_path(one, "file") for one in ([file] if isinstance(file, str) else file)]
    suffixes = {one.suffix.lower() for one in files}
    are_caaml = suffixes <= {*CAAML_SUFFIXES}
    if not suffixes <= {*PACK_SUFFIXES} or (len(files) != 1 and not are_caaml) or not files:
        raise invalid("file", file, f"a file with one of {', '.join(PACK_SUFFIXES)}")
    for one in files:
        if not one.is_file():
            raise invalid("file", str(one), "a file that exists", f"looked in {Path.cwd()}")
    if are_caaml:
        packs = read_caaml(files)
    else:
        packs = _read_csv(files[0]) if suffixes == {".csv"} else _read_netcdf(files[0], point)
    return packs if ground is None else packs.with_ground(ground)


def _read_csv(path: Path) -> SnowPacks:
    table = pd.read_csv(path)
    if DEFAULT_LABEL in table:
        table[DEFAULT_LABEL] = pd.to_datetime(table[DEFAULT_LABEL])
    return SnowPacks(table)


def _read_netcdf(path: Path, point: int | None) -> SnowPacks:
    with xr.open_dataset(path) as dataset:
        is_crocus, is_own = THICKNESS in dataset, SCHEMA_ATTRIBUTE in dataset.attrs
    if is_crocus:
        return read_crocus(path, point=point)
    return SnowPacks(load(path) if is_own else xr.load_dataset(path))
