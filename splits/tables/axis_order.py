"""Validation of tables: ascending axes and complete values."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.validation import invalid
from splits.io.netcdf import NETCDF_LOCK
from splits.tables.views import VIEW_AXES

ALONG = "_along_"
"""Between a name and the axis of a table along which it has more positions than the nodes, see
`splits.tables.comparison`."""
Part = TypeVar("Part", xr.Dataset, xr.DataArray)


def sort_axes(dataset: Any) -> xr.Dataset:
    """Return a table with ascending numeric axes and the wavelength as the last axis.

    Tables that were sliced, sorted, transposed or converted with xarray are accepted.

    Raises
    ------
    ValueError
        If the dataset is not a table, or an axis is missing or invalid.
    """
    allowed = "what splits.build_table returned, or wrote"
    if not isinstance(dataset, xr.Dataset):
        hint = "splits.open_table(…) takes a path" if isinstance(dataset, str) else ""
        raise invalid("table", type(dataset).__name__, allowed, hint)
    if "path_sharing_axes" not in dataset.attrs:
        hint = "splits.retrieve_return takes a table of returns" if "return_rate" in dataset else ""
        raise invalid("table", dataset.attrs.get("title", "a dataset"), allowed, hint)
    # Means over bands follow from the spectra, also between the nodes.
    means = [name for name in dataset.data_vars if str(name).startswith("band_")]
    dataset = dataset.drop_vars([*means, "band"] if means else [])
    if not list_quantities(dataset):
        raise invalid("table", list(map(str, dataset.data_vars)), "with a quantity and its error")
    axes = list_axes(dataset)
    if "wavelength" not in axes:
        hint = "select a list: sel(wavelength=[500]), which keeps the axis"
        raise invalid("table", f"over {', '.join(axes) or 'nothing'}", "over wavelength", hint)
    for name in axes:
        dataset = _sort_axis(dataset, name)
    return dataset.transpose(..., *(name for name in axes if name != "wavelength"), "wavelength")


def list_quantities(dataset: xr.Dataset) -> list[str]:
    """Return the quantities of a table, without standard errors."""
    return [str(name) for name in dataset.data_vars if f"{name}_stderr" in dataset.data_vars]


def list_axes(dataset: xr.Dataset) -> list[str]:
    """Return the axes of the quantities of a table, the wavelength last where it is an axis."""
    axes: list[str] = []
    for name in list_quantities(dataset):
        axes += [str(dim) for dim in dataset[name].dims if dim not in axes]
    return sorted(axes, key=lambda axis: (axis == "wavelength", axis in VIEW_AXES))


def _sort_axis(dataset: xr.Dataset, name: str) -> xr.Dataset:
    """Return a table with one axis sorted and its numbers as floats."""
    if name not in dataset.coords:
        raise invalid(f"table.{name}", None, "given: the values of the axis")
    # Axes converted by pandas may have the dtype object.
    values = np.array(dataset[name].values.tolist())
    text = values.dtype.kind in "OUS"
    if not text and not (values.dtype.kind in "iuf" and np.isfinite(values).all()):
        raise invalid(f"table.{name}", values.tolist(), "numbers, or texts")
    if len(set(values.tolist())) < values.size:
        raise invalid(f"table.{name}", values.tolist(), "different values")
    if dataset[name].dtype.kind not in "fUS":
        axis = (name, values if text else values.astype(float), dataset[name].attrs)
        dataset = dataset.assign_coords({name: axis})
    return dataset if text or (np.diff(values) > 0.0).all() else dataset.sortby(name)


def check_complete(dataset: xr.Dataset) -> None:
    """Check that a table has a value at every node."""
    for name, variable in dataset.data_vars.items():
        # Comparisons with gaps, such as those of joined tables, are not used.
        is_checked = variable.dtype.kind == "f" and ALONG not in str(name)
        if is_checked and not np.isfinite(variable).all():
            hint = "aligning or reindexing leaves gaps: select existing nodes"
            raise invalid(f"table.{name}", np.nan, "a number at every node", hint)


def load_selection(selection: Part) -> Part:
    """Load a part of a table into memory and check it for gaps."""
    # The HDF5 library is not thread-safe.
    with NETCDF_LOCK:
        selection = selection.load()
    check_no_gaps("table", selection)
    return selection
