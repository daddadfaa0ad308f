"""Quality of snowpacks: absent layers, missing values, ranges, night."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import ROUNDING_TOLERANCE, snap_to_limits
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.materials.density import interpolate_ice_density
from splits.materials.impurities import MAX_NG_G
from splits.media.measured_inputs import (
    MAX_SURFACE_AREA_M2_KG,
    MIN_SURFACE_AREA_M2_KG,
    OPTICAL_RADIUS_KEY,
    SURFACE_AREA_KEY,
)
from splits.media.natural_snow import MIN_NATURAL_DENSITY_KG_M3
from splits.media.pack_ground import GROUND_ATTRIBUTE, GROUND_KEY, WAVELENGTH_DIM
from splits.media.snow_pack_input import (
    DEFAULTS,
    DENSITY_KEY,
    FLAG_NAME,
    LAYER_DIM,
    LAYER_FLAG_NAME,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
    ZENITH_KEY,
    SnowPackInput,
    describe_variable,
)

FLAGS = {"good": 0, "no_snow": 1, "missing_value": 2, "out_of_range": 3, "night": 4}
"""Flags of snowpacks; of several reasons, the first in this order is the flag."""
LAYER_FLAGS = {"present": 0, "absent": 1}
"""Flags of layers."""
HORIZON_DEG = 90.0
"""Zenith angle from which on the sun is below the horizon."""
RANGES = {
    THICKNESS_KEY: (0.0, 1e4),
    DENSITY_KEY: (MIN_NATURAL_DENSITY_KG_M3, np.inf),
    SURFACE_AREA_KEY: (MIN_SURFACE_AREA_M2_KG, MAX_SURFACE_AREA_M2_KG),
    TEMPERATURE_KEY: (-40.0, 0.0),
    WATER_KEY: (0.0, np.inf),
}
"""Ranges of `splits.Snow.natural`; the density of ice and the porosity limit two further."""


def make_dataset(given: SnowPackInput) -> xr.Dataset:
    """Return the checked dataset with its flags."""
    values, is_absent = complete_layers(given)
    flags = compute_flags(values, is_absent, given)
    dims = (given.label, LAYER_DIM)
    variables: dict[str, Any] = {
        name: (dims, numbers, f"{LAYER_FLAG_NAME} {FLAG_NAME}") for name, numbers in values.items()
    }
    if given.sun_zenith_deg is not None:
        variables[ZENITH_KEY] = (given.label, given.sun_zenith_deg, FLAG_NAME)
    if given.ground.albedo is not None:
        dimensions = (given.label, WAVELENGTH_DIM)[: given.ground.albedo.ndim]
        variables[GROUND_KEY] = (dimensions, given.ground.albedo, FLAG_NAME)
    for name, (dimensions, numbers, ancillary) in variables.items():
        long_name, units = describe_variable(name)
        attrs = {"long_name": long_name, "units": units, ANCILLARY_ATTRIBUTE: ancillary}
        variables[name] = (dimensions, numbers, attrs)
    if given.ground.albedo is None:
        names = np.full(flags.size, given.ground.get_name(), dtype=object)
        attrs = {"long_name": "ground below the snowpack"}
        variables[GROUND_ATTRIBUTE] = (given.label, names, attrs)
    variables[FLAG_NAME] = (given.label, flags, _describe_flags("quality of the snowpack", FLAGS))
    layer_flags = is_absent.astype(np.int8) * np.int8(LAYER_FLAGS["absent"])
    variables[LAYER_FLAG_NAME] = (
        dims,
        layer_flags,
        _describe_flags("whether the layer is absent", LAYER_FLAGS),
    )
    number = np.arange(is_absent.shape[1])
    attrs = {
        "long_name": "number of the layer, 0 at the top", "units": "1",
        "axis": "Z", "positive": "down",
    }  # fmt: skip
    coordinates = given.coordinates.copy()
    if given.label not in coordinates.coords:
        coordinates = coordinates.assign_coords({given.label: np.arange(flags.size)})
    label = coordinates[given.label]
    if label.dtype.kind == "M":
        label.attrs = {
            "standard_name": "time", "long_name": "time", "units_metadata": "leap_seconds: none",
        }  # fmt: skip
    label.attrs.setdefault("long_name", f"label of the snowpack: {given.label}")
    dataset = coordinates.assign_coords({LAYER_DIM: (LAYER_DIM, number, attrs)}).assign(variables)
    if given.ground.wavelength_nm is not None:
        attrs = {"long_name": "wavelength in vacuum", "units": "nm"}
        dataset = dataset.assign_coords(
            {WAVELENGTH_DIM: (WAVELENGTH_DIM, given.ground.wavelength_nm, attrs)}
        )
    dataset.attrs = {"title": "Snowpacks", **given.ground.make_attributes()}
    return dataset


def _describe_flags(long_name: str, flags: dict[str, int]) -> dict[str, Any]:
    """Return the attributes of a flag variable by the CF conventions (section 3.5)."""
    return {
        "long_name": long_name,
        "flag_values": np.array(list(flags.values()), dtype=np.int8),
        "flag_meanings": " ".join(flags),
    }


def complete_layers(given: SnowPackInput) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the variables of layers in their final form, and which layers are absent.

    A layer is absent if its thickness is 0, or if its thickness and all other variables given for
    each layer are NaN.  Absent layers follow the others, and all of their variables are NaN.
    """
    values = dict(given.values)
    thickness = values[THICKNESS_KEY]
    described = np.zeros(thickness.shape, dtype=bool)
    for name in given.layered - {THICKNESS_KEY}:
        described |= ~np.isnan(values[name])
    is_absent = (thickness == 0.0) | (np.isnan(thickness) & ~described)
    for name, default in DEFAULTS.items():
        if name not in values:
            values[name] = np.full(thickness.shape, default)
    order = np.argsort(is_absent, axis=1, kind="stable")
    is_absent = np.take_along_axis(is_absent, order, axis=1)
    for name, numbers in values.items():
        values[name] = np.where(is_absent, np.nan, np.take_along_axis(numbers, order, axis=1))
    for name in (TEMPERATURE_KEY, WATER_KEY):
        values[name] = snap_to_limits(values[name], *RANGES[name])
    if OPTICAL_RADIUS_KEY in values:
        # A radius of 0 or less becomes an area that is finite and out of range.
        radius_um = np.maximum(values.pop(OPTICAL_RADIUS_KEY), 1e-9)
        ice = interpolate_ice_density(values[TEMPERATURE_KEY])
        values[SURFACE_AREA_KEY] = 3e6 / (ice * radius_um)
    return values, is_absent


def compute_flags(
    values: Mapping[str, np.ndarray], is_absent: np.ndarray, given: SnowPackInput
) -> np.ndarray:
    """Return the flag of each snowpack, one of `FLAGS`.

    Parameters
    ----------
    values : mapping of float, shape (snowpacks, layers)
        As returned by `complete_layers`.
    is_absent : bool, shape (snowpacks, layers)
    given : SnowPackInput
        With the zenith angles of the sun and the ground.
    """
    is_missing = np.any(
        [(np.isnan(numbers) & ~is_absent).any(axis=1) for numbers in values.values()], axis=0
    )
    is_outside = find_values_out_of_range(values).any(axis=1)
    flags = np.full(is_missing.size, FLAGS["good"], dtype=np.int8)
    sun_zenith_deg, albedo = given.sun_zenith_deg, given.ground.albedo
    if albedo is not None:
        by_snowpack = albedo.reshape(flags.size, -1)
        is_missing |= np.isnan(by_snowpack).any(axis=1)
        is_outside |= ((by_snowpack < 0.0) | (by_snowpack > 1.0)).any(axis=1)
    if sun_zenith_deg is not None:
        flags[sun_zenith_deg >= HORIZON_DEG] = FLAGS["night"]
        is_missing |= np.isnan(sun_zenith_deg)
        is_outside |= (sun_zenith_deg < 0.0) | (sun_zenith_deg > 180.0)
    flags[is_outside] = FLAGS["out_of_range"]
    flags[is_missing] = FLAGS["missing_value"]
    flags[is_absent.all(axis=1)] = FLAGS["no_snow"]
    return flags


def find_values_out_of_range(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return which layers have a value outside the range of `splits.Snow.natural`."""
    is_outside = np.zeros(values[THICKNESS_KEY].shape, dtype=bool)
    for name, numbers in values.items():
        low, high = RANGES.get(name, (0.0, MAX_NG_G))
        snapped = snap_to_limits(numbers, low, high)
        is_outside |= (snapped < low) | (snapped > high)
    ice = interpolate_ice_density(values[TEMPERATURE_KEY])
    porosity = 1.0 - values[DENSITY_KEY] / ice
    is_outside |= values[DENSITY_KEY] >= ice
    is_outside |= values[WATER_KEY] > porosity * (1.0 + ROUNDING_TOLERANCE)
    return is_outside


def count_missing_results(dataset: xr.Dataset) -> str:
    """Return the numbers of snowpacks without a result by the meaning of their flag, or ""."""
    flag = dataset.quality_flag
    meanings = flag.attrs["flag_meanings"].split()
    return ", ".join(
        f"{int((flag == value).sum())} {meaning.replace('_', ' ')}"
        for value, meaning in zip(flag.attrs["flag_values"], meanings, strict=True)
        if value != 0 and (flag == value).any()
    )
