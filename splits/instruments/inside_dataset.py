"""The light inside as a labelled dataset."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.instruments.inside import Found, Outcome, shares_of
from splits.instruments.inside_errors import besides, flux_missed, share_missed, steps_of
from splits.instruments.inside_media import Traced
from splits.instruments.labels import wavelength_axis
from splits.transport.sums.passages import DOWN, UP
from splits.uncertainty import Variable, deviations, quantity, stderr_of

BY_DEPTH, BY_INTERVAL = ("wavelength", "depth"), ("wavelength", "interval")
PATH = "mean path over thickness"


def labelled(
    result: Outcome, traced_medium: Traced, wavelengths: np.ndarray, attributes: dict[str, Any]
) -> xr.Dataset:
    """Return what was found as a dataset, see `splits.instruments.profile`.

    Parameters
    ----------
    outcome : Outcome
    traced : Traced
    wavelengths : float, shape (wavelengths,)
        nm.
    facts : dict
        Attributes.
    """
    found, doubt = result.estimate, result.systematic_error
    variables: dict[str, Variable] = {}
    for name, groups, besides_scatter, dims, label in (
        ("downward_irradiance", found.irradiance[:, DOWN], doubt.irradiance[DOWN], BY_DEPTH,
         "downward irradiance"),
        ("upward_irradiance", found.irradiance[:, UP], doubt.irradiance[UP], BY_DEPTH, "upward irradiance"),
        ("absorptance", found.absorptance, doubt.absorptance, BY_INTERVAL, "absorptance of the interval"),
    ):  # fmt: skip
        error = np.hypot(stderr_of(groups), besides_scatter)
        variables |= _variable(name, dims, groups, error, label)
        off = np.moveaxis(groups - groups.mean(axis=0), -1, 1)
        variables |= deviations(name, dims, off / np.sqrt(len(off) * (len(off) - 1)), label)
    variables |= _by_path(result, traced_medium)
    edges = traced_medium.edges_m
    depths = edges[np.isfinite(edges)]
    about = {"long_name": "depth", "units": "m", "positive": "down", "standard_name": "depth"}
    coordinates = {
        "wavelength": wavelength_axis(wavelengths),
        "depth": ("depth", depths, about),
        "interval_top": ("interval", edges[:-1], {"long_name": "top", "units": "m"}),
        "interval_bottom": ("interval", edges[1:], {"long_name": "bottom", "units": "m"}),
        "material": ("material", np.array(list(traced_medium.material_columns)), {"long_name": "material"}),
    }
    return xr.Dataset(variables, coordinates, attributes)


def _variable(
    name: str, dims: tuple[str, ...], batch_means: np.ndarray, stderr: np.ndarray, label: str
) -> dict[str, Variable]:
    """Return a variable and its error, from arrays whose last axis is that of wavelengths."""
    mean, error = (np.moveaxis(each, -1, 0) for each in (batch_means.mean(axis=0), stderr))
    return quantity(name, dims, mean, error, label)


def _by_path(result: Outcome, traced_medium: Traced) -> dict[str, Variable]:
    """Return actinic fluxes and what materials absorb, which lengths of paths tell."""
    found, doubt, edges = result.estimate, result.systematic_error, traced_medium.edges_m
    absorption = traced_medium.constants.absorption[: traced_medium.n_wavelengths]
    steps = steps_of(traced_medium.medium, absorption, edges)
    thickness = np.diff(edges)[:, np.newaxis]
    intervals = len(thickness)
    flux, shared = _flux(found, traced_medium), _shared(found, traced_medium)
    light, whole = found.irradiance.mean(axis=0), found.absorptance.mean(axis=0)
    from_below = np.zeros_like(whole)
    from_below[: light.shape[1] - 1] = light[UP, 1:]
    arriving = (light[DOWN, :intervals] + from_below) / thickness
    missed = [
        stderr_of(flux), besides(flux, doubt.interpolation_bound, doubt.unsampled_light),
        flux_missed(steps, flux.mean(axis=0), whole / thickness, arriving),
    ]  # fmt: skip
    told = found.absorptance - found.material_absorptance.sum(axis=2)
    heard = found.material_absorptance.sum(axis=2).mean(axis=0) > 0.0
    unheard = np.abs(told.mean(axis=0)) - np.where(heard, 2.0 * stderr_of(told), 0.0)
    off = share_missed(steps, shared.mean(axis=0), whole, np.maximum(unheard, 0.0))
    wrong = [
        stderr_of(shared), besides(shared, doubt.interpolation_bound, doubt.unsampled_light[:, np.newaxis]), off,
    ]  # fmt: skip
    if result.perturbed_estimate is not None:
        missed.append((flux - _flux(result.perturbed_estimate, traced_medium)).mean(axis=0))
        wrong.append((shared - _shared(result.perturbed_estimate, traced_medium)).mean(axis=0))
    error = _together(missed)
    if traced_medium.semi_infinite:
        error[-1] *= ~traced_medium.is_absorbing()
    found_flux = _variable("actinic_flux", BY_INTERVAL, flux, error, PATH)
    by_material = (*BY_INTERVAL, "material")
    error = _together(wrong)
    label = "absorptance of a material"
    return found_flux | _variable("absorptance_of_material", by_material, shared, error, label)


def _flux(estimate: Found, traced_medium: Traced) -> np.ndarray:
    """Return actinic fluxes by group.

    The mean over an interval without end is 0 where anything absorbs; where nothing does, it is
    that far from the top.
    """
    flux: np.ndarray = estimate.path_length / np.diff(traced_medium.planes_m)[:, np.newaxis]
    if traced_medium.semi_infinite:
        flux[:, -1] *= ~traced_medium.is_absorbing()
    return flux


def _shared(estimate: Found, traced_medium: Traced) -> np.ndarray:
    """Return absorptances of materials by group."""
    columns = list(traced_medium.material_columns.values())
    return shares_of(estimate._replace(material_absorptance=estimate.material_absorptance[:, :, columns]))


def _together(errors: list[np.ndarray]) -> np.ndarray:
    """Return errors added in quadrature."""
    total: np.ndarray = np.sqrt(np.sum(np.square(errors), axis=0))
    return total
