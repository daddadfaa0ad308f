"""Errors of radiative fluxes inside a medium other than the scatter of batches."""

from __future__ import annotations

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.simulation.spectral_nodes import MAX_LOG_SLOPE
from splits.simulation.tally import allow_for_unseen_rays

MIN_EFFECTIVE_BATCHES = 8
"""Effective number of batches with light below which an error includes that of one more ray."""
MAX_BRIGHTENING = 4.0
"""Largest ratio of the light at a plane, or along paths below it, to that at the plane above."""


def estimate_rare_event_error(batch_means: np.ndarray, unsampled_light: np.ndarray) -> np.ndarray:
    """Return the errors of means that few batches dominate.

    They may be wrong by one more ray, or by one more contribution like the largest.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    unsampled_light : float, shape (..., wavelengths)
        Largest contribution of unsampled rays, see `bound_unsampled_light`.
    """
    largest = np.abs(batch_means).max(axis=0) / len(batch_means)
    return np.where(is_sparse(batch_means), np.hypot(unsampled_light, largest), 0.0)


def is_sparse(batch_means: np.ndarray) -> np.ndarray:
    """Return where few batches contribute most of a quantity.

    (Σ x)²/Σ x² is the number of equal batches with the same relative scatter.
    """
    total, square = np.abs(batch_means).sum(axis=0), (batch_means**2).sum(axis=0)
    return np.asarray((square == 0.0) | (total**2 < MIN_EFFECTIVE_BATCHES * square))


def estimate_unseen_reflection(
    downward_irradiance: np.ndarray, upward_irradiance: np.ndarray, unsampled_light: np.ndarray
) -> np.ndarray:
    """Return the errors of upward irradiances by rays that grains reflect without entering.

    Below strongly absorbed light they are few, and all other light has a small weight
    (`splits.simulation.tally`).

    Parameters
    ----------
    downward_irradiance, upward_irradiance : float, shape (N_BATCHES, depths, wavelengths)
    unsampled_light : float, shape (depths, wavelengths)
        See `bound_unsampled_light`.
    """
    downward, upward = downward_irradiance.mean(axis=0), upward_irradiance.mean(axis=0)
    reflectance = np.divide(upward, downward, out=np.zeros_like(upward), where=downward > 0.0)
    single_ray_error = unsampled_light * (1.0 - np.minimum(reflectance, 1.0))
    variance = compute_batch_stderr(upward_irradiance) ** 2
    return np.sqrt(allow_for_unseen_rays(variance, single_ray_error**2) - variance)


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
