"""The light inside as a labelled dataset."""

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
from splits.instruments.flux_errors import (
    bound_actinic_flux_error,
    bound_material_absorptance_error,
    compute_absorption_steps,
    compute_nonstatistical_error,
)
from splits.instruments.flux_estimate import FluxEstimate, FluxResult, compute_absorbed_fractions
from splits.instruments.flux_media import TracedMedium
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.attributes import make_wavelength_coordinate

DEPTH_DIMS, INTERVAL_DIMS = ("wavelength", "depth"), ("wavelength", "interval")
ACTINIC_FLUX_LABEL = "mean path over thickness"


def make_flux_dataset(
    result: FluxResult,
    traced_medium: TracedMedium,
    wavelengths: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return what was found as a dataset, see `splits.instruments.irradiance_profile`.

    Parameters
    ----------
    result : Outcome
    traced_medium : Traced
    wavelengths : float, shape (wavelengths,)
        nm.
    attributes : dict
        Attributes.
    """
    found, doubt = result.estimate, result.systematic_error
    variables: dict[str, Variable] = {}
    for name, groups, besides_scatter, dims, label in (
        ("downward_irradiance", found.irradiance[:, DOWNWARD], doubt.irradiance[DOWNWARD], DEPTH_DIMS,
         "downward irradiance"),
        ("upward_irradiance", found.irradiance[:, UPWARD], doubt.irradiance[UPWARD], DEPTH_DIMS, "upward irradiance"),
        ("absorptance", found.absorptance, doubt.absorptance, INTERVAL_DIMS, "absorptance of the interval"),
    ):  # fmt: skip
        error = np.hypot(compute_batch_stderr(groups), besides_scatter)
        variables |= _make_flux_variable(name, dims, groups, error, label)
        off = np.moveaxis(groups - groups.mean(axis=0), -1, 1)
        variables |= make_deviation_variable(
            name, dims, off / np.sqrt(len(off) * (len(off) - 1)), label
        )
    variables |= _make_path_variables(result, traced_medium)
    edges = traced_medium.edges_m
    depths = edges[np.isfinite(edges)]
    about = {"long_name": "depth", "units": "m", "positive": "down", "standard_name": "depth"}
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "depth": ("depth", depths, about),
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
    """Return a variable and its error, from arrays whose last axis is that of wavelengths."""
    mean, error = (np.moveaxis(each, -1, 0) for each in (batch_means.mean(axis=0), stderr))
    return make_variable(name, dims, mean, error, label)


def _make_path_variables(result: FluxResult, traced_medium: TracedMedium) -> dict[str, Variable]:
    """Return actinic fluxes and what materials absorb, which lengths of paths tell."""
    found, doubt, edges = result.estimate, result.systematic_error, traced_medium.edges_m
    absorption = traced_medium.constants.absorption[: traced_medium.n_wavelengths]
    steps = compute_absorption_steps(traced_medium.medium, absorption, edges)
    thickness = np.diff(edges)[:, np.newaxis]
    intervals = len(thickness)
    flux, shared = (
        _compute_actinic_flux(found, traced_medium),
        _compute_material_absorptance(found, traced_medium),
    )
    light, whole = found.irradiance.mean(axis=0), found.absorptance.mean(axis=0)
    from_below = np.zeros_like(whole)
    from_below[: light.shape[1] - 1] = light[UPWARD, 1:]
    arriving = (light[DOWNWARD, :intervals] + from_below) / thickness
    missed = [
        compute_batch_stderr(flux), compute_nonstatistical_error(flux, doubt.interpolation_bound, doubt.unsampled_light),
        bound_actinic_flux_error(steps, flux.mean(axis=0), whole / thickness, arriving),
    ]  # fmt: skip
    told = found.absorptance - found.material_absorptance.sum(axis=2)
    heard = found.material_absorptance.sum(axis=2).mean(axis=0) > 0.0
    unheard = np.abs(told.mean(axis=0)) - np.where(heard, 2.0 * compute_batch_stderr(told), 0.0)
    off = bound_material_absorptance_error(
        steps, shared.mean(axis=0), whole, np.maximum(unheard, 0.0)
    )
    wrong = [
        compute_batch_stderr(shared), compute_nonstatistical_error(shared, doubt.interpolation_bound, doubt.unsampled_light[:, np.newaxis]), off,
    ]  # fmt: skip
    if result.perturbed_estimate is not None:
        missed.append(
            (flux - _compute_actinic_flux(result.perturbed_estimate, traced_medium)).mean(axis=0)
        )
        wrong.append(
            (shared - _compute_material_absorptance(result.perturbed_estimate, traced_medium)).mean(
                axis=0
            )
        )
    error = _add_in_quadrature(missed)
    if traced_medium.semi_infinite:
        error[-1] *= ~traced_medium.is_absorbing()
    found_flux = _make_flux_variable("actinic_flux", INTERVAL_DIMS, flux, error, ACTINIC_FLUX_LABEL)
    by_material = (*INTERVAL_DIMS, "material")
    error = _add_in_quadrature(wrong)
    label = "absorptance of a material"
    return found_flux | _make_flux_variable(
        "absorptance_of_material", by_material, shared, error, label
    )


def _compute_actinic_flux(estimate: FluxEstimate, traced_medium: TracedMedium) -> np.ndarray:
    """Return actinic fluxes by group.

    The mean over an interval without end is 0 where anything absorbs; where nothing does, it is
    that far from the top.
    """
    flux: np.ndarray = estimate.path_length / np.diff(traced_medium.planes_m)[:, np.newaxis]
    if traced_medium.semi_infinite:
        flux[:, -1] *= ~traced_medium.is_absorbing()
    return flux


def _compute_material_absorptance(
    estimate: FluxEstimate, traced_medium: TracedMedium
) -> np.ndarray:
    """Return absorptances of materials by group."""
    columns = list(traced_medium.material_columns.values())
    return compute_absorbed_fractions(
        estimate._replace(material_absorptance=estimate.material_absorptance[:, :, columns])
    )


def _add_in_quadrature(errors: list[np.ndarray]) -> np.ndarray:
    """Return errors added in quadrature."""
    total: np.ndarray = np.sqrt(np.sum(np.square(errors), axis=0))
    return total
