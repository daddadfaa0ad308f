"""Vertical profiles of irradiance, and the absorptance between depths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr

from splits.core.arrays import check_axis
from splits.core.declarations import Quantity
from splits.core.inputs import (
    NUMBERS_SCHEMA,
    Incidence,
    Kernel,
    MaxRays,
    Numbers,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
    check_depths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    make_variable,
)
from splits.core.validation import ROUNDING_TOLERANCE, invalid
from splits.discrete_ordinates.applicability import find_profile_obstacle
from splits.discrete_ordinates.granular_stack import GranularStack
from splits.discrete_ordinates.profiles import IntervalProfile, LayerDivision, solve_profile
from splits.instruments.flux_media import (
    TracedMedium,
    bound_material_absorptance_error,
    compute_absorption_steps,
    prepare_medium,
)
from splits.instruments.flux_tally import (
    FluxEstimate,
    FluxResult,
    FluxTally,
    FluxTarget,
    bound_flux_interpolation_error,
    estimate_rare_event_error,
)
from splits.instruments.solver import (
    AUTO,
    LEAST_PATH_ERROR,
    MONTE_CARLO,
    SolverChoice,
    choose_solver,
)
from splits.kernels.records import N_BATCHES
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate
from splits.simulation.scene import add_recording_planes, build_scene
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FRACTION,
    MAX_NODES,
    IndexNodes,
    choose_nodes,
)
from splits.simulation.strata import StoppingRule
from splits.simulation.threads import limit_blas_threads

MAX_DEPTHS = 200
BAND_INTERPOLATION_FRACTION = 0.04
"""The same as `INTERPOLATION_FRACTION` for errors of bands, for which more index nodes need hardly
any more rays."""
ProfileDepths = Annotated[
    Numbers,
    Quantity(
        "depths, besides those of top and bottom", "m", check=check_depths, schema=NUMBERS_SCHEMA
    ),
]
ProfileTarget = Annotated[
    Literal["irradiance", "absorptance"],
    Quantity("quantity to which the target error applies; irradiance means all of them"),
]


@declare_function
def irradiance_profile(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: Incidence = 0.0,
    *,
    depth_m: ProfileDepths,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    target: ProfileTarget = "irradiance",
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the irradiances inside a medium, and the absorptance between depths.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow`, `splits.Stack` or `splits.ParticleLayer`; may be semi-infinite.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of a beam, 0 to 89.9999 degrees, or isotropic radiance.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  The top of the medium and,
        unless it is semi-infinite, its bottom are added.
    max_stderr : float
        Largest standard error, 1e-6 to 0.5; see `target`.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`.  Discrete ordinates need point grains of one material
        that absorbs.
    target : {"irradiance", "absorptance"}
        Quantities to which `max_stderr` applies: all irradiances and absorptances, or only
        absorptances and reflectance, which need far fewer rays in thick, weakly absorbing media.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
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
        standard errors ``…_stderr``; irradiances and absorptances by paths also with
        ``…_batches``, see `splits.core.uncertainty`.  Reflectance, absorptances, and the net
        irradiance at the bottom add up to 1.  The last interval of a semi-infinite medium extends
        below all depths; its mean actinic flux is 0 if it absorbs.

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
    are approximate; their errors include this (`splits.instruments.flux_media`).  The
    absorptance of an interval is not affected.  With discrete ordinates both follow exactly from
    the balance of light in each interval (`splits.discrete_ordinates.profiles`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    check_medium(medium, allow_semi_infinite=True)
    depths = check_profile_depths(depth_m, medium)
    run = RunOptions.start(seed, threads, kernel, progress)
    return simulate_flux(
        medium, np.asarray(wavelength_nm), depths, incidence_deg, max_stderr, max_rays,
        FluxTarget(target == "irradiance"), run, solver,
    )  # fmt: skip


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


def simulate_flux(
    medium: Medium, wavelengths: np.ndarray, depths: np.ndarray, incidence: float | str,
    max_stderr: float, max_rays: int, target: FluxTarget, run: RunOptions, solver: str,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `irradiance_profile` to an error, by a solver as given by the user."""
    choice = choose_solver(
        solver, [medium], wavelengths, max_stderr, run.threads, max_stderr=max_stderr,
        find_further_obstacle=lambda one: find_profile_obstacle(one, wavelengths),
    )  # fmt: skip
    if choice.stacks:
        dataset = solve_flux(
            medium, choice.stacks[0], wavelengths, depths, incidence, max_stderr,
            target.limit_irradiance,
        )  # fmt: skip
        reached = dataset.attrs["max_stderr_reached"]
        if solver == AUTO and reached > max(max_stderr, LEAST_PATH_ERROR):
            choice = SolverChoice.of_missed_error(reached, max_stderr)
    if choice.solver == MONTE_CARLO:
        traced_medium = prepare_medium(medium, wavelengths, depths, max_stderr, run)
        scene = build_scene(traced_medium.medium, incidence, False)
        scene = add_recording_planes(scene, depths.tolist())
        nodes = _choose_nodes(traced_medium, max_stderr, target.band_weights is not None)
        tally = FluxTally(nodes, traced_medium, scene, target)
        evaluation = simulate(scene, tally, StoppingRule(max_stderr, max_rays), run)
        dataset = make_flux_dataset(evaluation.estimate, traced_medium, wavelengths)
        dataset.attrs = {
            "max_stderr_reached": evaluation.error, **tally.describe_run(evaluation.stop_reason)
        }  # fmt: skip
        if traced_medium.semi_infinite:
            dataset.attrs["truncation_depth_m"] = float(traced_medium.planes_m[-1])
    dataset.attrs = {
        **run.make_attributes("Light inside", "irradiance_profile", medium),
        "incidence_deg": incidence,
        "max_stderr": max_stderr,
        "target": "irradiance" if target.limit_irradiance else "absorptance",
        "max_rays": max_rays,
        **choice.attributes,
        **dataset.attrs,
    }
    return dataset


def _choose_nodes(traced_medium: TracedMedium, max_stderr: float, has_bands: bool) -> IndexNodes:
    """Return the index nodes: more of them for bands, whose wavelengths share the rays."""
    index, interfaces = traced_medium.constants.indices, traced_medium.medium.list_interfaces()
    if has_bands:
        nodes = choose_nodes(index, interfaces, BAND_INTERPOLATION_FRACTION * max_stderr)
        if len(nodes.index) <= MAX_NODES:
            return nodes
    return choose_nodes(index, interfaces, INTERPOLATION_FRACTION * max_stderr)


# --------------------------------------------------------------------------------------------------
# Dataset of fluxes inside a medium, from paths.

QUANTITIES = {
    "downward_irradiance": (("depth",), "downward irradiance"),
    "upward_irradiance": (("depth",), "upward irradiance"),
    "absorptance": (("interval",), "absorptance of the interval"),
    "actinic_flux": (("interval",), "mean path over thickness"),
    "absorptance_of_material": (("interval", "material"), "absorptance of a material"),
}
"""Dimensions and labels of the quantities of a dataset, in their order."""


def make_flux_dataset(
    result: FluxResult,
    traced_medium: TracedMedium,
    wavelengths: np.ndarray,
) -> xr.Dataset:
    """Return the dataset of a result, without attributes, see `splits.irradiance_profile`.

    Parameters
    ----------
    result : FluxResult
    traced_medium : TracedMedium
    wavelengths : float, shape (wavelengths,)
        nm.
    """
    estimate, edges = result.estimate, traced_medium.edges_m
    results: list[tuple[np.ndarray, ...]] = []
    for batch_means, systematic_error in zip(
        estimate.split_quantities(estimate.quantities),
        estimate.split_quantities(result.systematic_error),
        strict=True,
    ):
        mean = batch_means.mean(axis=0)
        error = np.hypot(compute_batch_stderr(batch_means), systematic_error)
        deviations = (batch_means - mean) / np.sqrt(N_BATCHES * (N_BATCHES - 1))
        results.append((mean, error, deviations))
    # Actinic fluxes and absorptances of materials follow from path lengths.
    estimates = [one for one in (estimate, result.perturbed_estimate) if one is not None]
    absorption = traced_medium.constants.absorption[: traced_medium.n_wavelengths]
    optical_depth, rate = compute_absorption_steps(traced_medium.medium, absorption, edges)
    thickness = np.diff(edges)[:, np.newaxis]
    absorptance = estimate.split_quantities(estimate.quantities.mean(axis=0))[2]
    # The mean over a semi-infinite interval is 0 where anything absorbs; where nothing does, it is
    # the value far from the top.
    fluxes = [one.path_length / np.diff(traced_medium.planes_m)[:, np.newaxis] for one in estimates]
    if traced_medium.semi_infinite:
        for flux in fluxes:
            flux[:, -1] *= ~traced_medium.is_absorbing()
    ratio_error = traced_medium.path_ratio.find_largest_error(traced_medium.medium, edges)
    ratio_error *= np.abs(fluxes[0].mean(axis=0))
    # Light that no ray carries is absorbed, and has a path per absorbed light.
    longest = np.divide(
        1.0 / thickness, rate, out=np.full_like(absorptance, np.inf), where=rate > 0.0
    )
    unsampled_flux = result.unsampled_light * np.minimum(longest, 1.0)
    flux_error = _combine_errors(fluxes, result, unsampled_flux, ratio_error)
    if traced_medium.semi_infinite:
        flux_error[-1] *= ~traced_medium.is_absorbing()
    scored = estimate.material_absorptance.sum(axis=2)
    unscored = estimate.split_quantities(estimate.quantities)[2] - scored
    scatter = np.where(scored.mean(axis=0) > 0.0, 2.0 * compute_batch_stderr(unscored), 0.0)
    unscored_bound = np.maximum(np.abs(unscored.mean(axis=0)) - scatter, 0.0)
    columns = list(traced_medium.material_columns.values())
    by_material = [compute_absorbed_fractions(one, columns) for one in estimates]
    material_bound = bound_material_absorptance_error(
        optical_depth, by_material[0].mean(axis=0), absorptance, unscored_bound
    )
    unsampled_light = result.unsampled_light[:, np.newaxis]
    material_error = _combine_errors(by_material, result, unsampled_light, material_bound)
    results += [(fluxes[0].mean(axis=0), flux_error), (by_material[0].mean(axis=0), material_error)]
    return _make_dataset(results, wavelengths, edges, list(traced_medium.material_columns))


def _make_dataset(
    results: Sequence[tuple[np.ndarray, ...]], wavelengths: np.ndarray, edges: np.ndarray,
    materials: Sequence[str],
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of results.

    Parameters
    ----------
    results : sequence of tuple of float, shape (..., wavelengths)
        Values of the `QUANTITIES`, and their errors; by paths, deviations by batch of the first
        three.
    wavelengths : float, shape (wavelengths,)
        nm.
    edges : float, shape (intervals + 1,)
        Edges of the intervals (m).
    materials : sequence of str
    """
    variables: dict[str, Variable] = {}
    for (name, (axes, label)), (mean, error, *deviations) in zip(
        QUANTITIES.items(), results, strict=True
    ):
        dims = ("wavelength", *axes)
        values, stderr = (np.moveaxis(one, -1, 0) for one in (mean, error))
        by_batch = np.moveaxis(deviations[0], -1, 1) if deviations else None
        variables |= make_variable(name, dims, values, stderr, label, deviations=by_batch)
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "depth": (
            "depth", edges[np.isfinite(edges)],
            {"long_name": "depth", "units": "m", "positive": "down", "standard_name": "depth"},
        ),
        "interval_top": ("interval", edges[:-1], {"long_name": "top", "units": "m"}),
        "interval_bottom": ("interval", edges[1:], {"long_name": "bottom", "units": "m"}),
        "material": ("material", np.array(materials), {"long_name": "material"}),
    }  # fmt: skip
    return xr.Dataset(variables, coordinates)


def _combine_errors(
    by_estimate: Sequence[np.ndarray],
    result: FluxResult,
    unsampled_light: np.ndarray,
    step_error: np.ndarray,
) -> np.ndarray:
    """Return all errors of a quantity from path lengths, added in quadrature.

    Parameters
    ----------
    by_estimate : sequence of float, shape (N_BATCHES, ..., wavelengths)
        Means by batch; then, with truncation, those with a more absorbing substrate.
    result : FluxResult
    unsampled_light : float, shape (..., wavelengths)
        See `estimate_rare_event_error`.
    step_error : float, shape (..., wavelengths)
        Bound on the effect of absorption in steps.
    """
    batch_means, *perturbed = by_estimate
    nonstatistical_error = np.hypot(
        bound_flux_interpolation_error(result.interpolation_bound, batch_means.mean(axis=0)),
        estimate_rare_event_error(batch_means, unsampled_light),
    )
    errors = [compute_batch_stderr(batch_means), nonstatistical_error, step_error]
    errors += [(batch_means - one).mean(axis=0) for one in perturbed]
    return np.sqrt(np.sum(np.square(errors), axis=0))


def compute_absorbed_fractions(estimate: FluxEstimate, columns: Sequence[int]) -> np.ndarray:
    """Return the absorptance of each material; the sum over materials is the total absorptance.

    The shape is (N_BATCHES, intervals, materials, wavelengths); the materials' parts vary by batch
    to first order.  Where no path scores an interval, the fractions are those of the whole sample,
    and equal for all materials where none scores that either; the errors include this
    (`bound_material_absorptance_error`).

    Parameters
    ----------
    estimate : FluxEstimate
    columns : sequence of int
        Columns of the materials.
    """
    parts = estimate.material_absorptance[:, :, columns]
    total_scored = parts.sum(axis=2, keepdims=True)
    mean_parts, mean_scored = parts.mean(axis=0), total_scored.mean(axis=0)
    sample_parts = mean_parts.sum(axis=0, keepdims=True)
    sample_total = sample_parts.sum(axis=1, keepdims=True)
    equal = np.full_like(sample_parts, 1.0 / len(columns))
    sample_fraction = np.divide(sample_parts, sample_total, out=equal, where=sample_total > 0.0)
    is_scored = mean_scored > 0.0
    fraction = np.divide(
        mean_parts, mean_scored, out=np.broadcast_to(sample_fraction, mean_parts.shape).copy(),
        where=is_scored,
    )  # fmt: skip
    absorbed = estimate.split_quantities(estimate.quantities)[2][:, :, np.newaxis]
    mean_absorbed = absorbed.mean(axis=0)
    scale = np.divide(mean_absorbed, mean_scored, out=np.zeros_like(mean_absorbed), where=is_scored)
    return absorbed * fraction + scale * (parts - fraction * total_scored)


# --------------------------------------------------------------------------------------------------
# Fluxes inside layers of grains by discrete ordinates, in the form of simulations.


def solve_flux(
    medium: Medium, whole: GranularStack, wavelengths: np.ndarray, depths: np.ndarray,
    incidence: float | str, max_stderr: float, limit_irradiance: bool,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.irradiance_profile`, with the attributes of the solution.

    Parameters
    ----------
    medium : Medium
    whole : GranularStack
        The medium in the form of discrete ordinates.
    wavelengths, depths : float, shape (wavelengths,) and (depths,)
        nm; m, inside the medium.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    max_stderr : float
        Determines the number of streams.
    limit_irradiance : bool
        Whether it applies to irradiances, too.
    """
    edges = np.array([0.0, *depths, medium.depth_m])
    parts, geometry = divide_medium(medium, whole, edges)
    cosine = None if incidence == "diffuse" else float(np.cos(np.radians(float(incidence))))
    with limit_blas_threads():
        profile, truncation, optics_error, n_streams = solve_profile(
            parts, geometry, cosine, max_stderr, limit_irradiance
        )
    error = IntervalProfile(*map(np.hypot, truncation, optics_error))
    thickness = np.diff(edges)[:, np.newaxis]
    results: list[tuple[np.ndarray, ...]] = [
        *zip(profile[:3], error[:3], strict=True),
        (profile.path_length / thickness, error.path_length / thickness),
        (profile.by_material, error.by_material),
    ]
    reached = error.find_largest(limit_irradiance)
    dataset = _make_dataset(results, wavelengths, edges, list(medium.material_columns))
    dataset.attrs = {
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= max_stderr else "solver_error",
        "rays": 0,
        "streams": n_streams,
        "truncation_error": truncation.find_largest(limit_irradiance),
        "optics_error": optics_error.find_largest(limit_irradiance),
    }
    return dataset


def divide_medium(
    medium: Medium, whole: GranularStack, edges: np.ndarray
) -> tuple[GranularStack, LayerDivision]:
    """Return a medium and its snowpack divided at the edges of intervals (m)."""
    layers = medium.scene_layers
    boundaries = np.cumsum([layer.depth_m for layer in layers])[:-1]
    begin = edges[:-1]
    # Rounding may put a depth at a boundary on either side of it.
    known = np.isclose(boundaries[:, np.newaxis], edges, rtol=ROUNDING_TOLERANCE, atol=0.0)
    for boundary, same in zip(boundaries, known, strict=True):
        begin = np.where(same[:-1], boundary, begin)
    starts = np.union1d(begin, boundaries)
    parts, owners = whole.divide(starts)
    fractions, attenuation = (
        np.array([getattr(layer, name) for layer in layers])
        for name in ("pore_fraction", "attenuation_per_m")
    )
    return parts, LayerDivision(fractions, attenuation, owners, np.searchsorted(starts, begin))
