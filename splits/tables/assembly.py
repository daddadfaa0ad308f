"""Assembly of a table from its blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import compute_weighted_error, make_variable
from splits.illumination.bands import SpectralBand, SpectralOperator
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.spectral_tally import QUANTITY_LABELS
from splits.simulation.strata import STOP_REASONS
from splits.tables.axes import INCIDENCE, ParameterGrid
from splits.tables.axis_order import list_quantities
from splits.tables.block import TableRequest
from splits.tables.plan import DIFFUSE, TablePlan
from splits.tables.views import DIFFUSE_PREFIX, VIEW_AXES, list_view_axes


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
        return (*self.leading, *self.grid.names, *self.trailing)

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
        grid = plan.media_grid if quantity.startswith(DIFFUSE_PREFIX) else plan.grid
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


def allocate_arrays(plan: TablePlan, request: TableRequest) -> dict[str, np.ndarray]:
    """Return NaN arrays of a table by variable, to be filled by `insert_block`."""
    variables = list_variables(plan, request)
    return {name: np.full(one.flat_shape, np.nan, np.float32) for name, one in variables.items()}


def insert_block(arrays: dict[str, np.ndarray], block: xr.Dataset) -> None:
    """Copy a block into the arrays of a table."""
    for name, variable in block.data_vars.items():
        points = (slice(None),) * variable.dims.index("point")
        arrays[str(name)][(*points, block.point.values)] = variable.values


def assemble_dataset(
    arrays: dict[str, np.ndarray],
    plan: TablePlan,
    request: TableRequest,
    block_attrs: Sequence[Mapping[str, Any]],
    wall_time_s: float,
) -> xr.Dataset:
    """Return a table as a dataset from its arrays and the attributes of its blocks."""
    variables = {}
    for name, variable in list_variables(plan, request).items():
        quantity = variable.quantity
        label = LABELS[quantity]
        if quantity == "reflectance_factor" and plan.path_groups[0].incidence == DIFFUSE:
            label = LABELS[DIFFUSE_PREFIX + quantity]
        attrs = {"long_name": label, "units": "1"}
        if name == quantity:
            attrs["ancillary_variables"] = f"{quantity}_stderr"
        else:
            kind = "standard error" if name.endswith("_stderr") else "deviation by batch of rays"
            attrs["long_name"] = f"{kind} of {attrs['long_name']}"
        variables[name] = (variable.dims, arrays[name].reshape(variable.shape), attrs)
    coordinates = {
        **plan.grid.to_coordinates(),
        **({} if request.views is None else request.views.to_coordinates()),
        "wavelength": make_wavelength_coordinate(plan.wavelengths),
    }
    spectral_request = request.spectral_request
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
        **_find_common_attributes(plan),
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
        error = compute_weighted_error(table, quantity, weights)
        between = (error_weights * table[quantity]).sum("wavelength")
        error = (error**2 + (between**2).sum("estimate")) ** 0.5
        mean = (weights * table[quantity]).sum("wavelength")
        dims = tuple("band" if dim == "wavelength" else str(dim) for dim in table[quantity].dims)
        values, stderr = (one.transpose(*dims).values.astype(np.float32) for one in (mean, error))
        label = f"{table[quantity].attrs['long_name']} over a band"
        variables |= make_variable(f"band_{quantity}", dims, values, stderr, label)
    digests = {f"band_{name}_sha256": one.sha256 for name, one in bands.items() if one.sha256}
    return table.assign(variables).assign_coords(band=list(bands)).assign_attrs(digests)


def _find_common_attributes(plan: TablePlan) -> dict[str, Any]:
    """Return the attributes common to all media of a table."""
    media = plan.list_media()
    first_medium = media[0]
    attrs = {f"{first_medium.kind}_{key}": value for key, value in first_medium.describe().items()}
    for medium in media[1:]:
        medium_attrs = {f"{medium.kind}_{key}": value for key, value in medium.describe().items()}
        attrs = {
            k: v
            for k, v in attrs.items()
            if k in medium_attrs and np.array_equal(medium_attrs[k], v)
        }
    if INCIDENCE not in plan.grid.names:
        attrs["incidence_deg"] = plan.path_groups[0].incidence
    return {"medium": first_medium.kind, **attrs}
