"""Vertical profiles of irradiance, and the absorptance between depths."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, check_axis
from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_choice,
    check_integer,
    check_range,
    invalid,
)
from splits.discrete_ordinates.applicability import find_obstacle, find_profile_obstacle
from splits.instruments.flux_dataset import make_flux_dataset
from splits.instruments.flux_media import TracedMedium, prepare_medium
from splits.instruments.flux_solver import solve_flux
from splits.instruments.flux_tally import FluxTally
from splits.instruments.flux_target import FluxTarget
from splits.instruments.solver import (
    AUTO,
    DISCRETE_ORDINATES,
    LEAST_PATH_ERROR,
    MONTE_CARLO,
    choose_solver,
)
from splits.kernels.tallies.exits import N_BATCHES
from splits.media.checks import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, check_incidence, check_wavelengths
from splits.simulation.scene import add_recording_planes, build_scene
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FRACTION,
    MAX_NODES,
    IndexNodes,
    choose_nodes,
)
from splits.simulation.strata import StoppingRule

MAX_DEPTHS = 200
MAX_TALLY_VALUES = 100_000_000
"""Largest number of sums by batch, layer, material and wavelength; a run takes three times their
memory."""
BAND_INTERPOLATION_FRACTION = 0.04
"""The same for errors of bands, for which more index nodes need hardly any more rays."""
ERROR_QUANTITIES = ("irradiance", "absorptance")
"""Quantities to which the largest error applies; the first means all of them."""


@reject_unknown_arguments
def irradiance_profile(
    medium: Medium,
    wavelength_nm: Any,
    depth_m: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    solver: str = "auto",
    target: str = "irradiance",
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the irradiances inside a medium, and the absorptance between depths.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow`, `splits.Stack` or `splits.ParticleLayer`; may be semi-infinite.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  The top of the medium and,
        unless it is semi-infinite, its bottom are added.
    incidence_deg : float or "diffuse"
        Incidence angle of a beam, 0 to 89.9999 degrees, or isotropic radiance.
    max_stderr : float
        Largest standard error, 1e-6 to 0.5; see `target`.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`.  Discrete ordinates need point grains of one material
        that absorbs.
    target : {"irradiance", "absorptance"}
        Quantities to which `max_stderr` applies: all irradiances and absorptances, or only
        absorptances and reflectance, which need far fewer rays in thick, weakly absorbing media.
    max_rays, threads, kernel, progress
        As for `splits.spectrophotometer`.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength`` and ``depth``, relative to the incident irradiance:
        ``downward_irradiance`` and ``upward_irradiance``.  At the top, the latter is the
        reflectance.  Over ``wavelength`` and ``interval``, between successive depths:
        ``absorptance``, the fraction of the incident light that is absorbed there;
        ``absorptance_of_material``, the same by ``material``; and ``actinic_flux``, the mean path
        length of light in the interval, in grains and pores, divided by its thickness.  All with
        standard errors ``…_stderr``; irradiances and absorptances also with ``…_batches``, see
        `splits.core.uncertainty`.  Reflectance, absorptances, and the net irradiance at the bottom
        add up to 1.  The last interval of a semi-infinite medium extends below all depths; its mean
        actinic flux is 0 if it absorbs.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Absorption by the particles of a `splits.ParticleLayer` is treated as absorption along the path,
    which is equivalent.  It is attributed to the matrix of their layer.

    A ray through a grain that lies across a plane crosses the plane where it leaves the grain on
    the other side.  The absorptance of this grain belongs to the interval in which the ray enters
    it.  At a boundary between layers of different saturation, a plane records transmitted light;
    the light that the boundary reflects is included on neither side.

    The actinic flux is the absorptance times the path per absorbed light, which in particles and in
    dry layers of point grains is a property of the layer: actinic flux × thickness × absorption
    coefficient = absorptance, with both solvers.  Paths measure it in other media, where, as for
    the absorptance of each material, absorption is assumed to be evenly distributed along the path
    between planes.  Where single grains or pores absorb much of the light that crosses them, both
    are approximate; their errors include this (`splits.instruments.absorption_steps`).  The
    absorptance of an interval is not affected.  With discrete ordinates both follow exactly from
    the balance of light in each interval (`splits.discrete_ordinates.profiles`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    limit_irradiance = check_choice("target", target, ERROR_QUANTITIES) == ERROR_QUANTITIES[0]
    request = FluxRequest.from_arguments(
        medium, wavelength_nm, depth_m, incidence_deg, max_stderr, max_rays
    )
    run = RunOptions.from_arguments(seed, threads, kernel, progress)
    return simulate_flux(request, FluxTarget(limit_irradiance), run, solver)


class FluxRequest(NamedTuple):
    """Request for fluxes inside a medium, see `irradiance_profile`."""

    medium: Medium
    wavelengths: np.ndarray
    depths: np.ndarray
    incidence: float | str
    max_stderr: float
    max_rays: int

    @classmethod
    def from_arguments(
        cls,
        medium: Any,
        wavelength_nm: Any,
        depth_m: Any,
        incidence_deg: Any,
        max_stderr: Any,
        max_rays: Any,
    ) -> FluxRequest:
        """Return the request, after checking all values."""
        check_medium(medium, allow_semi_infinite=True)
        return cls(
            medium,
            check_wavelengths(wavelength_nm),
            _check_depths(depth_m, np.inf if medium.is_semi_infinite else medium.depth_m),
            check_incidence(incidence_deg),
            check_range("max_stderr", max_stderr, 1e-6, 0.5),
            check_integer("max_rays", max_rays, 1),
        )


def choose_flux_solver(
    solver: Any, medium: Medium, wavelengths: np.ndarray, max_stderr: float
) -> str:
    """Return the solver for fluxes, see `splits.instruments.solver.choose_solver`."""
    obstacle = None
    if solver != MONTE_CARLO:
        obstacle = find_obstacle(medium, wavelengths) or find_profile_obstacle(medium, wavelengths)
    return choose_solver(solver, [medium], wavelengths, obstacle, max_stderr=max_stderr)


def simulate_flux(
    request: FluxRequest, target: FluxTarget, run: RunOptions, solver: str
) -> xr.Dataset:
    """Return the dataset of `irradiance_profile` to an error, by a solver as given by the user."""
    medium, wavelengths, depths, incidence, max_stderr, max_rays = request
    chosen = choose_flux_solver(solver, medium, wavelengths, max_stderr)
    if chosen == DISCRETE_ORDINATES:
        dataset = solve_flux(
            medium, wavelengths, depths, incidence, max_stderr, target.limit_irradiance,
            run.threads,
        )  # fmt: skip
        dataset.attrs = _describe_request(request, target, run, chosen) | dataset.attrs
        reached = dataset.attrs["max_stderr_reached"]
        if solver != AUTO or reached <= max(max_stderr, LEAST_PATH_ERROR):
            return dataset
    traced_medium = prepare_medium(medium, wavelengths, depths, max_stderr, run)
    scene = build_scene(traced_medium.medium, incidence, False)
    scene = add_recording_planes(scene, depths.tolist())
    nodes = _choose_nodes(traced_medium, max_stderr, target.band_weights is not None)
    _check_memory(traced_medium, scene.layers.boundaries.size - 1, nodes)
    tally = FluxTally(nodes, traced_medium, scene, target)
    evaluation = simulate(scene, tally, StoppingRule(max_stderr, max_rays), run)
    attributes = {
        **_describe_request(request, target, run, MONTE_CARLO),
        "max_stderr_reached": evaluation.error,
        **tally.describe_run(evaluation.stop_reason),
    }
    if traced_medium.semi_infinite:
        attributes["truncation_depth_m"] = float(traced_medium.planes_m[-1])
    return make_flux_dataset(evaluation.estimate, traced_medium, wavelengths, attributes)


def _describe_request(
    request: FluxRequest, target: FluxTarget, run: RunOptions, solver: str
) -> dict[str, Any]:
    """Return the attributes of a request, once it is finished."""
    return {
        **run.make_attributes("Light inside", "irradiance_profile", request.medium),
        "incidence_deg": request.incidence,
        "max_stderr": request.max_stderr,
        "target": ERROR_QUANTITIES[0 if target.limit_irradiance else 1],
        "max_rays": request.max_rays,
        "solver": solver,
    }


def _choose_nodes(traced_medium: TracedMedium, max_stderr: float, has_bands: bool) -> IndexNodes:
    """Return the index nodes: more of them for bands, whose wavelengths share the rays."""
    index, interfaces = traced_medium.constants.indices, traced_medium.medium.list_interfaces()
    if has_bands:
        nodes = choose_nodes(index, interfaces, BAND_INTERPOLATION_FRACTION * max_stderr)
        if len(nodes.index) <= MAX_NODES:
            return nodes
    return choose_nodes(index, interfaces, INTERPOLATION_FRACTION * max_stderr)


def _check_depths(depth_m: Any, thickness: float) -> np.ndarray:
    """Return depths inside a sample of a thickness (m), after checking them."""
    depths = as_1d_array("depth_m", depth_m, "numbers in metres")
    if depths.size > MAX_DEPTHS:
        raise invalid("depth_m", f"{depths.size} depths", f"at most {MAX_DEPTHS}")
    hint = "top and bottom are always included"
    # Rounding may put a depth at the bottom on either side of it.
    at_bottom = np.isclose(depths, thickness, rtol=ROUNDING_TOLERANCE, atol=0.0)
    depths = np.where(at_bottom, thickness, depths)
    return check_axis(
        "depth_m", depths, 0.0, thickness, "m", open_low=True, open_high=True, hint=hint
    )


def _check_memory(traced_medium: TracedMedium, n_layers: int, nodes: IndexNodes) -> None:
    """Check that the sums of the tally fit into memory."""
    n_columns = traced_medium.constants.absorption.shape[1]
    n_node_rows = np.count_nonzero(nodes.weights)
    n_wavelengths = traced_medium.n_wavelengths
    n_values = N_BATCHES * n_layers * (n_columns + 3) * n_node_rows
    if n_values > MAX_TALLY_VALUES:
        max_wavelengths = max(1, n_wavelengths * MAX_TALLY_VALUES // n_values)
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths",
            f"at most {max_wavelengths} with these depths and layers",
            "use several calls",
        )  # fmt: skip
