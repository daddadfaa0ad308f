"""Block of a table: the spectra of all points that share an ensemble of paths, or solutions."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback
from splits.core.uncertainty import ErrorTarget
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    solve_with_exponent_error,
)
from splits.instruments.angular_estimate import join_wavelengths
from splits.instruments.goniophotometer import make_direction_mask, simulate_directions
from splits.instruments.solver import (
    DISCRETE_ORDINATES,
    MONTE_CARLO,
    PHASE_FUNCTION_FACTOR,
    make_estimate,
    solve_angular_distributions,
)
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.netcdf import make_provenance
from splits.kernels.records import N_BATCHES
from splits.simulation.spectral_tally import SIDE_QUANTITIES
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads
from splits.tables.axes import DIFFUSE_PREFIX, VIEW_AXES, ViewGrid, has_diffuse, list_view_axes
from splits.tables.plan import DIFFUSE, PathGroup


class TableRequest(NamedTuple):
    """Request for a table.

    Attributes
    ----------
    spectral_request : SpectralRequest
        Request for spectra; each ensemble sets its own incidence.
    quantities : tuple of str
        See `splits.tables.axes.check_quantities`.
    covariance : bool
        Whether deviations by batch of rays are stored.
    solver : {"monte_carlo", "discrete_ordinates"}
    views : ViewGrid or None
        Directions of observation.
    """

    spectral_request: SpectralRequest
    quantities: tuple[str, ...]
    covariance: bool
    solver: str = MONTE_CARLO
    views: ViewGrid | None = None


def prepare_media(group: PathGroup, request: TableRequest) -> Any:
    """Return what the media of a group have in common under all incidences, for `compute_block`.

    Paths have the truncation of semi-infinite media in common; discrete ordinates solve each medium
    for all incidences at once.
    """
    if request.solver == MONTE_CARLO:
        return request.spectral_request.truncate(group.path_sharing)
    spectral_request, media = request.spectral_request, group.path_sharing.media
    wavelengths, max_stderr = spectral_request.wavelengths, spectral_request.max_stderr
    threads = spectral_request.run.threads
    # Paths through grains use all threads themselves.
    error = max_stderr * (1.0 if request.views is None else PHASE_FUNCTION_FACTOR)
    stacks = [make_granular_stack(medium, wavelengths, error, threads) for medium in media]
    if request.views is not None:
        target = _make_target(request.views)
        return [
            solve_angular_distributions(one, *request.views, max_stderr, target, group.incidences)
            for one in stacks
        ]
    angles = [float(incidence) for incidence in group.incidences if incidence != DIFFUSE]
    cosines = np.cos(np.radians(angles))

    def solve(stack: GranularStack) -> SpectrumSolution:
        return solve_with_exponent_error(stack, cosines, max_stderr)

    # The error determines the number of streams.
    with limit_blas_threads(), DaemonThreadPool(threads) as pool:
        return list(pool.map(solve, stacks))


def compute_block(
    group: PathGroup, request: TableRequest, prepared: Any, progress: ProgressCallback = None
) -> xr.Dataset:
    """Compute a block: values and standard errors over ``point``, views and ``wavelength``.

    Parameters
    ----------
    group : PathGroup
    request : TableRequest
    prepared : object
        From `prepare_media`, for the media of the group.
    progress : callable, optional
    """
    start_time = time.perf_counter()
    run = request.spectral_request.run._replace(progress=progress)
    spectral_request = request.spectral_request._replace(incidence=group.incidence, run=run)
    own_request = request._replace(spectral_request=spectral_request)
    compute = _compute_spectra if request.views is None else _compute_directions
    variables, described = compute(group, own_request, prepared)
    attrs = {
        **make_provenance("block of a table"),
        **described,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
    }
    point_coordinate = ("point", group.positions, {"long_name": "flat index in the table"})
    return xr.Dataset(
        variables, {"point": point_coordinate, "wavelength": spectral_request.wavelengths}, attrs
    )


def _compute_spectra(
    group: PathGroup, request: TableRequest, prepared: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the variables of a block of spectra, and its attributes."""
    spectral_request = request.spectral_request
    if request.solver == DISCRETE_ORDINATES:
        # Isotropic light is the last column of a solution.
        beams = [incidence for incidence in group.incidences if incidence != DIFFUSE]
        column = -1 if group.incidence == DIFFUSE else beams.index(group.incidence)
        estimate = make_estimate(prepared, column)
    else:
        estimate = spectral_request.simulate(group.path_sharing, prepared)
    shape = (len(group.path_sharing.media), spectral_request.wavelengths.size)
    variables: dict[str, Any] = {}
    for side in request.quantities:
        row = SIDE_QUANTITIES.index(side)
        for name, array in ((side, estimate.mean), (f"{side}_stderr", estimate.stderr)):
            values = array[row].reshape(shape)[group.media_indices]
            variables[name] = (("point", "wavelength"), values.astype(np.float32))
        if request.covariance:
            deviations = estimate.batch_deviations[:, row].reshape(N_BATCHES, *shape)
            variables[f"{side}_batches"] = (
                ("batch", "point", "wavelength"),
                deviations[:, group.media_indices].astype(np.float32),
            )
    return variables, {
        **estimate.rays,
        "max_stderr_reached": float(estimate.stderr.max()),
        "interpolation_error_bound": float(estimate.interpolation_error.max()),
        "stop_reason": estimate.get_stop_reason(
            spectral_request.max_stderr, spectral_request.max_rays
        ),
    }


def _compute_directions(
    group: PathGroup, request: TableRequest, prepared: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the variables of a block with directions of observation, and its attributes.

    Rows of the estimate are the wavelengths of one medium after the other.
    """
    spectral_request, views = request.spectral_request, request.views
    assert views is not None
    if request.solver == DISCRETE_ORDINATES:
        column = group.incidences.index(group.incidence)
        results = [by_incidence[column] for by_incidence in prepared]
        estimate = join_wavelengths([estimate for estimate, _ in results])
        attributes = {"rays": 0} | {
            name: max(described[name] for _, described in results)
            for name in ("streams", "truncation_error", "optics_error")
        }
        otherwise = "solver_error"
    else:
        estimate, rays, stop_reason = simulate_directions(
            group.path_sharing, prepared, spectral_request, *views, _make_target(views)
        )
        attributes = {"rays": rays}
        # With enough rays, only light from below a truncation depth leaves a larger error.
        otherwise = "interpolation_bound" if stop_reason == "converged" else stop_reason
    reached = estimate.compute_max_error(_make_target(views))
    attributes |= {
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= spectral_request.max_stderr else otherwise,
        "interpolation_error_bound": 0.0,
    }
    values = {
        "reflectance": (estimate.hemispherical[0], estimate.hemispherical_stderr[0]),
        "reflectance_factor": (np.pi * estimate.mean[0], np.pi * estimate.stderr[0]),
        "anisotropy_factor": (estimate.anisotropy, estimate.anisotropy_stderr),
    }
    is_diffuse = group.incidence == DIFFUSE and has_diffuse(request.quantities)
    prefix = DIFFUSE_PREFIX if is_diffuse else ""
    variables: dict[str, Any] = {}
    for name in request.quantities:
        if name.startswith(DIFFUSE_PREFIX) != is_diffuse:
            continue
        axes = list_view_axes(name)
        n_media, n_wavelengths = len(group.path_sharing.media), spectral_request.wavelengths.size
        shape = (n_media, n_wavelengths, *(views.shape if axes else ()))
        for suffix, array in zip(("", "_stderr"), values[name.removeprefix(prefix)], strict=True):
            by_medium = np.moveaxis(array.reshape(shape), 1, -1)[group.media_indices]
            if axes != VIEW_AXES and axes:
                # Under isotropic light, all azimuths are equal.
                by_medium = by_medium[:, :, 0]
            dims = ("point", *axes, "wavelength")
            variables[name + suffix] = (dims, by_medium.astype(np.float32))
    return variables, attributes


def _make_target(views: ViewGrid) -> ErrorTarget:
    """Return the target of absolute errors of reflectance factors."""
    return ErrorTarget(0, make_direction_mask(*views), absolute=True)
