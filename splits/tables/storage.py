"""Tables that need not fit into memory: written block by block, straight into their file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from splits.io.cf_encoding import encode_for_netcdf
from splits.io.integrity import atomic_netcdf, write_checksums
from splits.simulation.tally import N_BATCHES
from splits.tables.assembly import assemble_dataset, compute_array_shapes
from splits.tables.block import TableRequest
from splits.tables.plan import TablePlan

MAX_BYTES_IN_MEMORY = 2**28
"""Bytes up to which a table is put together in memory, and read into it."""


def compute_table_bytes(plan: TablePlan, request: TableRequest) -> int:
    """Return the bytes that the values of a table take."""
    rows = sum(2 + N_BATCHES * request.covariance for _ in request.quantities)
    return 4 * rows * plan.grid.size * plan.wavelengths.size


def write_table_blockwise(
    path: Path,
    plan: TablePlan,
    request: TableRequest,
    read_blocks: Callable[[], Iterable[xr.Dataset]],
    add_attributes: Callable[[xr.Dataset], xr.Dataset],
) -> None:
    """Write a table so that its file appears whole or not at all.

    Of its values no more than a block is in memory at a time.  They lie in the file in the order of
    the axes, uncompressed, so that each spectrum is read by itself.

    Parameters
    ----------
    path : Path
    plan : Plan
    request : TableRequest
    read_blocks : callable
        Returns the blocks, each time it is called.
    add_attributes : callable
        Adds to the table's attributes.

    Raises
    ------
    OSError
        If there is no space for it, or the file does not hold the blocks afterwards.
    """
    with atomic_netcdf(path, compute_table_bytes(plan, request)) as aside:
        skeleton = encode_for_netcdf(
            add_attributes(_make_skeleton(plan, request, [block.attrs for block in read_blocks()]))
        )
        values = [str(name) for name in skeleton.data_vars]
        skeleton.drop_vars(values).to_netcdf(aside, engine="netcdf4")
        with netCDF4.Dataset(aside, "a") as file:
            for name in values:
                _create_variable(file, name, skeleton)
            for block in read_blocks():
                for name in values:
                    _write_block(file.variables[name], block, plan.grid.shape)
        with netCDF4.Dataset(aside) as file:
            file.set_auto_maskandscale(False)
            held = all(
                _has_block(file.variables[name], block, plan.grid.shape)
                for block in read_blocks()
                for name in values
            )
        if not held:
            raise OSError(f"{path}: the file written does not hold the table")
        write_checksums(aside)


def _make_skeleton(
    plan: TablePlan, request: TableRequest, block_attrs: Sequence[Mapping[str, Any]]
) -> xr.Dataset:
    """Return a table without values, which takes no memory for them."""
    nothing = {
        name: np.broadcast_to(np.float32(np.nan), shape)
        for name, shape in compute_array_shapes(plan, request).items()
    }
    return assemble_dataset(
        nothing, plan, request, block_attrs, sum(float(one["wall_time_s"]) for one in block_attrs)
    )


def _create_variable(file: netCDF4.Dataset, name: str, skeleton: xr.Dataset) -> None:
    """Make a variable in a file, whose values are still to come."""
    variable = skeleton[name]
    dims = [str(dim) for dim in variable.dims]
    for dim, size in zip(dims, variable.shape, strict=True):
        if dim not in file.dimensions:
            file.createDimension(dim, size)
    made = file.createVariable(name, "f4", dims, fill_value=False, contiguous=True)
    made.setncatts(variable.attrs)
    beside = [str(c) for c in variable.coords if c not in variable.dims]
    if beside:
        made.coordinates = " ".join(beside)


def _iterate_points(
    block: xr.Dataset, shape: tuple[int, ...]
) -> Iterable[tuple[int, tuple[Any, ...]]]:
    """Yield where the points of a block are among its own, and in the table."""
    places = np.unravel_index(block.point.values, shape)
    yield from enumerate(zip(*(axis.tolist() for axis in places), strict=True))


def _write_block(variable: netCDF4.Variable, block: xr.Dataset, shape: tuple[int, ...]) -> None:
    """Write what a block has of a variable."""
    lead = (slice(None),) * (variable.ndim - len(shape) - 1)
    values = block[variable.name].values
    for row, place in _iterate_points(block, shape):
        variable[(*lead, *place)] = values[..., row, :]


def _has_block(variable: netCDF4.Variable, block: xr.Dataset, shape: tuple[int, ...]) -> bool:
    """Tell whether a file has what a block has of a variable."""
    lead = (slice(None),) * (variable.ndim - len(shape) - 1)
    values = block[variable.name].values
    return all(
        np.array_equal(variable[(*lead, *place)], values[..., row, :])
        for row, place in _iterate_points(block, shape)
    )
