"""Readers of snowpacks: snow pits in CAAML files, and output of the model Crocus."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.validation import invalid
from splits.io.caaml import SnowPit, read_snow_pit
from splits.io.crocus import WATER_DENSITY_KG_M3, read_crocus_output
from splits.io.layer_profiles import average_over_layers, interpolate_to_layers
from splits.media.measured_inputs import SURFACE_AREA_KEY
from splits.media.snow_pack_input import (
    DEFAULT_LABEL,
    DEFAULTS,
    DENSITY_KEY,
    LAYER_DIM,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
)
from splits.media.snow_packs import SnowPacks


@reject_unknown_arguments
def read_caaml(
    path: str | Path | Sequence[str | Path], *, extend: bool = True, label: str = DEFAULT_LABEL
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
    if label not in (DEFAULT_LABEL, "file"):
        raise invalid("label", label, f"{DEFAULT_LABEL} or file")
    pits = [read_snow_pit(one, with_time=label == DEFAULT_LABEL) for one in paths]
    columns = [_assign_to_layers(pit, extend) for pit in pits]
    n_layers = max(1, *(pit.top_m.size for pit in pits))
    variables = {}
    for name in columns[0]:
        table = np.full((len(pits), n_layers), np.nan)
        for row, column in zip(table, columns, strict=True):
            row[: column[name].size] = column[name]
        variables[name] = ((label, LAYER_DIM), table)
    labels = pd.Index([Path(one).name for one in paths])
    if label == DEFAULT_LABEL:
        labels = pd.DatetimeIndex([pit.time for pit in pits])
    return SnowPacks(xr.Dataset(variables, {label: labels}))


def _assign_to_layers(pit: SnowPit, extend: bool) -> dict[str, np.ndarray]:
    """Return the variables of the layers of a snow pit."""
    values = {THICKNESS_KEY: pit.thickness_m}
    for name in (DENSITY_KEY, SURFACE_AREA_KEY, TEMPERATURE_KEY, WATER_KEY):
        assign = interpolate_to_layers if name == TEMPERATURE_KEY else average_over_layers
        if name in pit.profiles:
            profile = pit.profiles[name]
            values[name] = assign(profile, pit.top_m, pit.thickness_m, extend=extend)
        else:
            values[name] = np.full(pit.top_m.shape, DEFAULTS.get(name, np.nan))
    values[DENSITY_KEY] = values[DENSITY_KEY] - WATER_DENSITY_KG_M3 * values[WATER_KEY]
    for name in (DENSITY_KEY, SURFACE_AREA_KEY):
        values[name] = np.where(pit.is_gap, np.nan, values[name])
    return values


@reject_unknown_arguments
def read_crocus(
    source: str | Path | xr.Dataset,
    *,
    point: int | None = None,
    patch: int | None = None,
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
    return SnowPacks(read_crocus_output(source, point, patch, impurities))
