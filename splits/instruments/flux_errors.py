"""Systematic errors of radiative fluxes inside a medium, besides the scatter of batches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.kernels.tallies.flux import DOWNWARD
from splits.simulation.interpolation_bounds import MAX_LOG_SLOPE

MIN_NONZERO_BATCHES = 8
"""Number of batches with light below which an error includes that of one more ray."""


MAX_BRIGHTENING = 4.0
"""Largest ratio of the light at a plane, or along paths below it, to that at the plane above."""


class SystematicError(NamedTuple):
    """Errors other than the scatter of batches.

    Attributes
    ----------
    irradiance : float, shape (2, depths, wavelengths)
        Of irradiances.
    absorptance : float, shape (intervals, wavelengths)
        Of absorptances.
    irreducible : list of float
        The part of both that more rays do not reduce: of interpolation, and of truncation.
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (intervals, wavelengths)
        See `bound_unsampled_light`.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    irreducible: list[np.ndarray]
    interpolation_bound: np.ndarray
    unsampled_light: np.ndarray


def estimate_systematic_error(
    estimates: Sequence[np.ndarray],
    perturbed_estimates: Sequence[np.ndarray] | None,
    interpolation_bound: np.ndarray,
    single_ray_error: np.ndarray,
) -> SystematicError:
    """Return the errors of irradiances and absorptances other than scatter.

    Parameters
    ----------
    estimates, perturbed_estimates : sequence of float
        Irradiance and absorptance, see `splits.instruments.flux_tally.FluxEstimate`; the same
        with a more absorbing substrate, None without truncation.
    interpolation_bound : float, shape (wavelengths,)
        Bound on the interpolation error, see `splits.simulation.spectral_nodes.IndexNodes`.
    single_ray_error : float, shape (wavelengths,)
        Contribution of one more ray to a mean.
    """
    unsampled = bound_unsampled_light(estimates[0][:, DOWNWARD], single_ray_error)
    unsampled_below = unsampled[1 : estimates[1].shape[1] + 1]
    irreducible = [
        bound_flux_interpolation_error(interpolation_bound, batch_means.mean(axis=0))
        for batch_means in estimates
    ]
    if perturbed_estimates is not None:
        irreducible = [
            np.hypot(error, (batch_means - perturbed).mean(axis=0))
            for error, batch_means, perturbed in zip(
                irreducible, estimates, perturbed_estimates, strict=True
            )
        ]
    rare_event_errors = [
        estimate_rare_event_error(*batch_means_and_light)
        for batch_means_and_light in zip(estimates, (unsampled[:-1], unsampled_below), strict=True)
    ]
    irradiance, absorptance = (
        np.hypot(error, rare_event_error)
        for error, rare_event_error in zip(irreducible, rare_event_errors, strict=True)
    )
    return SystematicError(
        irradiance, absorptance, irreducible, interpolation_bound, unsampled_below
    )


def estimate_rare_event_error(batch_means: np.ndarray, unsampled_light: np.ndarray) -> np.ndarray:
    """Return the errors of means that few batches dominate.

    A quantity with fewer than `MIN_NONZERO_BATCHES` nonzero batches may be wrong by one ray.  Where
    as few batches contribute most of it, an allowance is made for one more like the largest.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    unsampled_light : float, shape (..., wavelengths)
        Largest contribution of unsampled rays, see `bound_unsampled_light`.
    """
    total, square = np.abs(batch_means).sum(axis=0), (batch_means**2).sum(axis=0)
    largest = np.abs(batch_means).max(axis=0) / len(batch_means)
    largest_error = np.where(total**2 < MIN_NONZERO_BATCHES * square, largest, 0.0)
    return np.hypot(np.where(is_sparse(batch_means), unsampled_light, 0.0), largest_error)


def is_sparse(batch_means: np.ndarray) -> np.ndarray:
    """Return where only few batches are nonzero."""
    return (batch_means != 0.0).sum(axis=0) < MIN_NONZERO_BATCHES


def bound_unsampled_light(
    downward_irradiance: np.ndarray, single_ray_error: np.ndarray
) -> np.ndarray:
    """Return a bound on the light of unsampled rays at each depth and below it.

    It is that of one more ray, and at most a multiple of the light that reaches the plane above,
    since unsampled rays are absorbed on the way to it, too.

    Parameters
    ----------
    downward_irradiance : float, shape (N_BATCHES, depths, wavelengths)
        Irradiance downwards.
    single_ray_error : float, shape (wavelengths,)

    Returns
    -------
    float, shape (depths + 1, wavelengths)
        The last below the last depth.
    """
    sparse = is_sparse(downward_irradiance)
    mean_irradiance = downward_irradiance.mean(axis=0)
    bounds, ceiling = [single_ray_error], single_ray_error
    for is_rare, mean in zip(sparse, mean_irradiance, strict=True):
        ceiling = mean + np.where(is_rare, np.minimum(ceiling, single_ray_error), 0.0)
        bounds.append(np.minimum(single_ray_error, MAX_BRIGHTENING * ceiling))
    return np.stack(bounds)


def compute_nonstatistical_error(
    batch_means: np.ndarray, interpolation_bound: np.ndarray, unsampled_light: np.ndarray
) -> np.ndarray:
    """Return the errors of means over batches other than their scatter.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (..., wavelengths)
        See `estimate_rare_event_error`.
    """
    return np.hypot(
        bound_flux_interpolation_error(interpolation_bound, batch_means.mean(axis=0)),
        estimate_rare_event_error(batch_means, unsampled_light),
    )


def bound_flux_interpolation_error(
    interpolation_bound: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Return a bound on the interpolation error of irradiances and similar quantities.

    It is that of a reflectance (`splits.simulation.spectral_nodes`), with the elasticity |ln f| of
    quantities that decay exponentially with depth, where that is larger.

    Parameters
    ----------
    interpolation_bound : float, shape (wavelengths,)
    value : float, shape (..., wavelengths)
        Value of the quantity.
    """
    size = np.clip(np.abs(value), np.finfo(float).tiny, None)
    elastic = size * np.maximum(8.0, np.abs(np.log(size)) / MAX_LOG_SLOPE)
    return interpolation_bound * np.minimum(np.maximum(1.0, size), elastic)
