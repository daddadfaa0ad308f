"""Virtual spectrophotometer: directional-hemispherical reflectance and transmittance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.validation import check_choice, invalid, to_text_keys
from splits.instruments.snow_packs import check_no_paths, compute_pack_spectra
from splits.instruments.solver import (
    DISCRETE_ORDINATES,
    choose_solver,
    get_derivative_method,
    solve_estimate,
)
from splits.instruments.spectral_run import SIDE_QUANTITIES, SpectralRequest, make_spectrum
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.media.snow_packs import SnowPacks
from splits.simulation.derivatives import (
    Perturbations,
    check_jacobian,
    compute_finite_difference,
    make_jacobian_variables,
    make_parameter_coordinates,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import check_stokes, requests_polarization
from splits.simulation.shared_paths import PathSharingMedia, check_path_sharing
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate

ESTIMATORS = ("spectral", "analog")


@reject_unknown_arguments
def spectrophotometer(
    medium: Medium | Mapping[str, Medium] | SnowPacks,
    wavelength_nm: Any,
    incidence_deg: Any = 0.0,
    max_stderr: float = 0.002,
    seed: int = 1,
    *,
    solver: str = "auto",
    estimator: str = "spectral",
    jacobian: Sequence[str] = (),
    max_rays: int = 20_000_000,
    stokes: Any = False,
    threads: int | None = None,
    kernel: str = "auto",
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
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
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
        (`splits.simulation.derivatives`).  By discrete ordinates, derivatives of dry snow
        are analytic (`splits.discrete_ordinates.derivatives`), and those of wet snow are
        differences of solutions.  ``parameter_method`` gives the method.
    max_rays : int
        Number of rays after which the run stops (the first round is always completed).  The
        attribute ``stop_reason`` indicates whether the error or this limit was reached.
    stokes : bool or array_like
        Whether light is polarized on its path, which changes how much of it is reflected, or the
        Stokes vector (I, Q, U, V) of the incident light; see `splits.goniophotometer`.
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
        absorptance are minus their sum.  The attributes record all inputs.
        ``reflectance_jacobian`` and ``transmittance_jacobian`` over ``parameter`` and
        ``wavelength``, with errors and batches, if requested.

        With a mapping all variables are over ``medium``, too.  Sums over ``batch`` of products of
        ``…_batches`` are covariances, both between media and between wavelengths.  Inputs in which
        media differ are coordinates over ``medium``.

        For `splits.SnowPacks` the variables are over the label and ``wavelength``, without
        ``…_batches``, and ``quality_flag`` is over the label.  Snowpacks that are not good, and
        those outside the tables of grains (flag unsupported), have NaN.

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
    run = RunOptions.from_arguments(seed, threads, kernel, progress)
    if isinstance(medium, SnowPacks):
        check_no_paths(estimator, jacobian)
        return compute_pack_spectra(medium, wavelength_nm, incidence_deg, max_stderr, solver, run)
    media = _check_media(medium, estimator)
    check_choice("estimator", estimator, ESTIMATORS)
    request = SpectralRequest.from_arguments(
        wavelength_nm, incidence_deg, max_stderr, max_rays, run
    )
    first = next(iter(media.values()))
    request = request._replace(polarization=check_stokes(stokes, first, request.incidence))
    is_mapping, analog = isinstance(medium, Mapping), estimator == "analog"
    dims = ("medium", "wavelength") if is_mapping else ("wavelength",)
    parameters = _check_jacobian(medium, request, estimator, jacobian)
    obstacle = find_path_obstacle(estimator, stokes)
    wavelengths, error = request.wavelengths, request.max_stderr
    chosen = choose_solver(solver, media.values(), wavelengths, obstacle, parameters, error)
    if chosen == DISCRETE_ORDINATES:
        estimate = solve_estimate(
            list(media.values()), wavelengths, request.incidence, error, run.threads, parameters
        )
        dataset = make_spectrum(request, first, estimate, truncation=None, dims=dims)
        dataset.attrs["solver"] = DISCRETE_ORDINATES
        if is_mapping:
            return _label_media(dataset, media)
        methods = [get_derivative_method(first)] * len(parameters)
        return _assign_jacobian(dataset, estimate.derivatives, parameters, methods)
    perturbations = Perturbations.select_exact(first, parameters, request.wavelengths)
    path_sharing = PathSharingMedia(
        (*media.values(), *perturbations.media),
        np.append(np.ones(len(media)), perturbations.size_ratios),
        len(perturbations.media),
    )
    truncation = None if analog else request.truncate(path_sharing)
    estimate = request.simulate(path_sharing, truncation, perturbations, analog=analog)
    dataset = make_spectrum(request, first, estimate, truncation=truncation, dims=dims)
    dataset.attrs["estimator"] = estimator
    if is_mapping:
        return _label_media(dataset, media)
    if not parameters:
        return dataset
    exact = estimate.derivatives
    return _add_jacobian(dataset, request, exact, perturbations, first, parameters)


def find_path_obstacle(estimator: str, stokes: Any) -> str | None:
    """Return why discrete ordinates cannot replace a spectrophotometer, None if they can."""
    if estimator == "analog":
        return "the estimator needs paths"
    return "polarization needs paths" if requests_polarization(stokes) else None


def _check_media(medium: Any, estimator: str) -> dict[str, Medium]:
    """Return the media by name, one without a name, after checking them."""
    if not isinstance(medium, Mapping):
        check_medium(medium, allow_semi_infinite=estimator == "spectral")
        return {"": medium}
    if not medium:
        raise invalid("medium", medium, "a medium, or a mapping of names to media, at least one")
    named: dict[str, Medium] = to_text_keys("medium", medium)
    for name, one in named.items():
        check_medium(one, allow_semi_infinite=True, key=f"medium[{name!r}]")
    check_path_sharing(named)
    return named


def _check_jacobian(
    medium: Any, request: SpectralRequest, estimator: str, jacobian: Any
) -> tuple[str, ...]:
    """Return the parameters for which derivatives are requested, after checking them.

    They require one medium and the estimator "spectral", which several media require, too.
    """
    if isinstance(medium, Mapping):
        if estimator != "spectral":
            raise invalid("estimator", estimator, "'spectral' for several media")
        if not isinstance(jacobian, Sequence) or len(jacobian):
            raise invalid("jacobian", jacobian, "left out for several media")
        return ()
    names = check_jacobian(medium, request.incidence, jacobian)
    if names and estimator != "spectral":
        raise invalid("jacobian", list(names), "left out for this estimator")
    return names


def _add_jacobian(
    dataset: xr.Dataset,
    request: SpectralRequest,
    exact: Derivatives,
    perturbations: Perturbations,
    medium: Medium,
    parameters: tuple[str, ...],
) -> xr.Dataset:
    """Return a dataset with derivatives: exact ones, and finite differences from more runs."""

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
    if total_rays:
        dataset.attrs["finite_difference_rays"] = total_rays
    derivatives = Derivatives.concatenate([by_parameter[name] for name in parameters])
    methods = perturbations.list_methods(parameters)
    return _assign_jacobian(dataset, derivatives, parameters, methods)


def _assign_jacobian(
    dataset: xr.Dataset,
    derivatives: Derivatives,
    parameters: Sequence[str],
    methods: list[str],
) -> xr.Dataset:
    """Return a dataset with derivatives, if there are any."""
    if not parameters:
        return dataset
    dataset = dataset.assign_coords(make_parameter_coordinates(parameters, methods))
    return dataset.assign(make_jacobian_variables(derivatives, SIDE_QUANTITIES))


def _label_media(dataset: xr.Dataset, media: Mapping[str, Medium]) -> xr.Dataset:
    """Return a dataset of several media with their names, and the inputs in which they differ."""
    differing = _find_differing_inputs(list(media.values()))
    dataset.attrs = {key: value for key, value in dataset.attrs.items() if key not in differing}
    names = ("medium", list(media), {"long_name": "name of the medium"})
    return dataset.assign_coords({"medium": names, **differing})


def _find_differing_inputs(media: Sequence[Medium]) -> dict[str, Any]:
    """Return the inputs in which media differ, as coordinates over the media.

    Absent amounts are 0.
    """
    inputs = [{f"{m.kind}_{k}": v for k, v in m.describe().items()} for m in media]
    differing: dict[str, Any] = {}
    for key in dict.fromkeys(key for one in inputs for key in one):
        values: list[Any] = [one.get(key) for one in inputs]
        if all(np.array_equal(value, values[0]) for value in values):
            continue
        numeric = all(value is None or isinstance(value, int | float) for value in values)
        kind: Any = float if numeric else str
        column = [kind() if value is None else kind(value) for value in values]
        differing[key] = ("medium", column, {"long_name": key.replace("_", " ")})
    return differing
