"""Snowpacks in the output of the snow model Crocus in SURFEX (PRO files, netCDF).

Names and units are those of the documentation of snowtools (UMR-CNRM/snowtools,
doc/source/surfex/surfex.rst, "Available diagnostics", and surfex-crocus-user-doc.rst) and of the
routine WRITE_DIAG_MISC_ISBA_n of SURFEX 8; see also Vionnet et al. (2012), Geosci. Model Dev. 5,
773–791, and for impurities Tuzet et al. (2017), The Cryosphere 11, 2633–2653.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from splits.core.arrays import as_float_array
from splits.core.labels import check_direction, convert_units, is_unit
from splits.core.validation import (
    check_choice,
    check_integer,
    check_relations,
    expand_path,
    invalid,
)
from splits.io.netcdf import open_foreign

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
WATER_DENSITY_KG_M3 = 1000.0
MELTING_EXCESS_C = 0.011
"""Excess of the melting point of SURFEX, 273.16 K, above 0 °C, with rounding of floats."""
_UNIT_PATTERN = re.compile(r"\(([^()]+)\)\s*$")


def read_crocus_output(
    source: str | Path | xr.Dataset,
    point: int | None = None,
    patch: int | None = None,
    impurities: Mapping[str, str] | None = None,
) -> xr.Dataset:
    """Return the variables of `splits.SnowPacks`; see `splits.read_crocus`."""
    if isinstance(source, xr.Dataset):
        return _convert_output(_select(source, point, patch, impurities), impurities)
    path = expand_path(source, "source")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with open_foreign("source", path) as file:
        selected = _select(file, point, patch, impurities).load()
    return _convert_output(selected, impurities)


def _select(
    dataset: xr.Dataset, point: int | None, patch: int | None, impurities: Mapping[str, str] | None
) -> xr.Dataset:
    """Return the variables needed, over time and layer, or over snowpack and layer."""
    density = next((name for name in DENSITIES if name in dataset), DENSITIES[0])
    names, allowed = [THICKNESS, density, SURFACE_AREA, WATER], "a variable of the output of Crocus"
    hint = "add it to CSELECT of the namelist of SURFEX, with LSNOWDIMNC = T"
    check_relations(*((name in dataset, name, None, allowed, hint) for name in names))
    names += list_impurity_names(dataset, impurities)
    names += [TEMPERATURE] if TEMPERATURE in dataset else []
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
        selected = _select_index(selected, key, index, among)
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


def _select_index(dataset: xr.Dataset, key: str, index: int | None, dims: list[str]) -> xr.Dataset:
    """Return a dataset at an index along the only one of some dimensions, without those of size 1.

    Several dimensions, such as those of a grid, have no common index.
    """
    if index is not None:
        if len(dims) != 1:
            hint = "select with source.isel first"
            raise invalid(key, index, f"left out for dimensions {tuple(dims)}", hint)
        check_integer(key, index, 0, dataset.sizes[dims[0]] - 1)
        return dataset.isel({dims[0]: index}, drop=True)
    return dataset.isel({dim: 0 for dim in dims if dataset.sizes[dim] == 1}, drop=True)


def list_impurity_names(dataset: xr.Dataset, impurities: Mapping[str, str] | None) -> list[str]:
    """Return the names of the variables of impurities to read."""
    if impurities is None:
        return [name for name in DEFAULT_IMPURITIES if name in dataset]
    if not isinstance(impurities, Mapping):
        allowed = "a mapping of variables to types, such as {'SNOWIMP1': 'black_carbon'}"
        raise invalid("impurities", impurities, allowed)
    known = [str(name) for name in dataset.data_vars if str(name).startswith("SNOWIMP")]
    if len(set(impurities.values())) < len(impurities):
        raise invalid("impurities", dict(impurities), "different types for different variables")
    return [check_choice("impurities", name, known) for name in impurities]


def _convert_output(output: xr.Dataset, impurities: Mapping[str, str] | None) -> xr.Dataset:
    """Return the output in the variables and units of `splits.SnowPacks`."""
    thickness = _read(output, THICKNESS, "m", "m")
    density = _read(output, DENSITIES[0], "kg m-3", "kg m-3")
    # Layers without thickness and mass are absent, whatever their other variables are.
    thickness = thickness.where(thickness.notnull() | (density > 0.0), 0.0)
    water = _read_water(output, thickness.where(thickness > 0.0))
    dry_density = density - WATER_DENSITY_KG_M3 * water
    variables = {
        "thickness_m": thickness,
        "density_kg_m3": dry_density,
        "specific_surface_area_m2_kg": _read(output, SURFACE_AREA, "m2 kg-1", "m2 kg-1"),
        "liquid_water_content": water,
    }
    if TEMPERATURE in output:
        temperature = _read(output, TEMPERATURE, "K", "degC")
        is_melting = (temperature > 0.0) & (temperature <= MELTING_EXCESS_C)
        variables["temperature_c"] = temperature.where(~is_melting, 0.0)
    types = DEFAULT_IMPURITIES if impurities is None else impurities
    for name in list_impurity_names(output, impurities):
        per_snow = _read(output, name, "g g-1", "1e-9")
        variables[f"impurities_ng_g.{types[name]}"] = per_snow * density / dry_density
    for variable in variables.values():
        variable.attrs.clear()
    dataset = xr.Dataset(variables)
    return dataset.drop_vars("layer", errors="ignore")


def _read_water(output: xr.Dataset, thickness: xr.DataArray) -> xr.DataArray:
    """Return the volume fraction of liquid water.

    SURFEX writes its mass per volume of snow (kg m-3) with LVOLUMETRIC_SNOWLIQ, otherwise the
    depth of the water in a layer (m).
    """
    unit = _find_unit(output[WATER])
    if unit is None:
        hint = "kg m-3 with LVOLUMETRIC_SNOWLIQ in SURFEX, otherwise m"
        raise invalid(f"{WATER}.units", None, "kg m-3 or m", hint)
    if is_unit(unit, "m"):
        return _read(output, WATER, unit, "m") / thickness
    return _read(output, WATER, unit, "kg m-3") / WATER_DENSITY_KG_M3


def _read(output: xr.Dataset, name: str, default_unit: str, unit: str) -> xr.DataArray:
    """Return a variable in a unit, with NaN for fill values."""
    numbers = as_float_array(name, output[name], allow_gaps=True)
    numbers[np.abs(numbers) >= MIN_FILL_VALUE] = np.nan
    given = _find_unit(output[name]) or default_unit
    return output[name].copy(data=convert_units(name, numbers, given, unit))


def _find_unit(variable: xr.DataArray) -> str | None:
    """Return the unit of a variable: its attribute, or that in parentheses after its description.

    Older versions of SURFEX write descriptions such as "snow temperature (K)".
    """
    unit = str(variable.attrs.get("units", "")).strip()
    if unit:
        return unit
    for attribute in ("long_name", "comment"):
        match = _UNIT_PATTERN.search(str(variable.attrs.get(attribute, "")))
        if match:
            return match[1]
    return None
