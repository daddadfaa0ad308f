"""Virtual goniophotometer: angular distributions of reflected and transmitted light."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import (
    AZIMUTH_ANGLE,
    MAX_DATASET_VALUES,
    POLAR_ANGLE,
    Incidence,
    Kernel,
    MaxRays,
    Numbers,
    Rays,
    RelativeError,
    Seed,
    Solver,
    Threads,
    Wavelengths,
    describe_numbers,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import ErrorTarget, Variable, make_variable
from splits.core.validation import check_integer, invalid
from splits.discrete_ordinates.applicability import find_direction_obstacle
from splits.instruments.angular_estimate import AngularEstimate, AngularTally, make_direction_grid
from splits.instruments.angular_tallies import (
    DEFAULT_N_BINS,
    MAX_DEGREE,
    AngularBinTally,
    ExpansionTally,
    compute_bin_centres,
)
from splits.instruments.detector_tally import DetectorTally, get_detected_layers, make_detectors
from splits.instruments.solver import (
    AUTO,
    MONTE_CARLO,
    PHASE_FUNCTION_FACTOR,
    SolverChoice,
    choose_solver,
    solve_angular_distributions,
)
from splits.instruments.spectrophotometer import MAX_ATTEMPTS, SpectralRequest
from splits.kernels.records import make_basis
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.deep_medium import ERROR_BUDGET_FRACTION, THEORY_UNCERTAINTY, TruncatedMedium
from splits.simulation.engine import simulate
from splits.simulation.run_options import (
    RunOptions,
    make_incidence_coordinate,
    make_wavelength_coordinate,
)
from splits.simulation.scene import (
    IncidentStokes,
    build_scene,
    check_stokes,
    compute_material_constants,
    compute_optical_constants,
    describe_polarization,
    get_ground_albedo,
)
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.strata import StoppingRule

# --------------------------------------------------------------------------------------------------
# Dataset of a goniophotometer.

BEAM_DISTRIBUTIONS = {
    "brdf": ("bidirectional reflectance distribution function", "sr-1", 0, 1.0),
    "btdf": ("bidirectional transmittance distribution function", "sr-1", 1, 1.0),
    "reflectance_factor": ("bidirectional reflectance factor", "1", 0, np.pi),
}
DIFFUSE_DISTRIBUTIONS = {
    "reflectance_factor": ("hemispherical-directional reflectance factor", "1", 0, np.pi),
    "transmittance_factor": ("hemispherical-directional transmittance factor", "1", 1, np.pi),
}
"""Labels, units and sides of distributions, and factors on the estimate, by illumination."""
BEAM_TOTALS = {
    "reflectance": ("directional-hemispherical reflectance", "hemispherical", 0),
    "transmittance": ("directional-hemispherical transmittance", "hemispherical", 1),
    "specular_reflectance": ("reflectance without scattering", "unscattered", 0),
    "direct_transmittance": ("transmittance without scattering", "unscattered", 1),
}
DIFFUSE_TOTALS = {
    "reflectance": ("bihemispherical reflectance", "hemispherical", 0),
    "transmittance": ("bihemispherical transmittance", "hemispherical", 1),
}
"""Labels of hemispherical quantities, their fields in the estimate, and sides, by illumination."""
STOKES_LABELS = {
    "dolp": ("degree of linear polarization", "1"),
    "aolp": ("angle of linear polarization", "degree"),
}
"""Labels and units of variables of polarized light other than Stokes parameters."""
STOKES_SIDES = {"brdf": "reflected", "btdf": "transmitted"}


def make_angular_dataset(
    estimate: AngularEstimate,
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    wavelengths: np.ndarray,
    angles: tuple[np.ndarray, np.ndarray],
    attributes: dict[str, Any],
    undefined: Collection[str] = (),
) -> xr.Dataset:
    """Return the dataset of an estimate.

    Parameters
    ----------
    estimate : AngularEstimate
    stokes : dict
        Variables of polarized light and their errors by name, shape (wavelengths, directions), see
        `splits.instruments.angular_tallies.make_stokes_variables`.
    wavelengths : float, shape (wavelengths,)
        nm.
    angles : (float, float)
        Polar and azimuth angles (degrees); azimuth runs fastest in directions.
    attributes : dict
        With the incidence.
    undefined : collection of str
        Variables that are left out.
    """
    polar, azimuth = angles
    grid = ("wavelength", "polar_deg", "azimuth_deg")
    shape = (len(wavelengths), len(polar), len(azimuth))
    is_diffuse = attributes["incidence_deg"] == "diffuse"
    distributions: dict[str, tuple[str, str, int, Any]] = {
        **(DIFFUSE_DISTRIBUTIONS if is_diffuse else BEAM_DISTRIBUTIONS),
    }
    variables: dict[str, Variable] = {}
    for name, (long_name, units, side, factor) in distributions.items():
        mean = (factor * estimate.mean[side]).reshape(shape)
        stderr = (factor * estimate.stderr[side]).reshape(shape)
        variables |= make_variable(name, grid, mean, stderr, long_name, units)
    mean, stderr = (one.reshape(shape) for one in (estimate.anisotropy, estimate.anisotropy_stderr))
    variables |= make_variable("anisotropy_factor", grid, mean, stderr, "anisotropy factor")
    for name, (values, error) in stokes.items():
        function, _, symbol = name.partition("_")
        label, units = STOKES_LABELS.get(symbol, (f"Stokes {symbol.upper()}", "sr-1"))
        label = f"{label} of {STOKES_SIDES[function]} light"
        variables |= make_variable(
            name, grid, values.reshape(shape), error.reshape(shape), label, units
        )
    totals = DIFFUSE_TOTALS if is_diffuse else BEAM_TOTALS
    for name, (long_name, field, side) in totals.items():
        mean, stderr = (getattr(estimate, one)[side] for one in (field, f"{field}_stderr"))
        variables |= make_variable(name, "wavelength", mean, stderr, long_name)
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "polar_deg": ("polar_deg", polar, POLAR_ANGLE.attributes),
        "azimuth_deg": ("azimuth_deg", azimuth, AZIMUTH_ANGLE.attributes),
        "incidence_deg": make_incidence_coordinate(attributes["incidence_deg"]),
    }
    # Without a BTDF, its polarization is undefined, too.
    kept = {
        name: variable
        for name, variable in variables.items()
        if name.removesuffix("_stderr") not in undefined
        and not ("btdf" in undefined and name.startswith("btdf"))
    }
    return xr.Dataset(kept, coordinates, attributes)


# --------------------------------------------------------------------------------------------------
# Virtual goniophotometer: angular distributions of reflected and transmitted light.

POLAR_DEG = tuple(np.arange(0.0, 90.0, 2.5).tolist())
AZIMUTH_DEG = tuple(np.arange(0.0, 360.0, 5.0).tolist())

MAX_CONVERGED_POLAR_DEG = 82.5
"""Largest polar angle at which the requested error must be reached."""
DEFAULT_BIN_RAYS = 1_000_000
TARGET_SIDES = {"brdf": 0, "btdf": 1}
TRANSMITTED_VARIABLES = ("btdf", "transmittance_factor", "transmittance", "direct_transmittance")
"""Variables of light that leaves below, which is undefined over a ground."""

INTERPOLATION_FRACTION = 0.05
"""Bound on the error of a reflectance from interpolation between refractive indices, relative to
the requested relative error."""


AngularEstimator = Annotated[
    Literal["expansion", "bins", "next_event"], Quantity("how exiting rays become results")
]
AngularTarget = Annotated[
    Literal["brdf", "btdf"], Quantity("quantity to which the target error applies")
]


def _check_n_bins(key: str, n_bins: Any) -> tuple[int, int]:
    try:
        polar, azimuth = (check_integer(key, n, 1, 1000) for n in n_bins)
    except (TypeError, ValueError):
        raise invalid(key, n_bins, "two whole numbers from 1 to 1000") from None
    return polar, azimuth


ViewPolarAngles = Annotated[
    Numbers | None,
    replace(POLAR_ANGLE, long_name=f"{POLAR_ANGLE.long_name}, by default 0 to 87.5 by 2.5"),
]
ViewAzimuths = Annotated[
    Numbers | None,
    replace(AZIMUTH_ANGLE, long_name=f"{AZIMUTH_ANGLE.long_name}, by default 0 to 355 by 5"),
]
BinNumbers = Annotated[
    tuple[int, int],
    Quantity(
        "numbers of angular bins from the horizon to the zenith, and in azimuth, by default 18, 72",
        check=_check_n_bins,
        schema=describe_numbers("polar", "azimuth", type="integer", minimum=1, maximum=1000),
    ),
]  # fmt: skip


def check_bins(estimator: str, polar_deg: Any, azimuth_deg: Any, n_bins: Any) -> None:
    """Reject directions beside bins, and numbers of bins without bins."""
    for key, given in (("polar_deg", polar_deg), ("azimuth_deg", azimuth_deg)):
        if estimator == "bins" and given is not None:
            values = np.asarray(given).tolist()
            raise invalid(key, values, "left out with bins", "n_bins sets their number")
    if estimator != "bins" and n_bins is not None:
        raise invalid("n_bins", n_bins, "left out without estimator = bins")


@declare_function
def goniophotometer(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: Incidence = 0.0,
    *,
    relative_stderr: RelativeError = 0.02,
    rays: Rays = None,
    solver: Solver = "auto",
    target: AngularTarget = "brdf",
    polar_deg: ViewPolarAngles = None,
    azimuth_deg: ViewAzimuths = None,
    estimator: AngularEstimator = "expansion",
    n_bins: BinNumbers | None = None,
    stokes: IncidentStokes = False,
    seed: Seed = 1,
    max_rays: MaxRays = 1_000_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the BRDF and the BTDF of a medium under a beam, or its factors under diffuse light.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow` or `splits.ParticleLayer`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of the beam, 0 to 89.9999 degrees, or isotropic radiance (for the estimator
        ``expansion`` only).  Above 89.9 degrees a run takes minutes, because few sampled grains fit
        below the boundary.
    relative_stderr : float
        Largest standard error relative to the value, 1e-4 to 0.5, for polar angles up to
        `splits.instruments.goniophotometer.MAX_CONVERGED_POLAR_DEG`; with ``next_event``, for
        all.  It has no effect on bins.
    rays : int, optional
        Number of rays, rounded up; by default the number that `relative_stderr` requires.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        "discrete_ordinates" solves the equation of radiative transfer in plane layers of point
        grains, such as modelled natural snow (`splits.Snow.natural`), which may be semi-infinite:
        see docs/theory/discrete-ordinates.md.  Wet grains other than natural snow, grains of finite
        extent, `rays` and other estimators than "expansion" are rejected, or simulated with paths
        under "auto".
    target : {"brdf", "btdf"}
        The function to which the error applies; wavelengths without light there are ignored.
    polar_deg : array_like
        Angles from the vertical, 0 to below 90 degrees, strictly increasing: from straight up for
        reflected light, and from straight down for transmitted light.
    azimuth_deg : array_like
        Angles from the direction in which the beam travels, 0 to below 360 degrees, strictly
        increasing, for reflected and transmitted light.  The principal plane is 0 (forward) and 180
        (backward).
    estimator : {"expansion", "bins", "next_event"}
        "expansion" uses orthonormal polynomials over the hemisphere.  "bins" counts rays in angular
        bins of equal solid angle, the collectors of the papers, with `rays` rays, a million by
        default.  "next_event", for particle layers and stacks of these under a smooth surface,
        is next-event estimation: every scattering contributes to each direction, so the cost is
        proportional to the number of directions.
    n_bins : (int, int)
        Numbers of bins in polar angle and in azimuth, by default 18 and 72.  Results are at the
        centres of the bins, so `polar_deg` and `azimuth_deg` must be left out.
    stokes : bool or array_like
        Whether polarization is traced, with the estimators "bins" and "next_event", or the Stokes
        vector (I, Q, U, V) of the incident light, with the plane of incidence as reference; True is
        unpolarized light.  Layers of particles need ``polarized=True``, which traces polarization
        without this keyword, too; see docs/theory/polarization.md.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    max_rays : int
        Number of rays after which a run to an error stops.  The attribute ``stop_reason`` is
        "converged", "max_rays", "fixed_rays" (where `rays` or bins set their number), "no_light"
        (where none reached the directions), "solver_error" (where discrete ordinates do not reach
        the error), "max_degree" or "unresolved_lobe".  "max_degree" means
        that the light is in lobes too narrow for the polynomials, which more rays do not change;
        use bins.  "unresolved_lobe" means that the run has converged except for directions in a
        lobe, where terms that are insignificant individually keep the reported error above the
        requested one (see ``relative_stderr_reached``); request a smaller error.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress` of relative
        errors.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``, ``polar_deg`` and ``azimuth_deg``: ``brdf`` and ``btdf`` (1/sr) of
        scattered light; the ``reflectance_factor`` π·BRDF; the ``anisotropy_factor``, π·BRDF
        divided by the reflectance, 0 without light.  Its error allows for what both have in common,
        except for bins and next-event estimation, where it is that of the BRDF.
        Over ``wavelength``: ``reflectance`` and ``transmittance`` of all light, and their
        unscattered parts, which leave as collimated beams: ``specular_reflectance`` and
        ``direct_transmittance``.  All with their standard errors ``…_stderr``.

        Next-event estimation and bins of polarized light add ``brdf_q``, ``brdf_u``, ``brdf_v``,
        Stokes parameters with Q > 0 along the plane that contains the normal; ``brdf_dolp`` and
        ``brdf_aolp``, degree (0 to 1) and angle (degrees from that plane, 0 to 180) of linear
        polarization, see `splits.instruments.angular_tallies`; and the same of the BTDF.

        Over a ground of a single albedo in contact with a layer of particles, the BTDF is that of
        the light that the ground absorbs, a fraction of the light that arrives there, at angles
        within the layer; next-event estimation does not compute it.

        Under diffuse light there is no BRDF: ``reflectance_factor`` is then the
        hemispherical-directional one, of all light, ``transmittance_factor`` the same below, and
        ``reflectance`` and ``transmittance`` are bihemispherical.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 7; Budak & Grimailo 2020, Eqs 4-5; Nicodemus et al. (1977) for the
    terms.
    """
    check_medium(medium, allow_semi_infinite=solver != MONTE_CARLO)
    wavelengths, incidence = np.asarray(wavelength_nm), incidence_deg
    ground_albedo = get_ground_albedo(medium)
    has_ground = medium.reflecting_ground is not None and ground_albedo is None
    if has_ground and target == "btdf":
        raise invalid("target", target, "brdf over a ground", "no light leaves through a ground")
    run = RunOptions.start(seed, threads, kernel, progress)
    polarization = check_stokes(stokes, medium, incidence)
    if isinstance(incidence, str) and estimator != "expansion":
        allowed = "an angle for this estimator"
        raise invalid("incidence_deg", incidence, allowed, "expansion allows it")
    if stokes is not False and estimator == "expansion":
        has_grains = any(layer.has_grains for layer in medium.scene_layers)
        allowed = "bins with stokes" if has_grains else "bins or next_event with stokes"
        raise invalid("estimator", estimator, allowed)
    check_bins(estimator, polar_deg, azimuth_deg, n_bins)
    bins: Any = (n_bins or DEFAULT_N_BINS) if estimator == "bins" else None
    if bins is not None:
        polar, azimuth = compute_bin_centres(bins)
    else:
        polar = np.asarray(POLAR_DEG if polar_deg is None else polar_deg)
        azimuth = np.asarray(AZIMUTH_DEG if azimuth_deg is None else azimuth_deg)
    n_directions = len(polar) * len(azimuth)
    if len(wavelengths) * n_directions > MAX_DATASET_VALUES:
        raise invalid(
            "wavelength_nm", f"{len(wavelengths)} wavelengths",
            f"at most {MAX_DATASET_VALUES // n_directions}",
            f"{n_directions} directions each; {MAX_DATASET_VALUES} values fit into memory",
        )  # fmt: skip
    direction_mask = make_direction_mask(polar, azimuth) | (estimator == "next_event")
    error_target = ErrorTarget(TARGET_SIDES[target], direction_mask)
    obstacle = "a number of rays needs paths" if rays is not None else None
    if estimator != "expansion":
        obstacle = f"the estimator {estimator} needs paths"
    choice = choose_solver(
        solver, [medium], wavelengths, PHASE_FUNCTION_FACTOR * relative_stderr, run.threads,
        obstacle=obstacle, find_further_obstacle=find_direction_obstacle,
    )  # fmt: skip
    estimate: AngularEstimate
    polarized: Mapping[str, tuple[np.ndarray, np.ndarray]] = {}
    undefined: tuple[str, ...] = TRANSMITTED_VARIABLES if has_ground else ()
    if choice.stacks:
        ((estimate, described),) = solve_angular_distributions(
            choice.stacks[0], polar, azimuth, relative_stderr, error_target, [incidence]
        )
        # Paths need a finite medium.
        is_missed = described["stop_reason"] != "converged"
        if solver == AUTO and is_missed and not medium.is_semi_infinite:
            choice = SolverChoice.of_missed_error(
                estimate.compute_max_error(error_target), relative_stderr
            )
    if choice.solver == MONTE_CARLO:
        check_medium(medium)
        scene = build_scene(medium, incidence, False, polarization, ground_albedo)
        if estimator == "next_event":
            layers = get_detected_layers(medium)
            detectors = make_detectors(layers, scene, polar, azimuth)
            tally: AngularTally = DetectorTally(
                layers, scene, detectors, error_target, len(wavelengths)
            )
        else:
            is_counted = scene.ground_albedo is None
            compute = compute_optical_constants if is_counted else compute_material_constants
            index, absorption = compute(medium, wavelengths)
            tolerance = INTERPOLATION_FRACTION * relative_stderr
            nodes = choose_nodes(index, medium.list_interfaces(), tolerance)
            if bins is not None:
                tally = AngularBinTally(nodes, absorption, bins, scene.stokes is not None)
            else:
                directions = make_direction_grid(polar, azimuth, make_basis(MAX_DEGREE))
                tally = ExpansionTally(nodes, absorption, directions, incidence, error_target)
        # Bins have no error that a run could reach.
        is_fixed = rays is not None or bins is not None
        limit = (rays or DEFAULT_BIN_RAYS) if is_fixed else max_rays
        stop = StoppingRule(relative_stderr, limit, fixed=is_fixed)
        evaluation = simulate(scene, tally, stop, run)
        estimate, polarized = evaluation.estimate, tally.make_stokes()
        undefined += tally.undefined_variables
        described = {
            "degree": estimate.degree[error_target.side],
            **tally.describe_run(evaluation.stop_reason),
        }
    attributes = {
        **run.make_attributes("Virtual goniophotometer", "goniophotometer", medium),
        "incidence_deg": incidence,
        **describe_polarization(polarization),
        "estimator": estimator,
        "target": target,
        "relative_stderr_reached": estimate.compute_max_error(error_target),
        "relative_stderr": relative_stderr,
        "max_rays": max_rays,
        **choice.attributes,
        **described,
    }
    return make_angular_dataset(
        estimate, polarized, wavelengths, (polar, azimuth), attributes, undefined
    )


def make_direction_mask(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Return the directions of the stopping rule: all if only steeper ones are requested."""
    low = polar <= MAX_CONVERGED_POLAR_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


# --------------------------------------------------------------------------------------------------
# Simulation of reflectance factors and reflectances together, of media that share paths.

MAX_ESCAPE_FACTOR = 1.25
"""Radiance of light that escapes from a great depth, over that of isotropic light of equal flux:
(2 + 3 µ)/4 at the normal (diffusion theory)."""


def simulate_directions(
    path_sharing: PathSharingMedia,
    truncation: TruncatedMedium | None,
    request: SpectralRequest,
    polar_deg: np.ndarray,
    azimuth_deg: np.ndarray,
    target: ErrorTarget,
) -> tuple[AngularEstimate, int, str]:
    """Return reflectance factors to an absolute error, with the reflectance of the same paths.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    truncation : TruncatedMedium or None
        Their truncation.
    request : SpectralRequest
        `max_stderr` applies to the target.
    polar_deg, azimuth_deg : float, shape (angles,)
    target : ErrorTarget
        With absolute errors.

    Returns
    -------
    AngularEstimate
        Rows are the wavelengths of one medium after the other.
    rays : int
    stop_reason : str
    """
    traced = path_sharing if truncation is None else truncation.path_sharing
    rows = SpectralRows.from_media(traced, request.wavelengths)
    above_truncation = (1.0 - (MAX_ESCAPE_FACTOR * ERROR_BUDGET_FRACTION) ** 2) ** 0.5
    max_error = request.max_stderr * (1.0 if truncation is None else above_truncation)
    directions = make_direction_grid(polar_deg, azimuth_deg, make_basis(MAX_DEGREE))
    scene = build_scene(traced.media[0], request.incidence, False)
    for _ in range(MAX_ATTEMPTS):
        nodes = choose_nodes(rows.index, rows.interfaces, INTERPOLATION_FRACTION * max_error)
        tally = ExpansionTally(nodes, rows.absorption, directions, request.incidence, target)
        evaluation = simulate(scene, tally, StoppingRule(max_error, request.max_rays), request.run)
        estimate: AngularEstimate = evaluation.estimate
        if truncation is None:
            break
        estimate = _add_truncation_error(estimate, truncation)
        reached = estimate.compute_max_error(target) <= request.max_stderr
        if reached or evaluation.stop_reason != "converged":
            break
        max_error *= 0.5
    return estimate, tally.n_rays, evaluation.stop_reason


def _add_truncation_error(
    estimate: AngularEstimate, truncation: TruncatedMedium
) -> AngularEstimate:
    """Return an estimate with the error of the light from below the truncation depth."""
    n_media = truncation.path_sharing.n_reported
    entering = estimate.hemispherical[1]
    error = THEORY_UNCERTAINTY * entering * truncation.escape_probability[:n_media].ravel()
    hemispherical_stderr = estimate.hemispherical_stderr.copy()
    hemispherical_stderr[0] = np.hypot(hemispherical_stderr[0], error)
    by_direction = MAX_ESCAPE_FACTOR / np.pi * error[:, np.newaxis]
    stderr = estimate.stderr.copy()
    stderr[0] = np.hypot(stderr[0], by_direction)
    # Missing light changes the reflectance of the anisotropy factor, too.
    relative = (error / np.maximum(estimate.hemispherical[0], np.finfo(float).tiny))[:, np.newaxis]
    change = np.maximum(MAX_ESCAPE_FACTOR, estimate.anisotropy) * np.minimum(relative, 1.0)
    return estimate._replace(
        stderr=stderr,
        hemispherical_stderr=hemispherical_stderr,
        anisotropy_stderr=np.hypot(estimate.anisotropy_stderr, change),
    )
