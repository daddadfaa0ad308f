"""Reflectance factors and anisotropy factors of the media of a path group, in a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.instruments.angular_estimate import AngularEstimate, join_wavelengths
from splits.instruments.goniophotometer import make_direction_mask, simulate_directions
from splits.instruments.solver import AngularRequest, AngularResult, solve_angular_results
from splits.instruments.spectrophotometer import SpectralRequest
from splits.simulation.deep_medium import TruncatedMedium
from splits.tables.media_cache import MediaCache
from splits.tables.plan import DIFFUSE, PathGroup
from splits.tables.views import DIFFUSE_PREFIX, VIEW_AXES, ViewGrid, has_diffuse, list_view_axes


def solve_directions(
    group: PathGroup, request: SpectralRequest, views: ViewGrid, cache: MediaCache
) -> tuple[AngularEstimate, dict[str, Any]]:
    """Return the estimate of a path group by discrete ordinates, and its attributes.

    Rows are the wavelengths of one medium after the other.  All incidences of the media are solved
    together.
    """
    solutions = cache.get(group.path_sharing, lambda: _solve_media(group, request, views))
    column = group.incidences.index(group.incidence)
    results = [by_incidence[column] for by_incidence in solutions]
    estimate = join_wavelengths([result.estimate for result in results])
    attributes = {
        "rays": 0,
        **{
            name: max(result.attributes[name] for result in results)
            for name in ("streams", "truncation_error", "optics_error")
        },
    }
    return estimate, attributes | _describe_error(
        estimate, request.max_stderr, views, "solver_error"
    )


def _solve_media(
    group: PathGroup, request: SpectralRequest, views: ViewGrid
) -> list[list[AngularResult]]:
    """Return the results of each medium of a group for all incidences."""
    angular_request = AngularRequest(
        request.wavelengths, *views, request.max_stderr, _make_target(views)
    )
    return [
        solve_angular_results(medium, angular_request, group.incidences, request.run.threads)
        for medium in group.path_sharing.media
    ]


def trace_directions(
    group: PathGroup,
    request: SpectralRequest,
    views: ViewGrid,
    truncation: TruncatedMedium | None,
) -> tuple[AngularEstimate, dict[str, Any]]:
    """Return the estimate of a path group by Monte Carlo, as `solve_directions`."""
    estimate, rays, stop_reason = simulate_directions(
        group.path_sharing, truncation, request, *views, _make_target(views)
    )
    # With enough rays, only light from below a truncation depth leaves a larger error.
    otherwise = "interpolation_bound" if stop_reason == "converged" else stop_reason
    attributes = _describe_error(estimate, request.max_stderr, views, otherwise)
    return estimate, {"rays": rays, **attributes}


def _make_target(views: ViewGrid) -> ErrorTarget:
    """Return the target of absolute errors of reflectance factors."""
    return ErrorTarget(0, make_direction_mask(*views), absolute=True)


def _describe_error(
    estimate: AngularEstimate, max_stderr: float, views: ViewGrid, otherwise: str
) -> dict[str, Any]:
    """Return the attributes of the error of reflectance factors.

    `otherwise` is the reason for stopping if the requested error is not reached.
    """
    reached = estimate.compute_max_error(_make_target(views))
    return {
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= max_stderr else otherwise,
    }


def make_view_variables(
    estimate: AngularEstimate,
    group: PathGroup,
    views: ViewGrid,
    n_wavelengths: int,
    quantities: Sequence[str],
) -> dict[str, Any]:
    """Return the variables of a block with their errors, over ``point``, views and wavelength."""
    values = {
        "reflectance": (estimate.hemispherical[0], estimate.hemispherical_stderr[0]),
        "reflectance_factor": (np.pi * estimate.mean[0], np.pi * estimate.stderr[0]),
        "anisotropy_factor": (estimate.anisotropy, estimate.anisotropy_stderr),
    }
    is_diffuse = group.incidence == DIFFUSE and has_diffuse(quantities)
    prefix = DIFFUSE_PREFIX if is_diffuse else ""
    variables: dict[str, Any] = {}
    for name in quantities:
        if name.startswith(DIFFUSE_PREFIX) != is_diffuse:
            continue
        axes = list_view_axes(name)
        for suffix, array in zip(("", "_stderr"), values[name.removeprefix(prefix)], strict=True):
            shape = (len(group.path_sharing.media), n_wavelengths, *(views.shape if axes else ()))
            by_medium = np.moveaxis(array.reshape(shape), 1, -1)[group.media_indices]
            if axes != VIEW_AXES and axes:
                # Under isotropic light, all azimuths are equal.
                by_medium = by_medium[:, :, 0]
            dims = ("point", *axes, "wavelength")
            variables[name + suffix] = (dims, by_medium.astype(np.float32))
    return variables
