"""Block-wise writing of tables larger than memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from splits.io.netcdf import append_checksum, atomic_netcdf, encode_for_netcdf
from splits.tables.assembly import TableVariable, assemble_dataset, list_variables
from splits.tables.block import TableRequest
from splits.tables.plan import TablePlan

MAX_BYTES_IN_MEMORY = 2**28
"""Largest size of a table that is assembled in memory or read into it."""


def compute_table_bytes(plan: TablePlan, request: TableRequest) -> int:
    """Return the size of the values of a table in bytes."""
    sizes = (math.prod(one.shape) for one in list_variables(plan, request).values())
    return np.dtype(np.float32).itemsize * sum(sizes)


def write_table_blockwise(
    path: Path,
    plan: TablePlan,
    request: TableRequest,
    read_blocks: Callable[[], Iterable[xr.Dataset]],
    add_attributes: Callable[[xr.Dataset], xr.Dataset],
) -> None:
    """Write a table to a netCDF file atomically, one block at a time.

    At most one block of values is in memory.  Values are stored uncompressed in the order of the
    axes, so that single spectra can be read.

    Parameters
    ----------
    path : Path
    plan : TablePlan
    request : TableRequest
    read_blocks : callable
        Returns an iterable of the blocks; called several times.
    add_attributes : callable
        Returns a dataset with additional attributes.

    Raises
    ------
    OSError
        If the disk is full, or the file does not hold the blocks afterwards.
    """
    with atomic_netcdf(path, compute_table_bytes(plan, request)) as temporary:
        skeleton = encode_for_netcdf(
            add_attributes(_make_skeleton(plan, request, [block.attrs for block in read_blocks()]))
        )
        variables = list_variables(plan, request)
        skeleton.drop_vars(list(variables)).to_netcdf(temporary, engine="netcdf4")
        with netCDF4.Dataset(temporary, "a") as file:
            for name in variables:
                _create_variable(file, name, skeleton)
            for block in read_blocks():
                for name in map(str, block.data_vars):
                    _write_block(file.variables[name], block[name], variables[name])
        with netCDF4.Dataset(temporary) as file:
            file.set_auto_maskandscale(False)
            complete = all(
                _has_block(file.variables[name], block[name], variables[name])
                for block in read_blocks()
                for name in map(str, block.data_vars)
            )
        if not complete:
            raise OSError(f"{path}: the file written does not hold the table")
        append_checksum(temporary)


def _make_skeleton(
    plan: TablePlan, request: TableRequest, block_attrs: Sequence[Mapping[str, Any]]
) -> xr.Dataset:
    """Return a table with broadcast NaN values, which use no memory."""
    empty_arrays = {
        name: np.broadcast_to(np.float32(np.nan), one.flat_shape)
        for name, one in list_variables(plan, request).items()
    }
    return assemble_dataset(
        empty_arrays,
        plan,
        request,
        block_attrs,
        sum(float(attrs["wall_time_s"]) for attrs in block_attrs),
    )


def _create_variable(file: netCDF4.Dataset, name: str, skeleton: xr.Dataset) -> None:
    """Create a variable in a file without writing its values."""
    variable = skeleton[name]
    dims = [str(dim) for dim in variable.dims]
    for dim, size in zip(dims, variable.shape, strict=True):
        if dim not in file.dimensions:
            file.createDimension(dim, size)
    created = file.createVariable(name, "f4", dims, fill_value=False, contiguous=True)
    created.setncatts(variable.attrs)
    auxiliary = [str(c) for c in variable.coords if c not in variable.dims]
    if auxiliary:
        created.coordinates = " ".join(auxiliary)


def _iterate_points(
    block: xr.DataArray, table_variable: TableVariable
) -> Iterable[tuple[tuple[Any, ...], np.ndarray]]:
    """Yield the index in the table, and the values, of each point in a block."""
    indices = np.unravel_index(block.point.values, table_variable.grid.shape)
    leading = (slice(None),) * len(table_variable.leading)
    for row, index in enumerate(zip(*(axis.tolist() for axis in indices), strict=True)):
        yield (*leading, *index), block.isel(point=row).values


def _write_block(
    variable: netCDF4.Variable, block: xr.DataArray, table_variable: TableVariable
) -> None:
    """Write the values of a block into a variable."""
    for index, values in _iterate_points(block, table_variable):
        variable[index] = values


def _has_block(
    variable: netCDF4.Variable, block: xr.DataArray, table_variable: TableVariable
) -> bool:
    """Return whether a variable holds the values of a block."""
    return all(
        np.array_equal(variable[index], values)
        for index, values in _iterate_points(block, table_variable)
    )
