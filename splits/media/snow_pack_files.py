"""Snowpacks from a file of any supported format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.optional import import_optional
from splits.core.paths import expand_path
from splits.core.validation import check_range, invalid
from splits.io.crocus import THICKNESS
from splits.io.netcdf import NETCDF_SUFFIXES, SCHEMA_ATTRIBUTE, load
from splits.media.snow_pack_input import DEFAULT_LABEL
from splits.media.snow_pack_readers import read_caaml, read_crocus
from splits.media.snow_packs import SnowPacks

CAAML_SUFFIXES = (".caaml", ".xml")
PACK_SUFFIXES = (".csv", *NETCDF_SUFFIXES, *CAAML_SUFFIXES)
"""Suffixes of files of snowpacks."""


def read_snow_packs(
    file: str | Sequence[str],
    ground: Any = None,
    point: int | None = None,
    latitude_deg: float | None = None,
    longitude_deg: float | None = None,
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
    latitude_deg, longitude_deg : float, optional
        Place of the snowpacks (degrees, north and east are positive).  The zenith angles of the sun
        are then those at the times of the snowpacks (UTC), in place of those of the file.

    Raises
    ------
    ValueError
        For a missing file, an unknown suffix, invalid content, and a place without times.
    ModuleNotFoundError
        Without pvlib for a place.
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
    packs = packs if ground is None else packs.with_ground(ground)
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    if all(value is None for value in place.values()):
        return packs
    for (key, value), limit in zip(place.items(), (90.0, 180.0), strict=True):
        place[key] = check_range(key, value, -limit, limit, "degrees")
    return packs.with_sun_zenith(_compute_sun_zenith(packs, *place.values()))


def _compute_sun_zenith(packs: SnowPacks, latitude_deg: Any, longitude_deg: Any) -> np.ndarray:
    """Return the zenith angle of the sun (degrees) at the time of each snowpack, with refraction.

    By the algorithm of Reda & Andreas (2004), Solar Energy 76, 577-589.
    """
    labels = packs.dataset.get_index(packs.label)
    if DEFAULT_LABEL in labels.names:
        labels = labels.get_level_values(DEFAULT_LABEL)
    if not isinstance(labels, pd.DatetimeIndex):
        hint = f"their labels are {packs.label}"
        raise invalid("latitude_deg", latitude_deg, "left out for snowpacks without times", hint)
    positions = import_optional("pvlib.solarposition", "sky", "positions of the sun need")
    sun = positions.get_solarposition(labels.tz_localize("UTC"), latitude_deg, longitude_deg)
    zenith: np.ndarray = sun["apparent_zenith"].to_numpy()
    return zenith


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
