"""Export of tables to CSV."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_cells
from splits.tables.axis_order import ALONG


def write_csv(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a table as CSV, with one row per wavelength and point and the axes as columns.

    All quantities of a table of directions are in the same file.  A quantity that does not depend
    on an axis, such as ``reflectance`` on the angles of view, is repeated along this axis.  Text
    that a spreadsheet would evaluate as a formula gets an apostrophe in front.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.build_table`; deviations by batch and values between nodes are omitted.
    path : path
        Output file, written atomically.
    """
    names = [
        str(name)
        for name, v in dataset.data_vars.items()
        if "batch" not in v.dims and ALONG not in str(name)
    ]
    by_number_of_axes = sorted(names, key=lambda name: -dataset[name].ndim)
    dims = [str(dim) for name in by_number_of_axes for dim in dataset[name].dims]
    axes = [*dict.fromkeys(dim for dim in dims if dim != "wavelength"), "wavelength"]
    with atomic_write(path) as temporary:
        for number in range(dataset.sizes[axes[0]]):
            # One slice at a time: all rows together need many times the memory of the table.
            frame = dataset[names].isel({axes[0]: [number]}).to_dataframe(dim_order=axes)
            rows = escape_cells(frame.reset_index()[[*axes, *names]])
            rows.to_csv(temporary, mode="a", header=number == 0, index=False, float_format="%.6g")
