"""Vertical profiles inside a medium: irradiance and absorptance, under a beam or under a sky."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

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
from splits.core.keywords import instrument
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import Variable, compute_weighted_error, make_variable
from splits.core.validation import ROUNDING_TOLERANCE, invalid
from splits.discrete_ordinates.applicability import find_obstacle, find_profile_obstacle
from splits.illumination.bands import Bands
from splits.illumination.sky import SkyInput
from splits.instruments.flux_dataset import make_flux_dataset, solve_flux
from splits.instruments.flux_media import TracedMedium, prepare_medium
from splits.instruments.flux_tally import FluxTally, FluxTarget
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    compute_band_error_weights,
    compute_band_weights,
    make_coverage_variable,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.solver import (
    AUTO,
    DISCRETE_ORDINATES,
    LEAST_PATH_ERROR,
    MONTE_CARLO,
    choose_solver,
)
from splits.media.kinds import check_medium
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

# --------------------------------------------------------------------------------------------------
# Vertical profiles of irradiance, and the absorptance between depths.

MAX_DEPTHS = 200
BAND_INTERPOLATION_FRACTION = 0.04
"""The same for errors of bands, for which more index nodes need hardly any more rays."""
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


@instrument
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
    are approximate; their errors include this (`splits.instruments.flux_media`).  The
    absorptance of an interval is not affected.  With discrete ordinates both follow exactly from
    the balance of light in each interval (`splits.discrete_ordinates.profiles`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    check_medium(medium, allow_semi_infinite=True)
    request = FluxRequest(
        medium, np.asarray(wavelength_nm), _check_depths(depth_m, medium), incidence_deg,
        max_stderr, max_rays,
    )  # fmt: skip
    run = RunOptions.start(seed, threads, kernel, progress)
    return simulate_flux(request, FluxTarget(target == "irradiance"), run, solver)


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
    obstacle = None
    if solver != MONTE_CARLO:
        obstacle = find_obstacle(medium, wavelengths) or find_profile_obstacle(medium, wavelengths)
    chosen = choose_solver(solver, [medium], wavelengths, obstacle, max_stderr=max_stderr)
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
        "target": "irradiance" if target.limit_irradiance else "absorptance",
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


def _check_depths(depth_m: Any, medium: Medium) -> np.ndarray:
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


# --------------------------------------------------------------------------------------------------
# Vertical profiles of radiation under a sky: irradiances at depths and absorbed power.

OUTPUT_VARIABLES = {
    "downward_irradiance": ("downward_irradiance", "depth", "downward irradiance"),
    "upward_irradiance": ("upward_irradiance", "depth", "upward irradiance"),
    "absorptance": ("absorbed_power", "interval", "absorbed power of the interval"),
}
"""Variables of an irradiance profile; names, dimensions and labels of those under a sky."""
PowerTarget = Annotated[
    Literal["absorbed_power", "irradiance"],
    Quantity("quantity to which the target error applies; irradiance means all of them"),
]
TotalIrradiance = Annotated[
    float | None,
    Quantity("incident irradiance at all wavelengths of the sky", "W m-2", low=0.0, open_low=True),
]


@instrument
def radiation_profile(
    medium: Medium,
    sky: SkyInput,
    wavelength_nm: Wavelengths | None = None,
    *,
    depth_m: ProfileDepths,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    target: PowerTarget = "absorbed_power",
    total_w_m2: TotalIrradiance = None,
    bands: Bands = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the irradiances inside a medium under a sky, and the power that it absorbs.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow` or `splits.Stack`; see `splits.irradiance_profile`.
    sky : Sky, str or mapping
        See `splits.sky`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium; its top and, if it is finite, its bottom
        are added.  Include the boundaries between the layers of a stack to obtain the power that
        each layer absorbs.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from the
        first of the sky to 2495.  Other light is ignored, see ``irradiance_covered``.
    max_stderr : float
        Largest standard error in any band, relative to the band's incident irradiance; see
        `target`.
    seed : int
        Non-negative; diffuse light uses the next one.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.irradiance_profile`.
    target : {"absorbed_power", "irradiance"}
        Quantities to which `max_stderr` applies: absorbed power and the light reflected at the
        top, or also irradiances at all depths.  In thick, weakly absorbing media the latter need
        many times as many rays, since light crosses each plane many times.
    total_w_m2 : float, optional
        Incident irradiance at all wavelengths of the sky (W m⁻²), to which it is scaled; the
        skies of SNICAR require it.
    bands : mapping or str, optional
        As for `splits.albedo`: ``{"photosynthetic": (400, 700)}``.
    max_rays : int
        Number of rays after which the simulation of sunlight, and of diffuse light, stops.
    threads : int, optional
        Default: every CPU that this process may use.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Over ``band``, the first of which is "broadband", and ``depth``: ``downward_irradiance`` and
        ``upward_irradiance`` (W m⁻²).  Over ``band`` and ``interval``, between successive depths:
        ``absorbed_power`` (W m⁻²).  All with standard errors ``…_stderr``, which include the error
        of interpolation between the wavelengths.  Over ``band`` ``irradiance_covered``, the
        fraction of the band's light within the wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.

    Examples
    --------
    >>> import splits
    >>> snow = splits.Snow.natural(specific_surface_area_m2_kg=30, depth_m=0.1)
    >>> sky = splits.sky("midlatitude_winter")
    >>> ds = splits.radiation_profile(
    ...     snow, sky, [400, 700, 1000], depth_m=[0.02], max_stderr=0.05, total_w_m2=400
    ... )
    >>> ds.absorbed_power.dims
    ('band', 'interval')
    """
    check_medium(medium, allow_semi_infinite=True)
    sky_spectrum = as_sky(sky).scale_to(total_w_m2)
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 2)
    run = RunOptions.start(seed, threads, kernel, progress)
    depths = _check_depths(depth_m, medium)
    request = FluxRequest(medium, wavelengths, depths, "diffuse", max_stderr, max_rays)
    named = sky_spectrum.make_bands(bands)
    sky_spectrum.check_bands(named, wavelengths)
    weights, band_irradiance = compute_band_weights(sky_spectrum, named, wavelengths)
    direct_fraction = sky_spectrum.compute_direct_fraction(wavelengths)
    targets = make_sky_targets(direct_fraction, weights, target == "irradiance")

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        component = request._replace(incidence=incidence)
        component_run = run._replace(seed=run.seed + number)
        return simulate_flux(component, targets[number], component_run, solver)

    dataset = mix_direct_and_diffuse(
        sky_spectrum, wavelengths, simulate_component, list(OUTPUT_VARIABLES)
    )
    error_weights = compute_band_error_weights(sky_spectrum, named, wavelengths)
    error_weights = error_weights * weights.sum(axis=1, keepdims=True)
    axes = {"wavelength": wavelengths}
    band_weights = xr.DataArray(weights, axes, ("band", "wavelength"))
    between = xr.DataArray(error_weights, axes, ("estimate", "band", "wavelength"))
    variables: dict[str, Variable] = {}
    for name, (label, dim, long_name) in OUTPUT_VARIABLES.items():
        mean = (band_weights * dataset[name]).sum("wavelength")
        # Band by band, which limits the memory for many depths.
        errors = [compute_weighted_error(dataset, name, one) for one in band_weights]
        squares = (xr.dot(between, dataset[name], dim="wavelength") ** 2).sum("estimate")
        error = (xr.concat(errors, "band") ** 2 + squares) ** 0.5
        values, stderr = (one.transpose("band", dim).values for one in (mean, error))
        variables |= make_variable(label, ("band", dim), values, stderr, long_name, "W m-2")
    variables |= make_coverage_variable(weights, band_irradiance)
    attributes = {
        **run.make_attributes("Sunlight inside", "radiation_profile", medium),
        **make_sky_attributes(sky_spectrum),
        "irradiance_w_m2": band_irradiance[0],
        "max_stderr": request.max_stderr,
        "target": target,
        "max_rays": request.max_rays,
        **dataset.attrs,
    }
    coordinates: dict[str, Any] = {
        name: dataset[name] for name in ("depth", "interval_top", "interval_bottom")
    }
    return xr.Dataset(variables, {**coordinates, "band": list(named)}, attributes)


def make_sky_targets(
    direct_fraction: np.ndarray, band_weights: np.ndarray, limit_irradiance: bool
) -> list[FluxTarget]:
    """Return the targets for sunlight and for diffuse light.

    Each may contribute to a band's variance in proportion to its fraction of the band's light.

    Parameters
    ----------
    direct_fraction : float, shape (wavelengths,)
        Fraction of direct sunlight.
    band_weights : float, shape (bands, wavelengths)
        Irradiance of each band by wavelength.
    limit_irradiance : bool
        Whether errors of irradiances are limited, too.
    """
    normalized = band_weights / band_weights.sum(axis=1, keepdims=True)
    targets = []
    for fraction in (direct_fraction, 1.0 - direct_fraction):
        band_fraction = (normalized * fraction).sum(axis=1)
        variance_fraction = np.where(band_fraction > 0.0, band_fraction, 1.0)
        targets.append(FluxTarget(limit_irradiance, normalized * fraction, variance_fraction))
    return targets
