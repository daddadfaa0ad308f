"""Snowpacks from a file of any supported format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.optional import import_optional
from splits.core.paths import expand_path
from splits.core.validation import check_range, invalid, suggest_name
from splits.io.crocus import THICKNESS
from splits.io.netcdf import NETCDF_SUFFIXES, SCHEMA_ATTRIBUTE, load, open_foreign
from splits.materials.csv_table import read_csv
from splits.media.pack_ground import GROUND_ATTRIBUTE
from splits.media.snow_pack_input import DEFAULT_LABEL, LAYER_DIM, LAYER_HINT
from splits.media.snow_pack_readers import read_caaml, read_crocus
from splits.media.snow_packs import SnowPacks

CAAML_SUFFIXES = (".caaml", ".xml")
PACK_SUFFIXES = (".csv", *NETCDF_SUFFIXES, *CAAML_SUFFIXES)
"""Suffixes of files of snowpacks."""


@reject_unknown_arguments
def read_snow_packs(
    file: str | Path | Sequence[str | Path],
    ground: Any = None,
    point: int | None = None,
    latitude_deg: float | None = None,
    longitude_deg: float | None = None,
) -> SnowPacks:
    """Read snowpacks from a file.

    Parameters
    ----------
    file : path or sequence of paths
        A CSV file with the columns of `splits.SnowPacks`, of which ``time`` holds times of ISO
        8601, those without a zone in UTC; a netCDF file of such a dataset, or of the model Crocus
        (`splits.read_crocus`); or one or several CAAML files (`splits.read_caaml`).
    ground : number, str, mapping or path, optional
        Ground below all snowpacks, as for `splits.SnowPacks`, in place of that of the file.
    point : int, optional
        Position along the points of Crocus; left out for other files.
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
    given = [file] if isinstance(file, str) or not isinstance(file, Sequence) else file
    files = [expand_path(one, "file") for one in given]
    suffixes = {one.suffix.lower() for one in files}
    are_caaml = suffixes <= {*CAAML_SUFFIXES}
    if not suffixes <= {*PACK_SUFFIXES} or (len(files) != 1 and not are_caaml) or not files:
        raise invalid("file", file, f"a file with one of {', '.join(PACK_SUFFIXES)}")
    for one in files:
        if not one.is_file():
            raise invalid("file", str(one), "a file that exists", f"looked in {Path.cwd()}")
    is_crocus = suffixes <= {*NETCDF_SUFFIXES} and _has_crocus_output(files[0])
    if point is not None and not is_crocus:
        raise invalid("point", point, "left out", "only output of Crocus has points")
    if is_crocus or are_caaml:
        packs = read_caaml(files) if are_caaml else read_crocus(files[0], point=point)
        packs = packs if ground is None else packs.with_ground(ground)
    else:
        is_csv = suffixes == {".csv"}
        packs = SnowPacks(_read_csv(files[0]) if is_csv else _read_netcdf(files[0]), ground=ground)
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    if all(value is None for value in place.values()):
        return packs
    for (key, value), limit in zip(place.items(), (90.0, 180.0), strict=True):
        if value is None:
            raise invalid(key, None, "given", "a place has a latitude and a longitude")
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


def _read_csv(path: Path) -> pd.DataFrame:
    table = read_csv("file", path, [DEFAULT_LABEL, LAYER_DIM])
    if LAYER_DIM not in table.column_names:
        hint = suggest_name(LAYER_DIM, table.column_names) or LAYER_HINT
        raise table.invalid(f"no column {LAYER_DIM}; {hint}")
    columns: dict[str, Any] = {DEFAULT_LABEL: table.get_times(DEFAULT_LABEL)}
    columns[LAYER_DIM] = table.get_numbers(LAYER_DIM)
    for name in table.column_names:
        if name == GROUND_ATTRIBUTE:
            columns[name] = table.get_texts(name)
        elif name not in columns:
            columns[name] = table.get_numbers(name, allow_gaps=True)
    return pd.DataFrame(columns)


def _has_crocus_output(path: Path) -> bool:
    with open_foreign("file", path) as dataset:
        return THICKNESS in dataset


def _read_netcdf(path: Path) -> xr.Dataset:
    with open_foreign("file", path) as dataset:
        if SCHEMA_ATTRIBUTE not in dataset.attrs:
            return dataset.load()
    return load(path)
