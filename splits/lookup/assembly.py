"""A table put together from its blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.dataset import attributes, provenance
from splits.instruments.ensemble import GROUPS
from splits.instruments.labels import wavelength_axis
from splits.instruments.spectral_run import QUANTITIES
from splits.lookup.axes import INCIDENCE
from splits.lookup.block import Order
from splits.lookup.plan import Plan
from splits.sources import physics_digest


def arrays_of(plan: Plan, order: Order) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays of a table by variable, its points in a row."""
    shape = (plan.axes.size, plan.wavelengths.size)
    found: dict[str, tuple[int, ...]] = {}
    for side in order.quantities:
        found |= {side: shape, f"{side}_stderr": shape}
        if order.covariance:
            found[f"{side}_groups"] = (GROUPS, *shape)
    return found


def blank(plan: Plan, order: Order) -> dict[str, np.ndarray]:
    """Return the arrays of a table, by variable, that `fill` fills."""
    shapes = arrays_of(plan, order)
    return {name: np.full(shape, np.nan, np.float32) for name, shape in shapes.items()}


def fill(found: dict[str, np.ndarray], block: xr.Dataset) -> None:
    """Put a block into the arrays of a table."""
    for name, values in found.items():
        values[..., block.point.values, :] = block[name].values


def finished(
    found: dict[str, np.ndarray],
    plan: Plan,
    order: Order,
    facts: Sequence[Mapping[str, Any]],
    seconds: float,
) -> xr.Dataset:
    """Return a table as a dataset, from its arrays and what blocks say of themselves."""
    dims = (*plan.axes.names, "wavelength")
    shape = (*plan.axes.shape, plan.wavelengths.size)
    variables = {}
    for name, values in found.items():
        side = name.partition("_")[0]
        about = {"long_name": QUANTITIES[side], "units": "1"}
        if name == side:
            about["ancillary_variables"] = f"{side}_stderr"
        else:
            kind = "standard error" if name.endswith("_stderr") else "deviation by group of rays"
            about["long_name"] = f"{kind} of {about['long_name']}"
        lead = ("group",) if name.endswith("_groups") else ()
        variables[name] = (
            (*lead, *dims),
            values.reshape(*values.shape[: len(lead)], *shape),
            about,
        )
    coordinates = {**plan.axes.coordinates(), "wavelength": wavelength_axis(plan.wavelengths)}
    run = order.run
    facts_of_all: dict[str, Any] = {
        "title": f"Table of {plan.axes.size} spectra",
        "axes_that_share_paths": ", ".join(plan.shared) or "none",
        "max_stderr": run.max_stderr,
        "max_stderr_reached": max(float(one["max_stderr_reached"]) for one in facts),
        "interpolation_error_bound": max(float(one["interpolation_error_bound"]) for one in facts),
        "stopped_by": "error" if all(o["stopped_by"] == "error" for o in facts) else "rays",
        "seed": run.seed,
        "rays": int(sum(int(one["rays"]) for one in facts)),
        "ensembles": len(plan.ensembles),
        "wall_time_s": round(seconds, 3),
        "physics_sources_sha256": physics_digest(),
        **_fixed(plan),
        **provenance("table"),
    }
    return xr.Dataset(variables, coordinates, attributes(facts_of_all))


def _fixed(plan: Plan) -> dict[str, Any]:
    """Return what all media of a table have in common, as attributes."""
    media = [medium for one in plan.ensembles for medium in one.family.media]
    first = media[0]
    facts = {f"{first.kind}_{key}": value for key, value in first.describe().items()}
    for medium in media[1:]:
        other = {f"{medium.kind}_{key}": value for key, value in medium.describe().items()}
        facts = {k: v for k, v in facts.items() if k in other and np.array_equal(other[k], v)}
    incidences = {one.incidence for one in plan.ensembles}
    if INCIDENCE not in plan.axes.names:
        facts["incidence_deg"] = incidences.pop()
    return {"medium": first.kind, **facts}
