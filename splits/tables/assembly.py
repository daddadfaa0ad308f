"""Assembly of a table from its blocks, in memory or block by block in a file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import netCDF4
import numpy as np
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import make_variable
from splits.illumination.bands import SpectralBand, SpectralOperator
from splits.io.netcdf import (
    append_checksum,
    atomic_netcdf,
    encode_for_netcdf,
    make_provenance,
    to_netcdf_attributes,
)
from splits.kernels.records import N_BATCHES
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.spectral_tally import QUANTITY_LABELS
from splits.simulation.strata import STOP_REASONS
from splits.tables.axes import (
    DIFFUSE_PREFIX,
    INCIDENCE,
    VIEW_AXES,
    ParameterGrid,
    list_quantities,
    list_view_axes,
)
from splits.tables.block import TableRequest
from splits.tables.plan import DIFFUSE, TablePlan


class TableVariable(NamedTuple):
    """Variable of a table.

    Attributes
    ----------
    quantity : str
    grid : ParameterGrid
        Grid of the points: the media, and the incidences except for quantities under isotropic
        light.
    leading, trailing : dict
        Sizes of the dimensions before and after those of the points.
    """

    quantity: str
    grid: ParameterGrid
    leading: dict[str, int]
    trailing: dict[str, int]

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions."""
        return (*self.leading, *self.grid, *self.trailing)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape."""
        return (*self.leading.values(), *self.grid.shape, *self.trailing.values())

    @property
    def flat_shape(self) -> tuple[int, ...]:
        """Shape with flattened points."""
        return (*self.leading.values(), self.grid.size, *self.trailing.values())


def list_variables(plan: TablePlan, request: TableRequest) -> dict[str, TableVariable]:
    """Return the variables of a table by name."""
    views = dict(zip(VIEW_AXES, request.views.shape, strict=True)) if request.views else {}
    variables: dict[str, TableVariable] = {}
    for quantity in request.quantities:
        trailing = {name: views[name] for name in list_view_axes(quantity)}
        trailing["wavelength"] = plan.wavelengths.size
        grid = plan.grid.drop(INCIDENCE) if quantity.startswith(DIFFUSE_PREFIX) else plan.grid
        for suffix in ("", "_stderr"):
            variables[quantity + suffix] = TableVariable(quantity, grid, {}, trailing)
        if request.covariance:
            batches = {"batch": N_BATCHES}
            variables[f"{quantity}_batches"] = TableVariable(quantity, grid, batches, trailing)
    return variables


LABELS = {
    **QUANTITY_LABELS,
    "reflectance_factor": "bidirectional reflectance factor",
    "anisotropy_factor": "anisotropy factor",
    "diffuse_reflectance": "bihemispherical reflectance",
    "diffuse_reflectance_factor": "hemispherical-directional reflectance factor",
    "diffuse_anisotropy_factor": "anisotropy factor under isotropic light",
}


def assemble_blocks(
    plan: TablePlan, request: TableRequest, blocks: Iterable[xr.Dataset]
) -> xr.Dataset:
    """Return a table as a dataset from its blocks, which are computed meanwhile."""
    start_time = time.perf_counter()
    variables, block_attrs = list_variables(plan, request), []
    arrays = {name: np.full(one.flat_shape, np.nan, np.float32) for name, one in variables.items()}
    for block in blocks:
        for name, variable in block.data_vars.items():
            leading = (slice(None),) * variable.dims.index("point")
            arrays[str(name)][(*leading, block.point.values)] = variable.values
        block_attrs.append(block.attrs)
    return _make_dataset(arrays, plan, request, block_attrs, time.perf_counter() - start_time)


def _make_dataset(
    arrays: Mapping[str, np.ndarray],
    plan: TablePlan,
    request: TableRequest,
    block_attrs: Sequence[Mapping[str, Any]],
    wall_time_s: float,
) -> xr.Dataset:
    """Return a table as a dataset from its arrays and the attributes of its blocks."""
    variables = {}
    is_diffuse = plan.path_groups[0].incidence == DIFFUSE
    for name, variable in list_variables(plan, request).items():
        quantity = variable.quantity
        label = LABELS[quantity]
        if quantity == "reflectance_factor" and is_diffuse:
            label = LABELS[DIFFUSE_PREFIX + quantity]
        attrs = {"long_name": label, "units": "1", "ancillary_variables": f"{quantity}_stderr"}
        if name != quantity:
            kind = "standard error" if name.endswith("_stderr") else "deviation by batch of rays"
            attrs = {"long_name": f"{kind} of {label}", "units": "1"}
        variables[name] = (variable.dims, arrays[name].reshape(variable.shape), attrs)
    coordinates = {
        **plan.grid.to_coordinates(),
        **({} if request.views is None else request.views.to_coordinates()),
        "wavelength": make_wavelength_coordinate(plan.wavelengths),
    }
    media, spectral_request = plan.list_media(), request.spectral_request
    described = [{f"{m.kind}_{key}": v for key, v in m.describe().items()} for m in media]
    common = {
        key: value
        for key, value in described[0].items()
        if all(key in one and np.array_equal(one[key], value) for one in described)
    }
    if INCIDENCE not in plan.grid:
        common[INCIDENCE] = plan.path_groups[0].incidence
    dataset_attrs: dict[str, Any] = {
        "title": f"Table of {plan.grid.size} spectra",
        "path_sharing_axes": ", ".join(plan.path_sharing_axes) or "none",
        "max_stderr": spectral_request.max_stderr,
        "max_stderr_reached": max(float(block["max_stderr_reached"]) for block in block_attrs),
        "interpolation_error_bound": max(
            float(block["interpolation_error_bound"]) for block in block_attrs
        ),
        "stop_reason": max(
            (str(block["stop_reason"]) for block in block_attrs), key=STOP_REASONS.index
        ),
        "solver": request.solver,
        "seed": spectral_request.run.seed,
        "rays": int(sum(int(block["rays"]) for block in block_attrs)),
        "ensembles": len(plan.path_groups),
        "wall_time_s": round(wall_time_s, 3),
        "physics_sources_sha256": hash_physics_sources(),
        "medium": media[0].kind,
        **common,
        **make_provenance("table"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(dataset_attrs))


def average_nodes(
    table: xr.Dataset, bands: Mapping[str, SpectralBand], matrix: SpectralOperator
) -> xr.Dataset:
    """Return a table with its means over bands at all nodes, and their errors."""
    axes = {"band": list(bands), "wavelength": table.wavelength}
    weights = xr.DataArray(matrix.weights, axes, list(axes))
    error_weights = xr.DataArray(matrix.error_weights, axes, ("estimate", *axes))
    variables: dict[str, Any] = {}
    for quantity in list_quantities(table):
        mean, error = table.errors.weighted_sum(quantity, weights)
        between = (error_weights * table[quantity]).sum("wavelength")
        error = (error**2 + (between**2).sum("estimate")) ** 0.5
        dims = tuple("band" if dim == "wavelength" else str(dim) for dim in table[quantity].dims)
        values, stderr = (one.transpose(*dims).values.astype(np.float32) for one in (mean, error))
        label = f"{table[quantity].attrs['long_name']} over a band"
        variables |= make_variable(f"band_{quantity}", dims, values, stderr, label)
    digests = {f"band_{name}_sha256": one.sha256 for name, one in bands.items() if one.sha256}
    return table.assign(variables).assign_coords(band=list(bands)).assign_attrs(digests)


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
        variables = list_variables(plan, request)
        # Broadcast values use no memory.
        empty = {
            name: np.broadcast_to(np.float32(np.nan), one.flat_shape)
            for name, one in variables.items()
        }
        attrs = [block.attrs for block in read_blocks()]
        seconds = sum(float(one["wall_time_s"]) for one in attrs)
        table = _make_dataset(empty, plan, request, attrs, seconds)
        skeleton = encode_for_netcdf(add_attributes(table))
        skeleton.drop_vars(list(variables)).to_netcdf(temporary, engine="netcdf4")
        with netCDF4.Dataset(temporary, "a") as file:
            for name in variables:
                # Without writing its values.
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
            for name, index, values in _iterate_points(read_blocks(), variables):
                file.variables[name][index] = values
        with netCDF4.Dataset(temporary) as file:
            file.set_auto_maskandscale(False)
            complete = all(
                np.array_equal(file.variables[name][index], values)
                for name, index, values in _iterate_points(read_blocks(), variables)
            )
        if not complete:
            raise OSError(f"{path}: the file written does not hold the table")
        append_checksum(temporary)


def _iterate_points(
    blocks: Iterable[xr.Dataset], variables: Mapping[str, TableVariable]
) -> Iterator[tuple[str, tuple[Any, ...], np.ndarray]]:
    """Yield the name of a variable, the index in the table, and the values, of each point."""
    for block in blocks:
        for name, variable in variables.items():
            if name in block:
                indices = np.unravel_index(block.point.values, variable.grid.shape)
                leading = (slice(None),) * len(variable.leading)
                for row, index in enumerate(zip(*(i.tolist() for i in indices), strict=True)):
                    yield name, (*leading, *index), block[name].isel(point=row).values
