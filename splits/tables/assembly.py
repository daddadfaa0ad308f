"""A table put together from its blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.instruments.spectral_run import QUANTITY_LABELS
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.simulation.attributes import make_wavelength_coordinate
from splits.simulation.tally import N_BATCHES
from splits.tables.axes import INCIDENCE
from splits.tables.block import TableRequest
from splits.tables.plan import TablePlan


def compute_array_shapes(plan: TablePlan, request: TableRequest) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays of a table by variable, its points in a row."""
    shape = (plan.grid.size, plan.wavelengths.size)
    found: dict[str, tuple[int, ...]] = {}
    for side in request.quantities:
        found |= {side: shape, f"{side}_stderr": shape}
        if request.covariance:
            found[f"{side}_batches"] = (N_BATCHES, *shape)
    return found


def allocate_arrays(plan: TablePlan, request: TableRequest) -> dict[str, np.ndarray]:
    """Return the arrays of a table, by variable, that `insert_block` fills."""
    shapes = compute_array_shapes(plan, request)
    return {name: np.full(shape, np.nan, np.float32) for name, shape in shapes.items()}


def insert_block(arrays: dict[str, np.ndarray], block: xr.Dataset) -> None:
    """Put a block into the arrays of a table."""
    for name, values in arrays.items():
        values[..., block.point.values, :] = block[name].values


def assemble_dataset(
    arrays: dict[str, np.ndarray],
    plan: TablePlan,
    request: TableRequest,
    block_attrs: Sequence[Mapping[str, Any]],
    wall_time_s: float,
) -> xr.Dataset:
    """Return a table as a dataset, from its arrays and what blocks say of themselves."""
    dims = (*plan.grid.names, "wavelength")
    shape = (*plan.grid.shape, plan.wavelengths.size)
    variables = {}
    for name, values in arrays.items():
        side = name.partition("_")[0]
        about = {"long_name": QUANTITY_LABELS[side], "units": "1"}
        if name == side:
            about["ancillary_variables"] = f"{side}_stderr"
        else:
            kind = "standard error" if name.endswith("_stderr") else "deviation by batch of rays"
            about["long_name"] = f"{kind} of {about['long_name']}"
        lead = ("batch",) if name.endswith("_batches") else ()
        variables[name] = (
            (*lead, *dims),
            values.reshape(*values.shape[: len(lead)], *shape),
            about,
        )
    coordinates = {
        **plan.grid.to_coordinates(),
        "wavelength": make_wavelength_coordinate(plan.wavelengths),
    }
    run = request.spectral_request
    facts_of_all: dict[str, Any] = {
        "title": f"Table of {plan.grid.size} spectra",
        "path_sharing_axes": ", ".join(plan.path_sharing_axes) or "none",
        "max_stderr": run.max_stderr,
        "max_stderr_reached": max(float(one["max_stderr_reached"]) for one in block_attrs),
        "interpolation_error_bound": max(
            float(one["interpolation_error_bound"]) for one in block_attrs
        ),
        "stop_reason": "converged"
        if all(o["stop_reason"] == "converged" for o in block_attrs)
        else "max_rays",
        "seed": run.seed,
        "rays": int(sum(int(one["rays"]) for one in block_attrs)),
        "ensembles": len(plan.path_groups),
        "wall_time_s": round(wall_time_s, 3),
        "physics_sources_sha256": hash_physics_sources(),
        **_find_common_attributes(plan),
        **make_provenance("table"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(facts_of_all))


def _find_common_attributes(plan: TablePlan) -> dict[str, Any]:
    """Return what all media of a table have in common, as attributes."""
    media = [medium for one in plan.path_groups for medium in one.path_sharing.media]
    first = media[0]
    facts = {f"{first.kind}_{key}": value for key, value in first.describe().items()}
    for medium in media[1:]:
        other = {f"{medium.kind}_{key}": value for key, value in medium.describe().items()}
        facts = {k: v for k, v in facts.items() if k in other and np.array_equal(other[k], v)}
    incidences = {one.incidence for one in plan.path_groups}
    if INCIDENCE not in plan.grid.names:
        facts["incidence_deg"] = incidences.pop()
    return {"medium": first.kind, **facts}
