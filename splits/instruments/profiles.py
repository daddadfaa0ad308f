"""Vertical profiles inside a medium: irradiance and absorptance, under a beam or under a sky."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import check_axis
from splits.core.declarations import Quantity
from splits.core.inputs import (
    NUMBERS_SCHEMA,
    Numbers,
    check_depths,
)
from splits.core.validation import ROUNDING_TOLERANCE, invalid
from splits.discrete_ordinates.applicability import find_profile_obstacle
from splits.instruments.flux_dataset import make_flux_dataset, solve_flux
from splits.instruments.flux_media import TracedMedium, prepare_medium
from splits.instruments.flux_tally import FluxTally, FluxTarget
from splits.instruments.solver import (
    AUTO,
    LEAST_PATH_ERROR,
    Choice,
    choose_solver,
)
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import add_recording_planes, build_scene
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FRACTION,
    MAX_NODES,
    IndexNodes,
    choose_nodes,
)
from splits.simulation.strata import StoppingRule

MAX_DEPTHS = 200
BAND_INTERPOLATION_FRACTION = 0.04
"""The same for errors of bands, for which more index nodes need hardly any more rays."""
ProfileDepths = Annotated[
    Numbers,
    Quantity(
        "depths, besides those of top and bottom", "m", check=check_depths, schema=NUMBERS_SCHEMA
    ),
]


class FluxRequest(NamedTuple):
    """Request for fluxes inside a medium, see `irradiance_profile`."""

    medium: Medium
    wavelengths: np.ndarray
    depths: np.ndarray
    incidence: float | str
    max_stderr: float
    max_rays: int


def simulate_flux(
    request: FluxRequest, target: FluxTarget, run: RunOptions, solver: str
) -> xr.Dataset:
    """Return the dataset of `irradiance_profile` to an error, by a solver as given by the user."""
    medium, wavelengths, depths, incidence, max_stderr, max_rays = request
    choice = choose_solver(
        solver, [medium], wavelengths, max_stderr, run.threads, max_stderr=max_stderr,
        find_further_obstacle=lambda one: find_profile_obstacle(one, wavelengths),
    )  # fmt: skip
    for stack in choice.stacks:
        dataset = solve_flux(
            medium, stack, wavelengths, depths, incidence, max_stderr, target.limit_irradiance
        )
        dataset.attrs = _describe_request(request, target, run, choice) | dataset.attrs
        reached = dataset.attrs["max_stderr_reached"]
        if solver != AUTO or reached <= max(max_stderr, LEAST_PATH_ERROR):
            return dataset
        choice = Choice.of_missed_error(reached)
    traced_medium = prepare_medium(medium, wavelengths, depths, max_stderr, run)
    scene = build_scene(traced_medium.medium, incidence, False)
    scene = add_recording_planes(scene, depths.tolist())
    nodes = _choose_nodes(traced_medium, max_stderr, target.band_weights is not None)
    tally = FluxTally(nodes, traced_medium, scene, target)
    evaluation = simulate(scene, tally, StoppingRule(max_stderr, max_rays), run)
    attributes = {
        **_describe_request(request, target, run, choice),
        "max_stderr_reached": evaluation.error,
        **tally.describe_run(evaluation.stop_reason),
    }
    if traced_medium.semi_infinite:
        attributes["truncation_depth_m"] = float(traced_medium.planes_m[-1])
    return make_flux_dataset(evaluation.estimate, traced_medium, wavelengths, attributes)


def _describe_request(
    request: FluxRequest, target: FluxTarget, run: RunOptions, choice: Choice
) -> dict[str, Any]:
    """Return the attributes of a request, once it is finished."""
    return {
        **run.make_attributes("Light inside", "irradiance_profile", request.medium),
        "incidence_deg": request.incidence,
        "max_stderr": request.max_stderr,
        "target": "irradiance" if target.limit_irradiance else "absorptance",
        "max_rays": request.max_rays,
        **choice.attributes,
    }


def _choose_nodes(traced_medium: TracedMedium, max_stderr: float, has_bands: bool) -> IndexNodes:
    """Return the index nodes: more of them for bands, whose wavelengths share the rays."""
    index, interfaces = traced_medium.constants.indices, traced_medium.medium.list_interfaces()
    if has_bands:
        nodes = choose_nodes(index, interfaces, BAND_INTERPOLATION_FRACTION * max_stderr)
        if len(nodes.index) <= MAX_NODES:
            return nodes
    return choose_nodes(index, interfaces, INTERPOLATION_FRACTION * max_stderr)


def check_profile_depths(depth_m: Any, medium: Medium) -> np.ndarray:
    """Return depths inside a medium (m), after checking them."""
    thickness = np.inf if medium.is_semi_infinite else medium.depth_m
    depths = np.asarray(depth_m)
    if depths.size > MAX_DEPTHS:
        raise invalid("depth_m", f"{depths.size} depths", f"at most {MAX_DEPTHS}")
    hint = "top and bottom are always included"
    # Rounding may put a depth at the bottom on either side of it.
    at_bottom = np.isclose(depths, thickness, rtol=ROUNDING_TOLERANCE, atol=0.0)
    depths = np.where(at_bottom, thickness, depths)
    return check_axis(
        "depth_m", depths, 0.0, thickness, "m", open_low=True, open_high=True, hint=hint
    )
