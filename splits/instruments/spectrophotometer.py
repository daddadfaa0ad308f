"""Virtual spectrophotometer: directional-hemispherical reflectance and transmittance."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import xarray as xr

from splits.core.progress import ProgressCallback, with_progress
from splits.core.validation import check_choice, invalid, reject_unknown_arguments
from splits.instruments.spectral_run import SIDE_QUANTITIES, TITLE, SpectralRequest
from splits.media.medium import Medium
from splits.simulation.arguments import check_medium
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.derivatives import (
    Perturbations,
    check_jacobian,
    combine_derivatives,
    make_jacobian_variables,
    make_parameter_coordinates,
)
from splits.simulation.estimators import ESTIMATORS, SpectralEstimate
from splits.simulation.finite_differences import compute_finite_difference
from splits.simulation.path_tally import PathSharingMedia


@reject_unknown_arguments
@with_progress
def spectrophotometer(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.002,
    seed: int = 1,
    *,
    estimator: str = "spectral",
    jacobian: Sequence[str] = (),
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Measure hemispherical reflectance, transmittance and absorptance of a medium.

    Parameters
    ----------
    medium : GranularMedium or TurbidMedium
        For example `splits.Snow` or `splits.ParticleLayer`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), 200 to 100 000 and within the tables of the
        medium's refractive indices.
    incidence_deg : float or "diffuse"
        Polar angle of a collimated beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    max_stderr : float
        Largest standard error wanted for any quantity at any wavelength, 1e-6 to 0.5.
    seed : int
        Non-negative; the same seed gives the same numbers bit for bit on any number of threads.
    estimator : {"spectral", "analog"}
        Paths shared by all wavelengths, or the papers' algorithm as a reference: one wavelength
        at a time, absorption by coin toss.
    jacobian : sequence of str
        Parameters to give derivatives to: keywords of the medium that are numbers, such as
        ``depth_m`` or ``optical_radius_um``, distributions such as ``facetness``, amounts that are
        there or might be (``impurities_ng_g.black_carbon``), one of these in a layer of a stack
        (``layers.0.depth_m``), and ``incidence_deg``.  The other keywords stay.  Those that leave
        the paths as they are cost next to nothing, each of the others four to a dozen runs more
        (`splits.simulation.finite_differences`); ``parameter_method`` tells which is which.
    max_rays : int
        The run stops once this many are traced (the first round is traced in any case);
        attribute ``stop_reason`` says whether the error or the rays came first.
    threads : int, optional
        Default: every CPU this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        Many rays side by side in single precision where that serves the sample, or the plain
        reference kernel in double precision.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``reflectance``, ``transmittance``, ``absorptance`` and their standard errors
        ``…_stderr`` over ``wavelength``; the three add up to 1.  ``reflectance_batches`` and
        ``transmittance_batches`` over ``batch`` and ``wavelength`` tell how errors go together,
        see `splits.core.uncertainty`; absorptance's are minus their sum.  All inputs stand in
        the attributes.  ``reflectance_jacobian`` and ``transmittance_jacobian`` over
        ``parameter`` and ``wavelength``, with errors and groups, where they were asked for.
        Of packs so deep that they are cut (`splits.simulation.deep_medium`), the
        attribute ``truncation_depth_m`` says where, and ``semi_infinite_depth_m`` from which depth on they
        are as bright as without end; what theory may miss of the rest is in the errors.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 8: reflectance is the share of rays that leave upwards, n/N (the
    printed 1/π belongs to a radiance, not to a share of rays).
    """
    check_medium(medium, allow_semi_infinite=estimator == "spectral")
    check_choice("estimator", estimator, ESTIMATORS)
    run = SpectralRequest.from_arguments(
        wavelength_nm, incidence_deg, max_stderr, seed, max_rays, threads, kernel
    )
    names = check_jacobian(medium, run.incidence, jacobian)
    if names and estimator != "spectral":
        raise invalid("jacobian", list(names), "left out for this estimator")
    moves = Perturbations.select_exact(medium, names, run.wavelengths)
    begun = time.perf_counter()
    found = run.estimate(PathSharingMedia.from_media([medium]), moves, estimator, progress)

    def nearby(other: Medium, incidence: float | str) -> SpectralEstimate:
        one = run._replace(incidence=incidence)
        return one.estimate(PathSharingMedia.from_media([other]), progress=progress).estimate

    others = [
        compute_finite_difference(nearby, medium, run.incidence, n)
        for n in names
        if n not in moves.parameters
    ]
    variables = run.make_variables(found.estimate, ("wavelength",))
    if names:
        slopes = combine_derivatives(names, found.estimate.derivatives, moves, others)
        variables |= make_jacobian_variables(slopes, names, SIDE_QUANTITIES)
    facts = make_run_attributes(TITLE, "spectrophotometer", medium, begun, run.seed, run.threads)
    if others:
        facts["finite_difference_rays"] = sum(one.n_rays for one in others)
    axes = {
        "wavelength": make_wavelength_coordinate(run.wavelengths),
        **make_parameter_coordinates(names, moves),
    }
    return xr.Dataset(
        variables, axes, facts | {"estimator": estimator} | run.make_attributes(found)
    )
