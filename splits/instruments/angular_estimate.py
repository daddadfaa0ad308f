"""Estimates of BRDFs: values and errors by direction, from coefficients by batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.angular_truncation import (
    DirectionGrid,
    compute_truncation_errors,
    select_terms,
)
from splits.simulation.spectral_nodes import INTERPOLATION_FACTOR, bound_fraction_error
from splits.simulation.tally import Tally

N_ANGULAR_BATCHES = 64
"""Number of batches for the estimation of errors, to 9 %."""
MAX_SPARSE_BATCHES = 8
"""Number of batches with light up to which the error is at least that of isotropic light."""


class AngularTally(Tally):
    """Tally whose estimate is an `AngularEstimate`; see `Tally`.

    Attributes
    ----------
    undefined_variables : tuple of str
        Variables of the dataset that the scene leaves undefined.
    """

    undefined_variables: tuple[str, ...] = ()

    def make_stokes(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return variables of polarized light with their errors, by name, if they are tallied."""
        return {}


class AngularEstimate(NamedTuple):
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
    anisotropy, anisotropy_stderr : float, shape (wavelengths, directions)
        Anisotropy factor, and its error without what BRDF and reflectance have in common, where
        that is known.
    """

    mean: np.ndarray
    stderr: np.ndarray
    stopping_error: np.ndarray
    hemispherical: np.ndarray
    degree: np.ndarray
    truncation_error: np.ndarray
    anisotropy: np.ndarray
    anisotropy_stderr: np.ndarray

    def compute_scattered(self) -> np.ndarray:
        """Return the reflectance and the transmittance of scattered light."""
        return self.hemispherical[0] - self.hemispherical[2]

    def compute_reference(self, target: ErrorTarget) -> np.ndarray:
        """Return the reference of errors, shape (wavelengths, directions of the target)."""
        values = self.mean[target.side][:, target.direction_mask]
        return target.compute_reference(values, self.compute_scattered()[target.side])

    def compute_max_error(self, target: ErrorTarget, *, use_stopping_error: bool = False) -> float:
        """Return the largest error of a target, over wavelengths with light.

        It is that of the standard errors, or of the errors for the stopping rule.
        """
        stderr = (self.stopping_error if use_stopping_error else self.stderr)[target.side]
        reference = self.compute_reference(target)
        error = np.zeros_like(reference)
        np.divide(stderr[:, target.direction_mask], reference, out=error, where=reference != 0.0)
        return float(error.max())

    def is_truncation_limited(self, target: ErrorTarget, max_error: float) -> bool:
        """Return whether only detail finer than the polynomials prevents convergence."""
        stderr, truncation_error = (
            error[target.side][:, target.direction_mask]
            for error in (self.stopping_error, self.truncation_error)
        )
        statistical_error = np.sqrt(np.maximum(stderr**2 - truncation_error**2, 0.0))
        return bool((statistical_error <= max_error * self.compute_reference(target)).all())


WAVELENGTH_AXES = {
    "mean": 1, "stderr": 1, "stopping_error": 1, "hemispherical": 2, "degree": 1,
    "truncation_error": 1, "anisotropy": 0, "anisotropy_stderr": 0,
}  # fmt: skip
"""Axis of the wavelengths in the arrays of an estimate."""


def estimate_row(
    coefficients: Sequence[np.ndarray],
    unscattered: np.ndarray,
    n_rays: np.ndarray,
    directions: DirectionGrid,
    axisymmetric: bool,
    target: ErrorTarget,
) -> tuple[AngularEstimate, list[np.ndarray]]:
    """Estimate BRDF and BTDF at one wavelength, without the error of interpolation.

    Parameters
    ----------
    coefficients : sequence of float, shape (batches, classes, 2, polynomials)
        Contribution of each index node.
    unscattered : float, shape (batches, 2)
        Unscattered light.
    n_rays : int, shape (classes,)
        Rays that contribute to each class.
    directions : DirectionGrid
    axisymmetric : bool
        Whether the light is incident along the normal, or diffuse.
    target : ErrorTarget

    Returns
    -------
    AngularEstimate
        Without the axis of wavelengths.
    variances : list of float, shape (classes, directions of the target)
        Contributions of each node to the variance.
    """
    total = np.sum(coefficients, axis=0)
    keep = select_terms(total, directions.basis, axisymmetric)
    variances, polynomials = [], directions.polynomials[target.direction_mask].T
    for coefficient in coefficients:
        of_side = np.where(keep[:, target.side], coefficient[:, :, target.side], 0.0)
        values_by_class = of_side @ polynomials
        variances.append(values_by_class.var(axis=0, ddof=1) / N_ANGULAR_BATCHES)
    values = np.where(keep, total, 0.0).sum(axis=1) @ directions.polynomials.T
    noise = compute_batch_stderr(values)
    stderr, stopping_error, truncation_error = compute_truncation_errors(
        noise, total, keep, directions, axisymmetric
    )
    scattered = total[..., 0].sum(axis=1) / directions.basis.norms[0]
    hemispherical, sparse, unsampled = _compute_hemispherical(scattered, unscattered, n_rays)
    detail = np.sqrt(np.maximum(stderr[0] ** 2 - noise[0] ** 2, 0.0) + (sparse[0] / np.pi) ** 2)
    reflectance = scattered[:, 0] + unscattered[:, 0]
    common = _compute_relative_noise(values[:, 0], reflectance)
    anisotropy, anisotropy_stderr = compute_anisotropy(
        values[:, 0].mean(axis=0), np.hypot(common, detail), reflectance.mean()
    )
    estimate = AngularEstimate(
        values.mean(axis=0),
        np.hypot(stderr, sparse[:, np.newaxis] / np.pi),
        np.hypot(stopping_error, unsampled[:, np.newaxis] / np.pi),
        hemispherical,
        np.where(keep, directions.basis.degrees, 0).max(axis=(0, -1)),
        truncation_error,
        anisotropy,
        anisotropy_stderr,
    )
    return estimate, variances


def stack_rows(
    estimates: Sequence[AngularEstimate], interpolation_bound: np.ndarray
) -> AngularEstimate:
    """Return the estimates of wavelengths as one, with the error of interpolation."""
    arrays = zip(AngularEstimate._fields, zip(*estimates, strict=True), strict=True)
    stacked = {name: np.stack(rows, axis=WAVELENGTH_AXES[name]) for name, rows in arrays}
    return add_interpolation_error(AngularEstimate(**stacked), interpolation_bound)


def join_wavelengths(estimates: Sequence[AngularEstimate]) -> AngularEstimate:
    """Return estimates as one, with the wavelengths of one after those of the other."""
    arrays = zip(AngularEstimate._fields, zip(*estimates, strict=True), strict=True)
    return AngularEstimate(**{
        name: np.concatenate(rows, axis=WAVELENGTH_AXES[name]) for name, rows in arrays
    })  # fmt: skip


def add_interpolation_error(
    estimate: AngularEstimate, interpolation_bound: np.ndarray
) -> AngularEstimate:
    """Return an estimate whose errors include that of interpolation between index nodes.

    Parameters
    ----------
    estimate : AngularEstimate
    interpolation_bound : float, shape (wavelengths,)
        See `splits.simulation.spectral_nodes.IndexNodes`.
    """
    error = INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis] * estimate.mean
    hemispherical = estimate.hemispherical.copy()
    hemispherical[1::2] = np.hypot(
        hemispherical[1::2], bound_fraction_error(interpolation_bound, hemispherical[::2])
    )
    return estimate._replace(
        stderr=np.hypot(estimate.stderr, error),
        stopping_error=np.hypot(estimate.stopping_error, error),
        hemispherical=hemispherical,
        anisotropy_stderr=np.hypot(
            estimate.anisotropy_stderr,
            INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis] * estimate.anisotropy,
        ),
    )


def compute_anisotropy(
    brdf: np.ndarray, stderr: np.ndarray, reflectance: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return anisotropy factors and their errors, 0 without light.

    Parameters
    ----------
    brdf, stderr : float, shape (..., directions)
        BRDF and its error relative to the reflectance (1/sr).
    reflectance : float, shape (...)
    """
    total = np.asarray(reflectance, dtype=float)[..., np.newaxis]
    scale = np.divide(np.pi, total, out=np.zeros_like(total), where=total > 0.0)
    return scale * brdf, scale * stderr


def _compute_relative_noise(brdf: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Return the statistical error of a BRDF relative to the reflectance, shape (directions,).

    Parameters
    ----------
    brdf : float, shape (batches, directions)
    reflectance : float, shape (batches,)
    """
    mean = reflectance.mean()
    ratio = brdf.mean(axis=0) / mean if mean > 0.0 else np.zeros(brdf.shape[1])
    noise: np.ndarray = compute_batch_stderr(brdf - ratio * reflectance[:, np.newaxis])
    return noise


def _compute_hemispherical(
    scattered: np.ndarray, unscattered: np.ndarray, n_rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return hemispherical quantities at one wavelength, and allowances for sparse light.

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
    hemispherical : float, shape (4, 2)
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
