"""Assembly of a table from its blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.instruments.spectral_run import QUANTITY_LABELS
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.stopping_rule import STOP_REASONS
from splits.tables.axes import INCIDENCE
from splits.tables.block import TableRequest
from splits.tables.plan import TablePlan


def compute_array_shapes(plan: TablePlan, request: TableRequest) -> dict[str, tuple[int, ...]]:
    """Return the shape of each variable of a table, with flattened points."""
    shape = (plan.grid.size, plan.wavelengths.size)
    shapes: dict[str, tuple[int, ...]] = {}
    for side in request.quantities:
        shapes |= {side: shape, f"{side}_stderr": shape}
        if request.covariance:
            shapes[f"{side}_batches"] = (N_BATCHES, *shape)
    return shapes


def allocate_arrays(plan: TablePlan, request: TableRequest) -> dict[str, np.ndarray]:
    """Return NaN arrays of a table by variable, to be filled by `insert_block`."""
    shapes = compute_array_shapes(plan, request)
    return {name: np.full(shape, np.nan, np.float32) for name, shape in shapes.items()}


def insert_block(arrays: dict[str, np.ndarray], block: xr.Dataset) -> None:
    """Copy a block into the arrays of a table."""
    for name, values in arrays.items():
        values[..., block.point.values, :] = block[name].values


def assemble_dataset(
    arrays: dict[str, np.ndarray],
    plan: TablePlan,
    request: TableRequest,
    block_attrs: Sequence[Mapping[str, Any]],
    wall_time_s: float,
) -> xr.Dataset:
    """Return a table as a dataset from its arrays and the attributes of its blocks."""
    dims = (*plan.grid.names, "wavelength")
    shape = (*plan.grid.shape, plan.wavelengths.size)
    variables = {}
    for name, values in arrays.items():
        side = name.partition("_")[0]
        attrs = {"long_name": QUANTITY_LABELS[side], "units": "1"}
        if name == side:
            attrs["ancillary_variables"] = f"{side}_stderr"
        else:
            kind = "standard error" if name.endswith("_stderr") else "deviation by batch of rays"
            attrs["long_name"] = f"{kind} of {attrs['long_name']}"
        leading_dims = ("batch",) if name.endswith("_batches") else ()
        variables[name] = (
            (*leading_dims, *dims),
            values.reshape(*values.shape[: len(leading_dims)], *shape),
            attrs,
        )
    coordinates = {
        **plan.grid.to_coordinates(),
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
    incidences = {path_group.incidence for path_group in plan.path_groups}
    if INCIDENCE not in plan.grid.names:
        attrs["incidence_deg"] = incidences.pop()
    return {"medium": first_medium.kind, **attrs}
