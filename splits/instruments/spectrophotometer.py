"""Virtual spectrophotometer: directional-hemispherical reflectance and transmittance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import (
    ANGLE_SCHEMA,
    DIFFUSE,
    INCIDENCE_ANGLE,
    Kernel,
    MaxRays,
    Numbers,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
    check_incidence,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import check_relations, invalid, to_text_keys
from splits.discrete_ordinates.applicability import find_parameter_obstacle
from splits.discrete_ordinates.snow_packs import SpectraSolution
from splits.instruments.snow_packs import (
    PACK_DIM,
    SUN,
    SUN_OF_EACH,
    choose_incidence,
    choose_pack_solver,
    label_snow_packs,
    make_pack_estimate,
    solve_snow_packs,
)
from splits.instruments.solver import (
    SolverChoice,
    choose_solver,
    solve_estimate,
    solve_parameter_derivatives,
)
from splits.kernels.scene import NO_GROUND
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.media.snow_pack_input import ZENITH_KEY
from splits.media.snow_packs import SnowPacks
from splits.simulation.deep_medium import (
    ERROR_BUDGET_FRACTION,
    TruncatedMedium,
    truncate_deep_medium,
)
from splits.simulation.derivatives import (
    NO_PERTURBATIONS,
    Perturbations,
    add_jacobian,
    check_jacobian,
    compute_finite_difference,
)
from splits.simulation.engine import simulate
from splits.simulation.run_options import (
    RunOptions,
    make_incidence_coordinate,
    make_wavelength_coordinate,
)
from splits.simulation.scene import (
    IncidentPolarization,
    IncidentStokes,
    build_scene,
    check_stokes,
    describe_polarization,
)
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows, check_path_sharing
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FRACTION,
    choose_nodes,
    make_separate_nodes,
)
from splits.simulation.spectral_tally import (
    QUANTITY_LABELS,
    SIDE_QUANTITIES,
    Derivatives,
    SpectralEstimate,
    SpectralTally,
)
from splits.simulation.strata import StoppingRule

SpectralEstimator = Annotated[
    Literal["spectral", "analog"], Quantity("how exiting rays become results")
]


def _check_snow_pack_incidence(key: str, value: Any) -> Any:
    # Snowpacks of a season have angles of their own, which `choose_incidence` checks.
    is_single = value != SUN if isinstance(value, str) else np.ndim(value) == 0
    return check_incidence(key, value) if is_single else value


SnowPackIncidence = Annotated[
    Numbers | str,
    replace(
        INCIDENCE_ANGLE, check=_check_snow_pack_incidence,
        schema={"anyOf": [ANGLE_SCHEMA, {"enum": [DIFFUSE, SUN]}]},
    ),
]  # fmt: skip


@declare_function
def spectrophotometer(
    medium: Medium | Mapping[str, Medium] | SnowPacks,
    wavelength_nm: Wavelengths,
    incidence_deg: SnowPackIncidence = 0.0,
    *,
    max_stderr: StandardError = 0.002,
    solver: Solver = "auto",
    estimator: SpectralEstimator = "spectral",
    jacobian: Sequence[str] = (),
    stokes: IncidentStokes = False,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the hemispherical reflectance, transmittance and absorptance of one or more media.

    Under a beam, the reflectance is directional-hemispherical (DHR, black-sky albedo); under
    diffuse light, it is bihemispherical (BHR, white-sky albedo).

    Several media of the same grains and layers are simulated with the same paths.  The statistical
    noise is then common to the spectra, and the errors of differences between the media are much
    smaller than those of the spectra.

    Parameters
    ----------
    medium : Medium, mapping or SnowPacks
        For example `splits.Snow` or `splits.ParticleLayer`.  A mapping from names to media of the
        same grains, particles, layers and interpretation; refractive indices of grains and pores,
        impurities, and the albedo of a reflecting ground may differ.  Or `splits.SnowPacks`, the
        snowpacks of a season, by discrete ordinates.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), 200 to 100 000 and within the tables of the
        medium's refractive indices.
    incidence_deg : float, "diffuse", "sun" or array_like
        Incidence angle of a collimated beam, 0 to 89.9999 degrees, or isotropic radiance.  For
        `splits.SnowPacks` also "sun", the zenith angle of the sun of each snowpack, or an angle
        for each.
    max_stderr : float
        Largest standard error of any quantity at any wavelength, 1e-6 to 0.5; of several media, of
        each.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        "discrete_ordinates" solves the equation of radiative transfer in plane layers of grains, in
        milliseconds: see docs/theory/discrete-ordinates.md.  Modelled natural snow
        (`splits.Snow.natural`) has tables of single scattering.  Paths through single grains of
        other snow and sand are traced in the first call and kept in the cache folder.  Media for
        which the equation does not hold are rejected.  "auto" uses discrete ordinates for natural
        snow where their error is at most `max_stderr`, and "monte_carlo" otherwise.  Paths are not
        available for `splits.SnowPacks`.
    estimator : {"spectral", "analog"}
        "spectral" uses the same paths at all wavelengths.  "analog", for one medium, is the
        algorithm of the papers: each wavelength is traced separately, and absorption is sampled at
        random on each segment.
    jacobian : sequence of str
        Parameters of one medium with respect to which derivatives are computed: numeric keywords of
        the medium, such as ``depth_m`` or ``optical_radius_um``; distributions such as
        ``facetness``; amounts, also those that are 0 (``impurities_ng_g.black_carbon``); one of
        these in a layer of a stack (``layers.0.depth_m``); and ``incidence_deg``.  The other
        keywords are held constant.  Parameters that leave the paths unchanged have a negligible
        cost.  Each of the others needs four to a dozen additional runs
        (`splits.simulation.derivatives`).  By discrete ordinates, derivatives are differences of
        solutions, without noise (`splits.discrete_ordinates.derivatives`).  ``parameter_method``
        gives the method.
    stokes : bool or array_like
        Whether light is polarized on its path, which changes how much of it is reflected, or the
        Stokes vector (I, Q, U, V) of the incident light; see `splits.goniophotometer`.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    max_rays : int
        Number of rays after which the run stops (the first round is always completed).  The
        attribute ``stop_reason`` indicates whether the error or this limit was reached.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        "vectorized" traces many rays in parallel in single precision; "scalar" is the reference
        kernel in double precision.  "auto" uses the vectorized kernel if it supports the sample.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance``, ``transmittance``, ``absorptance`` and their standard errors
        ``…_stderr`` over ``wavelength``; the three add up to 1.  ``reflectance_batches`` and
        ``transmittance_batches`` over ``batch`` and ``wavelength`` are the contributions of each
        batch of rays to the error, scaled so that the squares add up to the variance.  Errors of
        combinations are computed from them, see `splits.core.uncertainty`; the contributions for
        absorptance are minus their sum.  Discrete ordinates have none.  The attributes record all
        inputs, and the coordinate ``incidence_deg`` the incidence, which `splits.retrieve` checks.
        ``reflectance_jacobian`` and ``transmittance_jacobian`` over ``parameter`` and
        ``wavelength``, with errors and batches, if requested.

        With a mapping all variables are over ``medium``, too.  Sums over ``batch`` of products of
        ``…_batches`` are covariances, both between media and between wavelengths.  Inputs in which
        media differ are coordinates over ``medium``.

        For `splits.SnowPacks` the variables are over the label and ``wavelength``, and
        ``quality_flag`` is over the label.  Snowpacks that are not good, and those outside the
        tables of grains (flag unsupported), have NaN.

        For optically deep media, which are truncated (`splits.simulation.deep_medium`), the
        attribute ``truncation_depth_m`` gives the truncation depth, and ``semi_infinite_depth_m``
        the depth above which the reflectance is that of a semi-infinite medium; the errors include
        the uncertainty of the theory.

    Raises
    ------
    ValueError
        For a value outside its range, or a medium that cannot share the paths of the first.

    References
    ----------
    SPLITSnow section 4.1, Eq 8: reflectance is the fraction of rays that leave upwards, n/N.  The
    printed factor 1/π is that of a radiance, not of a fraction of rays.

    Examples
    --------
    >>> import splits
    >>> snow = dict(specific_surface_area_m2_kg=20, depth_m=0.3)
    >>> ds = splits.spectrophotometer(
    ...     {
    ...         "clean": splits.Snow.natural(**snow),
    ...         "dirty": splits.Snow.natural(**snow, impurities_ng_g={"black_carbon": 500}),
    ...     },
    ...     [500, 900],
    ...     max_stderr=0.01,
    ... )
    >>> ds.reflectance.dims
    ('medium', 'wavelength')
    """
    run = RunOptions.start(seed, threads, kernel, progress)
    wavelengths = np.asarray(wavelength_nm)
    if isinstance(medium, SnowPacks):
        of_packs = "left out for SnowPacks"
        check_relations(
            (estimator == "spectral", "estimator", estimator, of_packs, "it needs paths"),
            (not np.size(jacobian), "jacobian", jacobian, of_packs),
            (stokes is False, "stokes", stokes, of_packs, "polarization needs paths"),
        )
        packs, incidence = choose_incidence(medium, incidence_deg)
        request = SpectralRequest(wavelengths, incidence, max_stderr, max_rays, run)
        choice = choose_pack_solver(solver, packs, wavelengths)
        solution, flags = solve_snow_packs(packs, wavelengths, incidence, max_stderr, run)
        dataset = make_pack_spectrum(request, packs, choice, solution)
        return label_snow_packs(dataset, packs, flags)
    incidence = check_incidence("incidence_deg", incidence_deg)
    is_mapping, analog = isinstance(medium, Mapping), estimator == "analog"
    parameters: tuple[str, ...] = ()
    media = check_media(medium, allow_semi_infinite=not analog)
    first = next(iter(media.values()))
    if is_mapping:
        if analog:
            raise invalid("estimator", estimator, "'spectral' for several media")
        if not isinstance(jacobian, Sequence) or len(jacobian):
            raise invalid("jacobian", jacobian, "left out for several media")
    else:
        parameters = check_jacobian(first, incidence, jacobian)
        if parameters and analog:
            raise invalid("jacobian", list(parameters), "left out for this estimator")
    polarization = check_stokes(stokes, first, incidence)
    request = SpectralRequest(wavelengths, incidence, max_stderr, max_rays, run, polarization)
    choice = choose_solver(
        solver, media.values(), wavelengths, max_stderr, run.threads, max_stderr=max_stderr,
        obstacle=find_path_obstacle(estimator, stokes),
        find_further_obstacle=lambda one: find_parameter_obstacle(one, parameters),
    )  # fmt: skip
    perturbations, truncation = NO_PERTURBATIONS, None
    if choice.stacks:
        estimate, solutions = solve_estimate(choice.stacks, incidence, max_stderr)
        if parameters:
            derivatives = solve_parameter_derivatives(
                first, solutions[0], wavelengths, incidence, parameters
            )
    else:
        perturbations = Perturbations.select_exact(first, parameters, wavelengths)
        path_sharing = PathSharingMedia(
            (*media.values(), *perturbations.media),
            np.append(np.ones(len(media)), perturbations.size_ratios),
            len(perturbations.media),
        )
        truncation = None if analog else request.truncate(path_sharing)
        estimate = request.simulate(path_sharing, truncation, perturbations, analog=analog)
        derivatives = estimate.derivatives
    dims = ("medium", "wavelength") if is_mapping else ("wavelength",)
    dataset = make_spectrum(request, first, estimate, truncation=truncation, dims=dims)
    dataset.attrs |= {**choice.attributes, "estimator": estimator}
    if is_mapping:
        return label_media(dataset, media)
    methods = perturbations.list_methods(parameters)
    if not choice.stacks and "finite_difference" in methods:
        derivatives, dataset.attrs["finite_difference_rays"] = _simulate_differences(
            request, derivatives, perturbations, first, parameters
        )
    if not parameters:
        return dataset
    return add_jacobian(dataset, derivatives, parameters, methods)


def check_media(
    medium: Medium | Mapping[str, Medium], *, allow_semi_infinite: bool = True
) -> dict[str, Medium]:
    """Return the media of a mapping by name, or a medium with the name "", after checking them."""
    if not isinstance(medium, Mapping):
        check_medium(medium, allow_semi_infinite=allow_semi_infinite)
        return {"": medium}
    if not medium:
        raise invalid("medium", medium, "a medium, or a mapping of names to media, at least one")
    media = to_text_keys("medium", medium)
    for name, one in media.items():
        check_medium(one, allow_semi_infinite=True, key=f"medium[{name!r}]")
    check_path_sharing(media)
    return media


def find_path_obstacle(estimator: str, stokes: Any) -> str | None:
    """Return why discrete ordinates cannot replace a spectrophotometer, None if they can."""
    if estimator == "analog":
        return f"the estimator {estimator} needs paths"
    return None if stokes is False else "polarization needs paths"


def _simulate_differences(
    request: SpectralRequest,
    exact: Derivatives,
    perturbations: Perturbations,
    medium: Medium,
    parameters: tuple[str, ...],
) -> tuple[Derivatives, int]:
    """Return all derivatives, finite differences where there is no exact one, and their rays."""

    def simulate_perturbed(perturbed: Medium, incidence: float | str) -> SpectralEstimate:
        perturbed_request = request._replace(incidence=incidence)
        media = PathSharingMedia.from_media([perturbed])
        return perturbed_request.simulate(media, request.truncate(media))

    by_parameter = {
        name: exact.select(slice(i, i + 1)) for i, name in enumerate(perturbations.parameters)
    }
    total_rays = 0
    for name in parameters:
        if name not in perturbations.parameters:
            by_parameter[name], n_rays = compute_finite_difference(
                simulate_perturbed, medium, request.incidence, name
            )
            total_rays += n_rays
    return Derivatives.concatenate([by_parameter[name] for name in parameters]), total_rays


def label_media(dataset: xr.Dataset, media: Mapping[str, Medium]) -> xr.Dataset:
    """Return a dataset of several media with their names, and the inputs in which they differ.

    These are coordinates over the media instead of attributes; absent amounts are 0.
    """
    inputs = [{f"{m.kind}_{k}": v for k, v in m.describe().items()} for m in media.values()]
    differing: dict[str, Any] = {}
    for key in dict.fromkeys(key for one in inputs for key in one):
        values: list[Any] = [one.get(key) for one in inputs]
        if all(np.array_equal(value, values[0]) for value in values):
            continue
        numeric = all(value is None or isinstance(value, int | float) for value in values)
        kind: Any = float if numeric else str
        column = [kind() if value is None else kind(value) for value in values]
        differing[key] = ("medium", column, {"long_name": key.replace("_", " ")})
    dataset.attrs = {key: value for key, value in dataset.attrs.items() if key not in differing}
    names = ("medium", list(media), {"long_name": "name of the medium"})
    return dataset.assign_coords({"medium": names, **differing})


# --------------------------------------------------------------------------------------------------
# Simulation of spectra, of one medium or of several that share paths.

MAX_ATTEMPTS = 3
"""Runs of a truncated medium, each to half the error of the one before."""


class SpectralRequest(NamedTuple):
    """Light, accuracy and options of spectra."""

    wavelengths: np.ndarray
    incidence: float | str
    max_stderr: float
    max_rays: int
    run: RunOptions
    polarization: IncidentPolarization | None = None

    def truncate(self, path_sharing: PathSharingMedia) -> TruncatedMedium | None:
        """Return the truncated media, which do not depend on the incidence."""
        return truncate_deep_medium(path_sharing, self.wavelengths, self.max_stderr, self.run)

    def simulate(
        self,
        path_sharing: PathSharingMedia,
        truncation: TruncatedMedium | None,
        perturbations: Perturbations = NO_PERTURBATIONS,
        *,
        analog: bool = False,
    ) -> SpectralEstimate:
        """Return estimates for media that share paths, or for one with its derivatives.

        A truncated medium is traced to a smaller error than requested, since the error of the
        theory adds to it.  If more light than predicted reaches the truncation depth, it is traced
        again, to an even smaller error.

        Parameters
        ----------
        path_sharing : PathSharingMedia
            With the perturbed media of the perturbations.
        truncation : TruncatedMedium or None
            Their truncation.
        perturbations : Perturbations
        analog : bool
            Trace each row separately, with analog absorption.  This is the algorithm of SPLITS
            section 4.3 and SPLITSnow section 3, kept as the reference.
        """
        traced = path_sharing if truncation is None else truncation.path_sharing
        reported, perturbed = traced.split()
        rows = SpectralRows.from_media(reported, self.wavelengths)
        if perturbed.media:
            if truncation is not None and (truncation.ground_absorption[0] == 0.0).any():
                lossless = self.wavelengths[truncation.ground_absorption[0] == 0.0]
                allowed = "left out for deep media at wavelengths where nothing absorbs"
                hint = f"as at {lossless[0]:g} nm"
                raise invalid("jacobian", list(perturbations.parameters), allowed, hint)
            ground_column = NO_GROUND if truncation is None else rows.absorption.shape[1] - 1
            rows = rows.with_derivatives(
                perturbed, perturbations.steps, self.wavelengths, ground_column
            )
        scene = build_scene(traced.media[0], self.incidence, analog, self.polarization)
        above_truncation = (1.0 - ERROR_BUDGET_FRACTION**2) ** 0.5
        target = self.max_stderr * (1.0 if truncation is None else above_truncation)
        for _ in range(MAX_ATTEMPTS):
            if analog:
                nodes = make_separate_nodes(rows.index)
            else:
                tolerance = INTERPOLATION_FRACTION * target
                nodes = choose_nodes(rows.index, rows.interfaces, tolerance)
            tally = SpectralTally(rows, nodes, scene)
            evaluation = simulate(scene, tally, StoppingRule(target, self.max_rays), self.run)
            above: SpectralEstimate = evaluation.estimate
            if truncation is None:
                return above
            estimate = truncation.complete_estimate(above)
            if estimate.stderr.max() <= self.max_stderr or evaluation.stop_reason == "max_rays":
                break
            target *= 0.5
        if truncation is not None and traced.n_perturbed:
            derivatives = truncation.complete_derivatives(above, perturbations.steps)
            estimate = replace(estimate, derivatives=derivatives)
        return estimate


def make_spectrum(
    request: SpectralRequest,
    medium: Medium | SnowPacks,
    estimate: SpectralEstimate,
    *,
    truncation: TruncatedMedium | None = None,
    size_ratio: float = 1.0,
    dims: tuple[str, ...] = ("wavelength",),
) -> xr.Dataset:
    """Return the dataset of `splits.spectrophotometer`.

    Parameters
    ----------
    request : SpectralRequest
    medium : Medium or SnowPacks
        Its inputs are attributes.
    estimate : SpectralEstimate
        Without batches of rays for snowpacks.
    truncation : TruncatedMedium or None
    size_ratio : float
        Size of the medium relative to the traced one.
    dims : tuple of str
        Dimensions of the variables: over media, too, where there are several.
    """
    illumination = "hemispherical" if request.incidence == "diffuse" else "directional"
    shape = (*[-1] * (len(dims) - 1), request.wavelengths.size)
    variables: dict[str, Variable] = {}
    for row, (name, label) in enumerate(QUANTITY_LABELS.items()):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        mean, stderr = estimate.mean[row].reshape(shape), estimate.stderr[row].reshape(shape)
        deviations = None
        if name in SIDE_QUANTITIES:
            by_batch = estimate.batch_deviations[:, row]
            deviations = by_batch.reshape(len(by_batch), *mean.shape)
        variables |= make_variable(name, dims, mean, stderr, long_name, deviations=deviations)
    attributes = {
        **request.run.make_attributes("Virtual spectrophotometer", "spectrophotometer", medium),
        **SolverChoice.monte_carlo("media share paths").attributes,
        "estimator": "spectral",
        "incidence_deg": request.incidence,
        **describe_polarization(request.polarization),
        "max_stderr": request.max_stderr,
        "stop_reason": estimate.get_stop_reason(request.max_stderr, request.max_rays),
        "max_stderr_reached": estimate.max_stderr,
        "interpolation_error_bound": float(estimate.interpolation_error.max()),
        "max_rays": request.max_rays,
        **estimate.rays,
    }
    if truncation is not None:
        attributes["truncation_depth_m"] = size_ratio * truncation.depth_m
        attributes["semi_infinite_depth_m"] = size_ratio * truncation.semi_infinite_depth_m
    coordinates = {
        "wavelength": make_wavelength_coordinate(request.wavelengths),
        "incidence_deg": make_incidence_coordinate(request.incidence),
    }
    return xr.Dataset(variables, coordinates, attributes)


def make_pack_spectrum(
    request: SpectralRequest, packs: SnowPacks, choice: SolverChoice, solution: SpectraSolution
) -> xr.Dataset:
    """Return the dataset of `splits.spectrophotometer` for snowpacks, without their labels.

    Parameters
    ----------
    request : SpectralRequest
        The incidence is an angle, "diffuse" or "sun".
    packs : SnowPacks
    choice : SolverChoice
    solution : SpectraSolution
        For one beam, if any, and for diffuse light.
    """
    estimate = make_pack_estimate(solution, -1 if request.incidence == DIFFUSE else 0)
    dataset = make_spectrum(request, packs, estimate, dims=(PACK_DIM, "wavelength"))
    dataset.attrs |= choice.attributes
    if request.incidence == SUN:
        angles = make_incidence_coordinate(packs.dataset[ZENITH_KEY].values, (PACK_DIM,))
        dataset.attrs["incidence_deg"] = SUN_OF_EACH
        dataset = dataset.assign_coords(incidence_deg=angles)
    return dataset


def simulate_spectra(path_sharing: PathSharingMedia, request: SpectralRequest) -> list[xr.Dataset]:
    """Return the dataset of `splits.spectrophotometer` for each medium of a set that shares paths.

    Each has the requested error.  The `…_batches` of different media give the correlations of their
    errors.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    request : SpectralRequest

    Returns
    -------
    list of xarray.Dataset
        The attribute ``rays`` counts those used by all media.
    """
    n_wavelengths, truncation = request.wavelengths.size, request.truncate(path_sharing)
    estimate = request.simulate(path_sharing, truncation)
    return [
        make_spectrum(
            request, medium,
            estimate.select(slice(number * n_wavelengths, (number + 1) * n_wavelengths)),
            truncation=truncation, size_ratio=path_sharing.size_ratios[number],
        )
        for number, medium in enumerate(path_sharing.media)
    ]  # fmt: skip
