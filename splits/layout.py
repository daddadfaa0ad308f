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

from splits.checksum import CHECKSUM

LABEL = "_label"
VALUE = "_value"
"""What names of auxiliary coordinates in a file end in, after the dimension they belong to."""
DOTTED = "names_with_dots"
"""Attribute of a file: which names have dots, in whose place it has underscores."""
RENAMED = "names_in_file"
"""Attribute of a file: other names that are not those of the dataset, with these (JSON)."""
LEVELS = "levels_of_dimensions"
"""Attribute of a file: dimensions that several coordinates label together, with these (JSON)."""


def stored_as(dataset: xr.Dataset) -> xr.Dataset:
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
            taken |= {_plain(dimension) + end for end in (LABEL, VALUE)}
            continue
        axis = dataset[dimension]
        index = axis.to_index()
        text = axis.dtype.kind in "OUS"
        ordered = index.is_monotonic_increasing or index.is_monotonic_decreasing
        if text or not (ordered and index.is_unique):
            axes[dimension] = _plain(dimension) + (LABEL if text else VALUE)
            taken.add(axes[dimension])
    names = _names_in_file(dataset, taken)
    stored = dataset.rename({own: name for own, name in names.items() if own != name})
    for own, auxiliary in axes.items():
        axis = stored[names[own]]
        coordinate = (names[own], axis.values, axis.attrs)
        stored = stored.drop_vars(names[own]).assign_coords({auxiliary: coordinate})
    stored.attrs.pop(CHECKSUM, None)
    dotted = [own for own, name in names.items() if own != name == own.replace(".", "_")]
    others = {name: own for own, name in names.items() if own != name and own not in dotted}
    notes = {DOTTED: " ".join(dotted), RENAMED: others, LEVELS: levels}
    for key, note in notes.items():
        if note:
            stored.attrs[key] = note if isinstance(note, str) else json.dumps(note)
    return stored


def as_stored(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset that lies in a file, from what the file has: undo `stored_as`."""
    for dimension in {str(d) for d in dataset.dims if d not in dataset.coords}:
        for name in (dimension + LABEL, dimension + VALUE):
            if name in dataset.coords and dataset[name].dims == (dimension,):
                axis = (dimension, dataset[name].values, dataset[name].attrs)
                dataset = dataset.drop_vars(name).assign_coords({dimension: axis})
    own = {_plain(name): name for name in str(dataset.attrs.pop(DOTTED, "")).split()}
    own |= json.loads(dataset.attrs.pop(RENAMED, "{}"))
    there = {*dataset.variables, *dataset.dims}
    dataset = dataset.rename({name: one for name, one in own.items() if name in there})
    return dataset.set_index(json.loads(dataset.attrs.pop(LEVELS, "{}")))


def _names_in_file(dataset: xr.Dataset, reserved_names: set[str]) -> dict[str, str]:
    """Return the names of variables and dimensions in a file by their own, none of those taken."""
    found = {}
    for own in sorted(map(str, {*dataset.variables, *dataset.dims})):
        name = _plain(own)
        while name in reserved_names:
            name += "_"
        reserved_names.add(name)
        found[own] = name
    return found


def _plain(name: str) -> str:
    """Return a name with underscores in place of all but letters and digits."""
    return re.sub(r"\W", "_", name)
