"""Estimates of BRDFs from coefficients by batch: values, errors, and the rays still needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.angular_tally import N_ANGULAR_BATCHES, RAYS_PER_ROUND, ExpansionTally
from splits.instruments.angular_truncation import (
    DirectionGrid,
    compute_truncation_errors,
    select_terms,
)

INTERPOLATION_FACTOR = 8.0
"""Relative error of a BRDF from interpolation between refractive indices, in units of the bound for
a reflectance near 1/2; see `splits.simulation.estimators`."""

MAX_SPARSE_BATCHES = 8
"""Number of batches with light up to which the error is at least that of isotropic light."""

MIN_REFERENCE_FRACTION = 0.05
"""Fraction of an isotropic distribution below which the error is relative to that fraction."""


TallyVariances = dict[int, np.ndarray]
"""Variances by number of the tally, each of shape (classes, directions)."""


@dataclass(frozen=True)
class AngularEstimate:
    """Estimate of a BRDF and a BTDF.

    Attributes
    ----------
    mean, stderr : float, shape (2, wavelengths, directions)
        Reflected and transmitted (1/sr), of scattered light.
    stopping_error : float, shape (2, wavelengths, directions)
        Error for the stopping rule: the power of dropped terms is distributed evenly over
        directions.
    hemispherical : float, shape (4, 2, wavelengths)
        Directional-hemispherical reflectance and transmittance, their standard errors, and the
        same for their unscattered parts.
    degree : int, shape (2, wavelengths)
        Largest degree of a polynomial that was kept.
    truncation_error : float, shape (2, wavelengths, directions)
        Part of the standard errors due to detail finer than the polynomials (1/sr).
    """

    mean: np.ndarray
    stderr: np.ndarray
    stopping_error: np.ndarray
    hemispherical: np.ndarray
    degree: np.ndarray
    truncation_error: np.ndarray

    def compute_scattered(self) -> np.ndarray:
        """Return the reflectance and the transmittance of scattered light."""
        return self.hemispherical[0] - self.hemispherical[2]


def estimate_brdf(
    tallies: Sequence[ExpansionTally],
    interpolation_bound: np.ndarray,
    directions: DirectionGrid,
    axisymmetric: bool,
    side: int,
    direction_mask: np.ndarray,
) -> tuple[AngularEstimate, list[TallyVariances]]:
    """Estimate BRDF and BTDF, and the contributions of classes to their variance.

    Parameters
    ----------
    tallies : sequence of ExpansionTally
    interpolation_bound : float, shape (wavelengths,)
        See `splits.simulation.spectral_nodes.IndexNodes`.
    directions : DirectionGrid
    axisymmetric : bool
        See `select_terms`.
    side : int
        0 reflected, 1 transmitted; for the variances.
    direction_mask : bool, shape (directions,)
        Directions of the variances.

    Returns
    -------
    AngularEstimate
    variance : list of TallyVariances
        For each wavelength, the contributions of the classes of its tallies to the variance.
    """
    mean, stderr, stopping_error, truncation_error = np.zeros(
        (4, 2, len(interpolation_bound), len(directions.polynomials))
    )
    sums = np.zeros((4, 2, len(interpolation_bound)))
    degree = np.zeros((2, len(interpolation_bound)), dtype=int)
    variance: list[TallyVariances] = []
    for wavelength in range(len(interpolation_bound)):
        used = [
            number for number, tally in enumerate(tallies) if wavelength in tally.wavelength_rows
        ]
        coefficients = [tallies[number].compute_coefficients(wavelength) for number in used]
        total = np.sum(coefficients, axis=0)
        unscattered = np.sum(
            [tallies[number].compute_unscattered(wavelength) for number in used], axis=0
        )
        keep = select_terms(total, directions.basis, axisymmetric)
        class_variances = {}
        for number, coefficient in zip(used, coefficients, strict=True):
            values_by_class = (
                np.where(keep[:, side], coefficient[:, :, side], 0.0)
                @ directions.polynomials[direction_mask].T
            )
            class_variances[number] = values_by_class.var(axis=0, ddof=1) / N_ANGULAR_BATCHES
        variance.append(class_variances)
        values = np.where(keep, total, 0.0).sum(axis=1) @ directions.polynomials.T
        mean[:, wavelength] = values.mean(axis=0)
        total_error, stopping, truncation_error[:, wavelength] = compute_truncation_errors(
            compute_batch_stderr(values), total, keep, directions, axisymmetric
        )
        n_rays = np.min([tallies[number].count_rays() for number in used], axis=0)
        scattered = total[..., 0].sum(axis=1) / directions.basis.norms[0]
        sums[:, :, wavelength], sparse_error, unsampled_error = _compute_hemispherical(
            scattered, unscattered, n_rays
        )
        stderr[:, wavelength] = np.hypot(total_error, sparse_error[:, np.newaxis] / np.pi)
        stopping_error[:, wavelength] = np.hypot(stopping, unsampled_error[:, np.newaxis] / np.pi)
        degree[:, wavelength] = np.where(keep, directions.basis.degrees, 0).max(axis=(0, -1))
    interpolation_error = INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis] * mean
    sums[1::2] = np.hypot(sums[1::2], bound_interpolation_error(interpolation_bound, sums[::2]))
    stderr, stopping_error = (
        np.hypot(stderr, interpolation_error),
        np.hypot(stopping_error, interpolation_error),
    )
    return AngularEstimate(mean, stderr, stopping_error, sums, degree, truncation_error), variance


def _compute_hemispherical(
    scattered: np.ndarray, unscattered: np.ndarray, n_rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sums of an `AngularEstimate` at one wavelength, and allowances for sparse light.

    If no light was recorded, the error is that of one more ray in an unknown direction.  The
    scatter of a few rays underestimates the error where the polynomials are 0, so that an allowance
    is made for them, too.

    Parameters
    ----------
    scattered, unscattered : float, shape (batches, 2)
        Scattered and unscattered light.
    n_rays : int, shape (classes,)
        Rays.

    Returns
    -------
    sums : float, shape (4, 2)
    sparse, unsampled : float, shape (2,)
        Light recorded in too few batches, or not at all; only the latter enters the stopping rule.
    """
    total = scattered + unscattered
    n_nonzero = scattered.astype(bool).sum(axis=0)
    unsampled = np.where(n_nonzero == 0, 1.0 / n_rays[-1], 0.0)
    sparse = np.where(n_nonzero <= MAX_SPARSE_BATCHES, scattered.mean(axis=0), 0.0)
    errors = np.hypot(compute_batch_stderr(total), unsampled)
    unscattered_errors = np.hypot(
        compute_batch_stderr(unscattered), ~unscattered.any(axis=0) / n_rays[0]
    )
    sums = np.array([total.mean(axis=0), errors, unscattered.mean(axis=0), unscattered_errors])
    return sums, unsampled + sparse, unsampled


def bound_interpolation_error(interpolation_bound: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return a bound on the interpolation error of hemispherical quantities."""
    return interpolation_bound * np.clip(8.0 * value * (1.0 - value), 0.0, 1.0)


def compute_error_reference(estimate: AngularEstimate) -> np.ndarray:
    """Return the reference of relative errors, shape (2, wavelengths, directions).

    It is the value, or 1/20 of that of an isotropic distribution, whichever is larger.
    """
    isotropic = estimate.compute_scattered()[..., np.newaxis] / np.pi
    return np.maximum(estimate.mean, MIN_REFERENCE_FRACTION * isotropic)


def compute_max_relative_error(
    estimate: AngularEstimate,
    side: int,
    direction_mask: np.ndarray | slice = slice(None),
    *,
    use_stopping_error: bool = False,
) -> float:
    """Return the largest relative error of one side, over wavelengths with light.

    It is that of the standard errors, or of the errors for the stopping rule.
    """
    stderr = (estimate.stopping_error if use_stopping_error else estimate.stderr)[side][
        :, direction_mask
    ]
    reference = compute_error_reference(estimate)[side][:, direction_mask]
    return float(
        np.divide(stderr, reference, out=np.zeros_like(reference), where=reference > 0.0).max()
    )


def allocate_angular_rays(
    tallies: Sequence[ExpansionTally],
    variance: Sequence[TallyVariances],
    target_variances: np.ndarray,
) -> np.ndarray:
    """Return the rays of every stratum for the least cost, tally by tally.

    With V the variance per ray and c the segments of a ray in a class, Σ V/M reaches a target at
    the least Σ c·M for M = √(V/c)·Σ √(V·c)/target (Neyman's allocation), M being the rays that
    contribute to a class; the largest M over directions is taken.  Rays contribute to all classes
    up to that of their stratum, so M must not increase from class to class.

    Parameters
    ----------
    tallies : sequence of ExpansionTally
    variance : sequence of TallyVariances
        As `estimate_brdf` returns it.
    target_variances : float, shape (wavelengths, directions)
        Variances to reach.
    """
    n_rays = np.array([tally.count_rays() for tally in tallies])[:, :, np.newaxis]
    costs = np.array([tally.compute_class_costs() for tally in tallies])[:, :, np.newaxis]
    target_rays = np.zeros(n_rays.shape[:2])
    for class_variances, target in zip(variance, target_variances, strict=True):
        rows = list(class_variances)
        per_ray = np.stack([class_variances[number] for number in rows]) * n_rays[rows]
        root_cost = np.sqrt(per_ray * costs[rows]).sum(axis=(0, 1))
        # Directions without light need no rays.
        factor = np.divide(root_cost, target, out=np.zeros_like(root_cost), where=target > 0.0)
        required_rays = (np.sqrt(per_ray / costs[rows]) * factor).max(axis=-1)
        target_rays[rows] = np.maximum(target_rays[rows], required_rays)
    target_rays = np.maximum.accumulate(target_rays[:, ::-1], axis=1)[:, ::-1]
    stratum_rays = -np.diff(target_rays, axis=1, append=0.0)
    return np.maximum(np.ceil(1.1 * stratum_rays.ravel() / RAYS_PER_ROUND), 1.0) * RAYS_PER_ROUND
