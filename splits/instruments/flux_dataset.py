"""Dataset of radiative fluxes inside a medium."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    make_deviation_variable,
    make_variable,
)
from splits.core.validation import ROUNDING_TOLERANCE
from splits.discrete_ordinates.granular_stack import GranularStack
from splits.discrete_ordinates.profiles import (
    IntervalProfile,
    LayerDivision,
    solve_profile,
)
from splits.instruments.flux_media import (
    TracedMedium,
    bound_material_absorptance_error,
    compute_absorption_steps,
)
from splits.instruments.flux_tally import (
    FluxEstimate,
    FluxResult,
    bound_flux_interpolation_error,
    estimate_rare_event_error,
)
from splits.kernels.tallies.exits import N_BATCHES
from splits.media.medium import Medium
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.threads import limit_blas_threads

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
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the dataset of a result, see `splits.irradiance_profile`.

    Parameters
    ----------
    result : FluxResult
    traced_medium : TracedMedium
    wavelengths : float, shape (wavelengths,)
        nm.
    attributes : dict
        Attributes of the dataset.
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
    steps = compute_absorption_steps(traced_medium.medium, absorption, edges)
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
    longest, rate = np.full_like(absorptance, np.inf), steps.absorption_rate
    np.divide(1.0 / thickness, rate, out=longest, where=rate > 0.0)
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
        steps, by_material[0].mean(axis=0), absorptance, unscored_bound
    )
    unsampled_light = result.unsampled_light[:, np.newaxis]
    material_error = _combine_errors(by_material, result, unsampled_light, material_bound)
    results += [(fluxes[0].mean(axis=0), flux_error), (by_material[0].mean(axis=0), material_error)]
    materials = list(traced_medium.material_columns)
    return _make_dataset(results, wavelengths, edges, materials, attributes)


def _make_dataset(
    results: Sequence[tuple[np.ndarray, ...]], wavelengths: np.ndarray, edges: np.ndarray,
    materials: Sequence[str], attributes: dict[str, Any],
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of results.

    Parameters
    ----------
    results : sequence of tuple of float, shape (..., wavelengths)
        Values of the `QUANTITIES`, their errors, and deviations by batch of the first three.
    wavelengths : float, shape (wavelengths,)
        nm.
    edges : float, shape (intervals + 1,)
        Edges of the intervals (m).
    materials : sequence of str
    attributes : dict
    """
    variables: dict[str, Variable] = {}
    for (name, (axes, label)), (mean, error, *deviations) in zip(
        QUANTITIES.items(), results, strict=True
    ):
        dims = ("wavelength", *axes)
        values, stderr = (np.moveaxis(one, -1, 0) for one in (mean, error))
        variables |= make_variable(name, dims, values, stderr, label)
        for by_batch in deviations:
            variables |= make_deviation_variable(name, dims, np.moveaxis(by_batch, -1, 1), label)
    depth_attributes = {
        "long_name": "depth", "units": "m", "positive": "down", "standard_name": "depth",
    }  # fmt: skip
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "depth": ("depth", edges[np.isfinite(edges)], depth_attributes),
        "interval_top": ("interval", edges[:-1], {"long_name": "top", "units": "m"}),
        "interval_bottom": ("interval", edges[1:], {"long_name": "bottom", "units": "m"}),
        "material": ("material", np.array(materials), {"long_name": "material"}),
    }
    return xr.Dataset(variables, coordinates, attributes)


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
    fraction = np.broadcast_to(sample_fraction, mean_parts.shape).copy()
    np.divide(mean_parts, mean_scored, out=fraction, where=is_scored)
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
        solution = solve_profile(parts, geometry, cosine, max_stderr, limit_irradiance)
    profile, error = solution.profile, solution.compute_error()
    thickness = np.diff(edges)[:, np.newaxis]
    results: list[tuple[np.ndarray, ...]] = [
        (values, stderr, np.zeros((N_BATCHES, *values.shape)))
        for values, stderr in zip(profile[:3], error[:3], strict=True)
    ]
    results += [
        (profile.path_length / thickness, error.path_length / thickness),
        (profile.by_material, error.by_material),
    ]

    def find_largest(errors: IntervalProfile) -> float:
        limited = [errors.upward[:1], errors.absorptance]
        limited += [errors.downward, errors.upward] if limit_irradiance else []
        return float(max(one.max() for one in limited))

    reached = find_largest(error)
    attributes = {
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= max_stderr else "solver_error",
        "rays": 0,
        "streams": solution.n_streams,
        "truncation_error": find_largest(solution.truncation),
        "optics_error": find_largest(solution.optics_error),
    }
    return _make_dataset(results, wavelengths, edges, list(medium.material_columns), attributes)


def divide_medium(
    medium: Medium, whole: GranularStack, edges: np.ndarray
) -> tuple[GranularStack, LayerDivision]:
    """Return a medium and its snowpack divided at the edges of intervals (m)."""
    layers: Any = medium.scene_layers
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
