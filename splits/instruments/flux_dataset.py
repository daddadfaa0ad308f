"""Dataset of radiative fluxes inside a medium."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import (
    Variable,
    compute_batch_stderr,
    make_deviation_variable,
    make_variable,
)
from splits.instruments.absorption_steps import (
    bound_actinic_flux_error,
    bound_material_absorptance_error,
    compute_absorption_steps,
)
from splits.instruments.flux_errors import compute_nonstatistical_error
from splits.instruments.flux_media import TracedMedium
from splits.instruments.flux_tally import FluxEstimate, FluxResult
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.run_options import make_wavelength_coordinate

DEPTH_DIMS, INTERVAL_DIMS = ("wavelength", "depth"), ("wavelength", "interval")
ACTINIC_FLUX_LABEL = "mean path over thickness"


def make_flux_dataset(
    result: FluxResult,
    traced_medium: TracedMedium,
    wavelengths: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return the dataset of a result, see `splits.instruments.irradiance_profile`.

    Parameters
    ----------
    result : FluxResult
    traced_medium : TracedMedium
    wavelengths : float, shape (wavelengths,)
        nm.
    attributes : dict
        Attributes of the dataset.
    """
    estimate, systematic = result.estimate, result.systematic_error
    variables: dict[str, Variable] = {}
    for name, batch_means, systematic_error, dims, label in (
        ("downward_irradiance", estimate.irradiance[:, DOWNWARD], systematic.irradiance[DOWNWARD],
         DEPTH_DIMS, "downward irradiance"),
        ("upward_irradiance", estimate.irradiance[:, UPWARD], systematic.irradiance[UPWARD],
         DEPTH_DIMS, "upward irradiance"),
        ("absorptance", estimate.absorptance, systematic.absorptance,
         INTERVAL_DIMS, "absorptance of the interval"),
    ):  # fmt: skip
        error = np.hypot(compute_batch_stderr(batch_means), systematic_error)
        variables |= _make_flux_variable(name, dims, batch_means, error, label)
        deviations = np.moveaxis(batch_means - batch_means.mean(axis=0), -1, 1)
        variables |= make_deviation_variable(
            name, dims, deviations / np.sqrt(len(deviations) * (len(deviations) - 1)), label
        )
    variables |= _make_path_variables(result, traced_medium)
    edges = traced_medium.edges_m
    depths = edges[np.isfinite(edges)]
    depth_attributes = {
        "long_name": "depth",
        "units": "m",
        "positive": "down",
        "standard_name": "depth",
    }
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "depth": ("depth", depths, depth_attributes),
        "interval_top": ("interval", edges[:-1], {"long_name": "top", "units": "m"}),
        "interval_bottom": ("interval", edges[1:], {"long_name": "bottom", "units": "m"}),
        "material": (
            "material",
            np.array(list(traced_medium.material_columns)),
            {"long_name": "material"},
        ),
    }
    return xr.Dataset(variables, coordinates, attributes)


def _make_flux_variable(
    name: str, dims: tuple[str, ...], batch_means: np.ndarray, stderr: np.ndarray, label: str
) -> dict[str, Variable]:
    """Return a variable and its error, from arrays whose last axis is the wavelength."""
    mean, error = (np.moveaxis(array, -1, 0) for array in (batch_means.mean(axis=0), stderr))
    return make_variable(name, dims, mean, error, label)


def _make_path_variables(result: FluxResult, traced_medium: TracedMedium) -> dict[str, Variable]:
    """Return actinic fluxes and absorptances of materials, from path lengths."""
    estimate, systematic, edges = result.estimate, result.systematic_error, traced_medium.edges_m
    absorption = traced_medium.constants.absorption[: traced_medium.n_wavelengths]
    steps = compute_absorption_steps(traced_medium.medium, absorption, edges)
    thickness = np.diff(edges)[:, np.newaxis]
    n_intervals = len(thickness)
    flux, material_absorptance = (
        _compute_actinic_flux(estimate, traced_medium),
        _compute_material_absorptance(estimate, traced_medium),
    )
    irradiance, absorptance = estimate.irradiance.mean(axis=0), estimate.absorptance.mean(axis=0)
    from_below = np.zeros_like(absorptance)
    from_below[: irradiance.shape[1] - 1] = irradiance[UPWARD, 1:]
    incident = (irradiance[DOWNWARD, :n_intervals] + from_below) / thickness
    bound = systematic.interpolation_bound
    flux_errors = [
        compute_batch_stderr(flux),
        compute_nonstatistical_error(flux, bound, systematic.unsampled_light),
        bound_actinic_flux_error(steps, flux.mean(axis=0), absorptance / thickness, incident),
    ]
    unscored = estimate.absorptance - estimate.material_absorptance.sum(axis=2)
    is_scored = estimate.material_absorptance.sum(axis=2).mean(axis=0) > 0.0
    unscored_bound = np.abs(unscored.mean(axis=0)) - np.where(
        is_scored, 2.0 * compute_batch_stderr(unscored), 0.0
    )
    material_bound = bound_material_absorptance_error(
        steps, material_absorptance.mean(axis=0), absorptance, np.maximum(unscored_bound, 0.0)
    )
    material_errors = [
        compute_batch_stderr(material_absorptance),
        compute_nonstatistical_error(
            material_absorptance, bound, systematic.unsampled_light[:, np.newaxis]
        ),
        material_bound,
    ]
    if result.perturbed_estimate is not None:
        flux_errors.append(
            (flux - _compute_actinic_flux(result.perturbed_estimate, traced_medium)).mean(axis=0)
        )
        material_errors.append(
            (
                material_absorptance
                - _compute_material_absorptance(result.perturbed_estimate, traced_medium)
            ).mean(axis=0)
        )
    error = _add_in_quadrature(flux_errors)
    if traced_medium.semi_infinite:
        error[-1] *= ~traced_medium.is_absorbing()
    flux_variable = _make_flux_variable(
        "actinic_flux", INTERVAL_DIMS, flux, error, ACTINIC_FLUX_LABEL
    )
    material_dims = (*INTERVAL_DIMS, "material")
    error = _add_in_quadrature(material_errors)
    label = "absorptance of a material"
    return flux_variable | _make_flux_variable(
        "absorptance_of_material", material_dims, material_absorptance, error, label
    )


def _compute_actinic_flux(estimate: FluxEstimate, traced_medium: TracedMedium) -> np.ndarray:
    """Return actinic fluxes by batch.

    The mean over a semi-infinite interval is 0 where anything absorbs; where nothing does, it is
    the value far from the top.
    """
    flux: np.ndarray = estimate.path_length / np.diff(traced_medium.planes_m)[:, np.newaxis]
    if traced_medium.semi_infinite:
        flux[:, -1] *= ~traced_medium.is_absorbing()
    return flux


def _compute_material_absorptance(
    estimate: FluxEstimate, traced_medium: TracedMedium
) -> np.ndarray:
    """Return absorptances of materials by batch."""
    columns = list(traced_medium.material_columns.values())
    return compute_absorbed_fractions(
        estimate._replace(material_absorptance=estimate.material_absorptance[:, :, columns])
    )


def _add_in_quadrature(errors: list[np.ndarray]) -> np.ndarray:
    """Return errors added in quadrature."""
    return np.sqrt(np.sum(np.square(errors), axis=0))


def compute_absorbed_fractions(estimate: FluxEstimate) -> np.ndarray:
    """Return the absorptance of each material; the sum over materials is the total absorptance.

    The shape is (N_BATCHES, intervals, materials, wavelengths); the materials' parts vary by batch
    to first order.  Where no path scores an interval, the fractions are those of the whole sample,
    and equal for all materials where none scores that either; the errors include this
    (`bound_material_absorptance_error`).
    """
    parts = estimate.material_absorptance
    total_scored = parts.sum(axis=2, keepdims=True)
    mean_scored = total_scored.mean(axis=0)
    sample_parts = parts.mean(axis=0).sum(axis=0, keepdims=True)
    sample_total = sample_parts.sum(axis=1, keepdims=True)
    equal = np.full_like(sample_parts, 1.0 / sample_parts.shape[1])
    fraction = np.broadcast_to(
        np.divide(sample_parts, sample_total, out=equal, where=sample_total > 0.0),
        mean_scored.shape[:1] + sample_parts.shape[1:],
    ).copy()
    np.divide(parts.mean(axis=0), mean_scored, out=fraction, where=mean_scored > 0.0)
    absorbed = estimate.absorptance[:, :, np.newaxis]
    mean_absorbed = absorbed.mean(axis=0)
    scale = np.divide(
        mean_absorbed, mean_scored, out=np.zeros_like(mean_absorbed), where=mean_scored > 0.0
    )
    return absorbed * fraction + scale * (parts - fraction * total_scored)
