"""Encoding of names and coordinates by the CF conventions, and decoding.

CF coordinates of dimensions are strictly monotonic numbers.  Coordinates of text or of unordered
numbers are auxiliary coordinates in the file, ``medium_label(medium)`` and
``depth_m_value(depth_m)``.  Names consist of letters, digits and underscores.
"""

from __future__ import annotations

import json
import re

import pandas as pd
import xarray as xr

from splits.io.integrity import CHECKSUM_ATTRIBUTE

LABEL_SUFFIX = "_label"
VALUE_SUFFIX = "_value"
"""Suffixes of auxiliary coordinates in a file, after the name of the dimension."""
DOTTED_NAMES_ATTRIBUTE = "names_with_dots"
"""File attribute: names with dots, which are underscores in the file."""
RENAMED_NAMES_ATTRIBUTE = "names_in_file"
"""File attribute: other names in the file with those of the dataset (JSON)."""
INDEX_LEVELS_ATTRIBUTE = "levels_of_dimensions"
"""File attribute: dimensions with a multi-index and the names of its levels (JSON)."""


def encode_for_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset encoded for a netCDF file."""
    levels = {
        str(dimension): list(index.names)
        for dimension in dataset.dims
        if isinstance(index := dataset.get_index(dimension), pd.MultiIndex)
    }
    dataset = dataset.reset_index(list(levels))
    auxiliary_names, reserved = {}, set()
    for dimension in map(str, dataset.dims):
        if dimension not in dataset.coords:
            # Another variable of such a name would be decoded as its coordinate.
            reserved |= {
                _to_identifier(dimension) + suffix for suffix in (LABEL_SUFFIX, VALUE_SUFFIX)
            }
            continue
        coordinate_variable = dataset[dimension]
        index = coordinate_variable.to_index()
        text = coordinate_variable.dtype.kind in "OUS"
        ordered = index.is_monotonic_increasing or index.is_monotonic_decreasing
        if text or not (ordered and index.is_unique):
            auxiliary_names[dimension] = _to_identifier(dimension) + (
                LABEL_SUFFIX if text else VALUE_SUFFIX
            )
            reserved.add(auxiliary_names[dimension])
    names = _choose_file_names(dataset, reserved)
    encoded = dataset.rename({own: name for own, name in names.items() if own != name})
    for own, auxiliary in auxiliary_names.items():
        coordinate_variable = encoded[names[own]]
        coordinate = (names[own], coordinate_variable.values, coordinate_variable.attrs)
        encoded = encoded.drop_vars(names[own]).assign_coords({auxiliary: coordinate})
    encoded.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    dotted = [own for own, name in names.items() if own != name == own.replace(".", "_")]
    renamed = {name: own for own, name in names.items() if own != name and own not in dotted}
    encoding_attrs = {
        DOTTED_NAMES_ATTRIBUTE: " ".join(dotted),
        RENAMED_NAMES_ATTRIBUTE: renamed,
        INDEX_LEVELS_ATTRIBUTE: levels,
    }
    for key, value in encoding_attrs.items():
        if value:
            encoded.attrs[key] = value if isinstance(value, str) else json.dumps(value)
    return encoded


def decode_from_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset decoded from a netCDF file; the inverse of `encode_for_netcdf`."""
    for dimension in {str(d) for d in dataset.dims if d not in dataset.coords}:
        for name in (dimension + LABEL_SUFFIX, dimension + VALUE_SUFFIX):
            if name in dataset.coords and dataset[name].dims == (dimension,):
                axis = (dimension, dataset[name].values, dataset[name].attrs)
                dataset = dataset.drop_vars(name).assign_coords({dimension: axis})
    original_names = {
        _to_identifier(name): name
        for name in str(dataset.attrs.pop(DOTTED_NAMES_ATTRIBUTE, "")).split()
    }
    original_names |= json.loads(dataset.attrs.pop(RENAMED_NAMES_ATTRIBUTE, "{}"))
    present = {*dataset.variables, *dataset.dims}
    dataset = dataset.rename(
        {name: original for name, original in original_names.items() if name in present}
    )
    return dataset.set_index(json.loads(dataset.attrs.pop(INDEX_LEVELS_ATTRIBUTE, "{}")))


def _choose_file_names(dataset: xr.Dataset, reserved_names: set[str]) -> dict[str, str]:
    """Return file names of variables and dimensions by name, avoiding reserved names."""
    file_names = {}
    for own in sorted(map(str, {*dataset.variables, *dataset.dims})):
        name = _to_identifier(own)
        while name in reserved_names:
            name += "_"
        reserved_names.add(name)
        file_names[own] = name
    return file_names


def _to_identifier(name: str) -> str:
    """Return a name with all characters but letters and digits replaced by underscores."""
    return re.sub(r"\W", "_", name)
