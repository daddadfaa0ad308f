"""Snowpacks from a file of any supported format."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import as_float_array
from splits.core.declarations import Quantity
from splits.core.keywords import declare_function
from splits.core.labels import check_direction, convert_units, is_unit
from splits.core.optional import import_optional
from splits.core.validation import (
    check_choice,
    check_integer,
    check_relations,
    expand_path,
    invalid,
    suggest_name,
)
from splits.io.caaml import WATER_DENSITY_KG_M3, read_snow_pit
from splits.io.netcdf import NETCDF_SUFFIXES, SCHEMA_ATTRIBUTE, load, open_foreign
from splits.materials.csv_table import read_csv
from splits.media.snow_pack_input import (
    DEFAULT_LABEL,
    GROUND_ATTRIBUTE,
    LAYER_DIM,
    LAYER_HINT,
    THICKNESS_KEY,
)
from splits.media.snow_packs import SnowPacks

# --------------------------------------------------------------------------------------------------
# Snow pits in CAAML files.

Extend = Annotated[
    bool,
    Quantity("whether layers above the first or below the last measurement take its value"),
]
PitLabel = Annotated[Literal["time", "file"], Quantity("label of a snow pit")]
Position = Annotated[int | None, Quantity("position along the points of the model Crocus", low=0)]
Latitude = Annotated[
    float | None, Quantity("latitude of the snowpacks", "degree", low=-90.0, high=90.0)
]
Longitude = Annotated[
    float | None, Quantity("longitude of the snowpacks", "degree", low=-180.0, high=180.0)
]


@declare_function
def read_caaml(
    path: str | Path | Sequence[str | Path],
    *,
    extend: Extend = True,
    label: PitLabel = "time",
) -> SnowPacks:
    """Read snow pits from CAAML files, version 6 of the snow profile of the IACS.

    The layers are those of the stratigraphy (``stratProfile``).  Density, specific surface area and
    liquid water content of a layer are the means of the measured intervals, weighted by the length
    of their overlap with the layer.  Points in a layer that lie in no interval share the part that
    no interval covers, with equal weights.  A layer without either takes the value by linear
    interpolation to its middle between the middles of the intervals.  Temperatures are interpolated
    in the same way.

    Parameters
    ----------
    path : path or sequence of paths
        One file for each snow pit.
    extend : bool
        Whether layers above the first or below the last measurement take its value.  Otherwise
        they have missing values.
    label : {"time", "file"}
        Whether the time (UTC) or the name of the file, which then needs no time, is the label of a
        snow pit.

    Returns
    -------
    SnowPacks
        Snow pits without specific surface area, as most in practice, have the flag missing_value.

    Raises
    ------
    ValueError
        For a file that is not CAAML version 6, has a document type, an unknown unit, negative or
        infinite numbers, layers that overlap, or no date or time of ISO 8601; and if two snow pits
        have the same label.

    Notes
    -----
    Densities are measured with the water.  Where the water content is measured, its mass is
    subtracted.  Without measurements, the water content is 0 and the temperature −1 °C.  A gap in
    the stratigraphy is a layer with missing values.  Without stratigraphy, layers are bounded by
    the limits of all measured intervals.  Hand tests of the wetness, impurities and grain sizes are
    not read, nor are the layers of soil of the model SNOWPACK.  A time without time zone is taken
    as UTC.  The unit of a number is that of its attribute ``uom``, or else that of an element
    around it, such as ``uomDepth``, or else that of the schema.
    """
    paths = [path] if isinstance(path, str | os.PathLike) else list(path)
    if not paths:
        raise invalid("path", [], "at least one file")
    has_times = label == DEFAULT_LABEL
    pits = [read_snow_pit(one, extend=extend, with_time=has_times) for one in paths]
    times, layers = zip(*pits, strict=True)
    n_layers = max(1, *(one[THICKNESS_KEY].size for one in layers))
    variables = {
        name: ((label, LAYER_DIM), [
            np.pad(one[name], (0, n_layers - one[name].size), constant_values=np.nan)
            for one in layers
        ])
        for name in layers[0]
    }  # fmt: skip
    labels = pd.DatetimeIndex(times) if has_times else [Path(one).name for one in paths]
    return SnowPacks(xr.Dataset(variables, {label: labels}))


# --------------------------------------------------------------------------------------------------
# Output of the snow model Crocus in SURFEX (PRO files, netCDF).
#
# Names and units are those of the documentation of snowtools (UMR-CNRM/snowtools,
# doc/source/surfex/surfex.rst, "Available diagnostics", and surfex-crocus-user-doc.rst) and of the
# routine WRITE_DIAG_MISC_ISBA_n of SURFEX 8; see also Vionnet et al. (2012), Geosci. Model Dev. 5,
# 773–791, and for impurities Tuzet et al. (2017), The Cryosphere 11, 2633–2653.

THICKNESS, WATER, TEMPERATURE, SURFACE_AREA = "SNOWDZ", "SNOWLIQ", "SNOWTEMP", "SNOWSSA"
DENSITIES = ("RSN_VEG", "SNOWRO")
"""Names of the density in different versions."""
DEFAULT_IMPURITIES = {"SNOWIMP1": "black_carbon", "SNOWIMP2": "dust_sahara"}
"""Types of the impurities of Crocus: soot and mineral dust."""
TIME_DIMS, LAYER_DIMS = ("time", "Time"), ("snow_layer", "layer")
PATCH_DIMS = ("Number_of_Patches", "Number_of_Tile", "Number_of_tile", "tile")
SNOWPACK = "snowpack"
"""Label of pairs of time and point."""
MIN_FILL_VALUE = 1e19
"""Numbers from here on are fill values; SURFEX writes 1e20."""
MELTING_EXCESS_C = 0.011
"""Excess of the melting point of SURFEX, 273.16 K, above 0 °C, with rounding of floats."""
_UNIT_PATTERN = re.compile(r"\(([^()]+)\)\s*$")


@declare_function
def read_crocus(
    source: str | Path | xr.Dataset,
    *,
    point: Position = None,
    patch: Position = None,
    impurities: Mapping[str, str] | None = None,
) -> SnowPacks:
    """Read snowpacks from the output of the snow model Crocus in SURFEX (PRO file).

    Parameters
    ----------
    source : path or xarray.Dataset
        Output with ``SNOWDZ``, ``RSN_VEG`` or ``SNOWRO``, ``SNOWSSA``, ``SNOWLIQ``, and optionally
        ``SNOWTEMP`` and ``SNOWIMP1``, …, over ``time``, ``snow_layer``, and points such as
        ``Number_of_points``.
    point : int, optional
        Position along the dimension of points.  By default all points are read; the label is then
        ``snowpack``, pairs of time and point, unless there is only one.
    patch : int, optional
        Position along ``Number_of_Patches`` or ``tile``, required if there are several.
    impurities : mapping, optional
        Type of impurity by variable, see `splits.materials.impurities`; by default
        ``{"SNOWIMP1": "black_carbon", "SNOWIMP2": "dust_sahara"}``, those of the file.  An empty
        mapping reads none.

    Returns
    -------
    SnowPacks

    Raises
    ------
    ValueError
        For missing variables, unknown units, and a point or patch that does not exist.
    FileNotFoundError
        If the file does not exist.

    Notes
    -----
    Units are those of the attribute ``units``, or those in parentheses at the end of ``long_name``
    or ``comment``; ``SNOWLIQ`` must have one, kg m-3 or m.  The density of Crocus includes the
    liquid water, which is subtracted.  Impurities per mass of snow become impurities per mass of
    ice.  The melting point of SURFEX, 273.16 K, is 0 °C.  Fill values (1e20) and thickness 0 denote
    absent layers.

    References
    ----------
    Documentation of snowtools, section "Available diagnostics"; Vionnet et al. (2012), Geosci.
    Model Dev. 5, 773–791.
    """
    if isinstance(source, xr.Dataset):
        return SnowPacks(_convert_output(source, point, patch, impurities))
    path = expand_path(source, "source")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with open_foreign("source", path) as file:
        return SnowPacks(_convert_output(file, point, patch, impurities))


def _convert_output(
    dataset: xr.Dataset, point: int | None, patch: int | None, impurities: Mapping[str, str] | None
) -> xr.Dataset:
    """Return output of Crocus in the variables and units of `splits.SnowPacks`."""
    types = _choose_impurities(dataset, impurities)
    output = _select(dataset, [*types], point, patch)
    thickness, density = _read(output, THICKNESS, "m"), _read(output, DENSITIES[0], "kg m-3")
    # Layers without thickness and mass are absent, whatever their other variables are.
    thickness = thickness.where(thickness.notnull() | (density > 0.0), 0.0)
    unit = _find_unit(output[WATER])
    if unit is None:
        hint = "kg m-3 with LVOLUMETRIC_SNOWLIQ in SURFEX, otherwise m"
        raise invalid(f"{WATER}.units", None, "kg m-3 or m", hint)
    # SURFEX writes the mass of water per volume of snow, or its depth in a layer.
    if is_unit(unit, "m"):
        water = _read(output, WATER, "m") / thickness.where(thickness > 0.0)
    else:
        water = _read(output, WATER, "kg m-3") / WATER_DENSITY_KG_M3
    dry_density = density - WATER_DENSITY_KG_M3 * water
    variables = {
        "thickness_m": thickness,
        "density_kg_m3": dry_density,
        "specific_surface_area_m2_kg": _read(output, SURFACE_AREA, "m2 kg-1"),
        "liquid_water_content": water,
    }
    if TEMPERATURE in output:
        temperature = _read(output, TEMPERATURE, "degC", default_unit="K")
        is_melting = (temperature > 0.0) & (temperature <= MELTING_EXCESS_C)
        variables["temperature_c"] = temperature.where(~is_melting, 0.0)
    for name, kind in types.items():
        per_snow = _read(output, name, "1e-9", default_unit="g g-1")
        variables[f"impurities_ng_g.{kind}"] = per_snow * density / dry_density
    for variable in variables.values():
        variable.attrs.clear()
    return xr.Dataset(variables).drop_vars("layer", errors="ignore")


def _choose_impurities(
    dataset: xr.Dataset, impurities: Mapping[str, str] | None
) -> Mapping[str, str]:
    """Return the types of the impurities to read, by variable."""
    if impurities is None:
        return {name: kind for name, kind in DEFAULT_IMPURITIES.items() if name in dataset}
    if not isinstance(impurities, Mapping):
        allowed = "a mapping of variables to types, such as {'SNOWIMP1': 'black_carbon'}"
        raise invalid("impurities", impurities, allowed)
    if len(set(impurities.values())) < len(impurities):
        raise invalid("impurities", dict(impurities), "different types for different variables")
    known = [str(name) for name in dataset.data_vars if str(name).startswith("SNOWIMP")]
    return {check_choice("impurities", name, known): kind for name, kind in impurities.items()}


def _select(
    dataset: xr.Dataset, impurities: list[str], point: int | None, patch: int | None
) -> xr.Dataset:
    """Return the variables needed, over time and layer, or over snowpack and layer."""
    density = next((name for name in DENSITIES if name in dataset), DENSITIES[0])
    names, allowed = [THICKNESS, density, SURFACE_AREA, WATER], "a variable of the output of Crocus"
    hint = "add it to CSELECT of the namelist of SURFEX, with LSNOWDIMNC = T"
    check_relations(*((name in dataset, name, None, allowed, hint) for name in names))
    names += [*impurities, *({TEMPERATURE} & {*dataset.variables})]
    selected = dataset[names].rename({density: DENSITIES[0]})
    dims = [str(dim) for dim in selected.dims]
    for new, known in (("time", TIME_DIMS), ("layer", LAYER_DIMS)):
        old = [dim for dim in dims if dim in known]
        if len(old) != 1:
            raise invalid(f"{THICKNESS} dimensions", tuple(dims), f"with one of {', '.join(known)}")
        if old != [new]:
            selected = selected.drop_vars(new, errors="ignore").rename({old[0]: new})
    if "layer" in selected.coords:
        check_direction(selected.layer, "down")
        as_float_array(str(old[0]), selected.layer, "numbers, the smallest at the top")
        selected = selected.sortby("layer")
    patches = [dim for dim in dims if dim in PATCH_DIMS]
    points = [dim for dim in dims if dim not in (*TIME_DIMS, *LAYER_DIMS, *PATCH_DIMS)]
    for key, index, among in (("patch", patch, patches), ("point", point, points)):
        # Several dimensions, such as those of a grid, have no common index.
        allowed, hint = f"left out for dimensions {tuple(among)}", "select with source.isel first"
        check_relations((index is None or len(among) == 1, key, index, allowed, hint))
        if index is not None:
            check_integer(key, index, 0, selected.sizes[among[0]] - 1)
        chosen = [dim for dim in among if index is not None or selected.sizes[dim] == 1]
        selected = selected.isel(dict.fromkeys(chosen, index or 0), drop=True)
    n_patches = math.prod(selected.sizes[dim] for dim in patches if dim in selected.dims)
    remaining = [dim for dim in points if dim in selected.dims]
    check_relations(
        (
            n_patches == 1, "patch", None, f"a whole number from 0 to {n_patches - 1}",
            "one of the patches",
        ),
        (
            SNOWPACK not in remaining, f"{THICKNESS} dimensions", tuple(dims),
            f"without {SNOWPACK}", "source.rename changes it",
        ),
    )  # fmt: skip
    for dim in remaining:
        if dim not in selected.coords:
            selected = selected.assign_coords({dim: np.arange(selected.sizes[dim])})
    return selected.stack({SNOWPACK: ("time", *remaining)}) if remaining else selected


def _read(
    output: xr.Dataset, name: str, unit: str, default_unit: str | None = None
) -> xr.DataArray:
    """Return a variable in a unit, by default that of the file, with NaN for fill values."""
    numbers = as_float_array(name, output[name], allow_gaps=True)
    numbers[np.abs(numbers) >= MIN_FILL_VALUE] = np.nan
    given = _find_unit(output[name]) or default_unit
    return output[name].copy(data=convert_units(name, numbers, given, unit))


def _find_unit(variable: xr.DataArray) -> str | None:
    """Return the unit of a variable: its attribute, or that in parentheses after its description.

    Older versions of SURFEX write descriptions such as "snow temperature (K)".
    """
    texts = (str(variable.attrs.get(name, "")) for name in ("long_name", "comment"))
    described = (match[1] for match in map(_UNIT_PATTERN.search, texts) if match)
    return str(variable.attrs.get("units", "")).strip() or next(described, None)


# --------------------------------------------------------------------------------------------------
# Snowpacks from a file of any supported format.

CAAML_SUFFIXES = (".caaml", ".xml")
SNOW_PACK_SUFFIXES = (".csv", *NETCDF_SUFFIXES, *CAAML_SUFFIXES)
"""Suffixes of files of snowpacks."""


@declare_function
def read_snow_packs(
    file: str | Path | Sequence[str | Path],
    *,
    ground: Any = None,
    point: Position = None,
    latitude_deg: Latitude = None,
    longitude_deg: Longitude = None,
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
    is_known = suffixes <= {*SNOW_PACK_SUFFIXES} and (len(files) == 1 or (files and are_caaml))
    check_relations(
        (is_known, "file", file, f"a file with one of {', '.join(SNOW_PACK_SUFFIXES)}"),
        *(
            (one.is_file(), "file", str(one), "a file that exists", f"looked in {Path.cwd()}")
            for one in files
        ),
    )
    is_crocus = False
    if are_caaml:
        packs = read_caaml(files)
        packs = packs if ground is None else packs.with_ground(ground)
    elif suffixes == {".csv"}:
        packs = SnowPacks(_read_csv(files[0]), ground=ground)
    else:
        data, is_crocus = _read_netcdf(files[0], point)
        packs = SnowPacks(data, ground=ground)
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    missing = [key for key, value in place.items() if value is None]
    check_relations(
        (
            point is None or is_crocus, "point", point, "left out",
            "only output of Crocus has points",
        ),
        (
            len(missing) != 1, "".join(missing[:1]), None, "given",
            "a place has a latitude and a longitude",
        ),
    )  # fmt: skip
    if missing:
        return packs
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
    return np.asarray(sun["apparent_zenith"])


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


def _read_netcdf(path: Path, point: int | None) -> tuple[xr.Dataset, bool]:
    """Return the variables of `splits.SnowPacks`, and whether the file is output of Crocus."""
    with open_foreign("file", path) as dataset:
        if THICKNESS in dataset:
            return _convert_output(dataset, point, None, None), True
        if SCHEMA_ATTRIBUTE not in dataset.attrs:
            return dataset.load(), False
    return load(path), False
