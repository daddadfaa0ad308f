"""How datasets lie in files: names and coordinates as the CF conventions have them, and back.

Coordinates of dimensions are numbers, strictly up or down; those of texts, or of numbers in no
order, are auxiliary in the file, ``medium_label(medium)`` and ``depth_m_value(depth_m)``.  Names
have letters, digits and underscores.
"""

from __future__ import annotations

import json
import re

import pandas as pd
import xarray as xr

from splits.io.integrity import CHECKSUM_ATTRIBUTE

LABEL_SUFFIX = "_label"
VALUE_SUFFIX = "_value"
"""What names of auxiliary coordinates in a file end in, after the dimension they belong to."""
DOTTED_NAMES_ATTRIBUTE = "names_with_dots"
"""Attribute of a file: which names have dots, in whose place it has underscores."""
RENAMED_NAMES_ATTRIBUTE = "names_in_file"
"""Attribute of a file: other names that are not those of the dataset, with these (JSON)."""
INDEX_LEVELS_ATTRIBUTE = "levels_of_dimensions"
"""Attribute of a file: dimensions that several coordinates label together, with these (JSON)."""


def encode_for_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset as it lies in a file."""
    levels = {
        str(dimension): list(index.names)
        for dimension in dataset.dims
        if isinstance(index := dataset.get_index(dimension), pd.MultiIndex)
    }
    dataset = dataset.reset_index(list(levels))
    axes, taken = {}, set()
    for dimension in map(str, dataset.dims):
        if dimension not in dataset.coords:
            # Whatever else has such a name would be its coordinate when it is read.
            taken |= {_to_identifier(dimension) + end for end in (LABEL_SUFFIX, VALUE_SUFFIX)}
            continue
        axis = dataset[dimension]
        index = axis.to_index()
        text = axis.dtype.kind in "OUS"
        ordered = index.is_monotonic_increasing or index.is_monotonic_decreasing
        if text or not (ordered and index.is_unique):
            axes[dimension] = _to_identifier(dimension) + (LABEL_SUFFIX if text else VALUE_SUFFIX)
            taken.add(axes[dimension])
    names = _choose_file_names(dataset, taken)
    stored = dataset.rename({own: name for own, name in names.items() if own != name})
    for own, auxiliary in axes.items():
        axis = stored[names[own]]
        coordinate = (names[own], axis.values, axis.attrs)
        stored = stored.drop_vars(names[own]).assign_coords({auxiliary: coordinate})
    stored.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    dotted = [own for own, name in names.items() if own != name == own.replace(".", "_")]
    others = {name: own for own, name in names.items() if own != name and own not in dotted}
    notes = {
        DOTTED_NAMES_ATTRIBUTE: " ".join(dotted),
        RENAMED_NAMES_ATTRIBUTE: others,
        INDEX_LEVELS_ATTRIBUTE: levels,
    }
    for key, note in notes.items():
        if note:
            stored.attrs[key] = note if isinstance(note, str) else json.dumps(note)
    return stored


def decode_from_netcdf(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset that lies in a file, from what the file has: undo `encode_for_netcdf`."""
    for dimension in {str(d) for d in dataset.dims if d not in dataset.coords}:
        for name in (dimension + LABEL_SUFFIX, dimension + VALUE_SUFFIX):
            if name in dataset.coords and dataset[name].dims == (dimension,):
                axis = (dimension, dataset[name].values, dataset[name].attrs)
                dataset = dataset.drop_vars(name).assign_coords({dimension: axis})
    own = {
        _to_identifier(name): name
        for name in str(dataset.attrs.pop(DOTTED_NAMES_ATTRIBUTE, "")).split()
    }
    own |= json.loads(dataset.attrs.pop(RENAMED_NAMES_ATTRIBUTE, "{}"))
    there = {*dataset.variables, *dataset.dims}
    dataset = dataset.rename({name: one for name, one in own.items() if name in there})
    return dataset.set_index(json.loads(dataset.attrs.pop(INDEX_LEVELS_ATTRIBUTE, "{}")))


def _choose_file_names(dataset: xr.Dataset, reserved_names: set[str]) -> dict[str, str]:
    """Return the names of variables and dimensions in a file by their own, none of those taken."""
    found = {}
    for own in sorted(map(str, {*dataset.variables, *dataset.dims})):
        name = _to_identifier(own)
        while name in reserved_names:
            name += "_"
        reserved_names.add(name)
        found[own] = name
    return found


def _to_identifier(name: str) -> str:
    """Return a name with underscores in place of all but letters and digits."""
    return re.sub(r"\W", "_", name)
