"""Estimates of BRDFs: values and errors by direction, from coefficients by batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from splits.core.uncertainty import ErrorTarget, compute_batch_stderr
from splits.kernels.records import DiskBasis
from splits.simulation.spectral_nodes import INTERPOLATION_FACTOR, bound_fraction_error
from splits.simulation.tally import Tally

# --------------------------------------------------------------------------------------------------
# Selection of expansion terms and the truncation error.

VARIANCE_PENALTY = 4.0
"""Number of variances by which the squares of coefficients must on average exceed 0 to be kept.
From 1 on, the noise added by a term is less than the bias removed; 1 more because the square
contains the noise; the rest because the best of many choices is taken."""

N_ALWAYS_KEPT = 3
"""Polynomials that are always kept: the constant one and its neighbours with m = 0."""

BAND_DEGREES = 4
"""Degrees of a band, whose power is compared with that of the band below for extrapolation."""
SIGNIFICANCE_SIGMA = 4.0
"""Significance, in standard deviations of a normal variable, of coefficients from which finer
detail is extrapolated."""
MAX_POWER_RATIO = 0.95
"""Largest ratio of these powers in the extrapolation."""
POWER_MARGIN_SIGMA = 2.0
"""Standard errors of noise by which a power may be raised and the one before it lowered."""
NOISE_ALLOWANCE_SIGMA = 1.0
"""Standard errors of noise that are subtracted from the power of dropped terms.  Noise makes it
positive half of the time: without the allowance, errors are a quarter too large where
it is zero."""


@dataclass(frozen=True)
class DirectionGrid:
    """Directions of the results, azimuth running fastest.

    Attributes
    ----------
    basis : DiskBasis
    polynomials : float, shape (directions, polynomials)
        The polynomials there.
    """

    basis: DiskBasis
    polynomials: np.ndarray


def make_direction_grid(
    polar_deg: np.ndarray, azimuth_deg: np.ndarray, basis: DiskBasis
) -> DirectionGrid:
    """Return a grid of directions with the polynomials there."""
    from splits.kernels.tallies.distributions import evaluate_basis_at

    polar, azimuth = np.radians(np.meshgrid(polar_deg, azimuth_deg, indexing="ij")).reshape(2, -1)
    sine = np.sin(polar)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=1)
    return DirectionGrid(basis, evaluate_basis_at(basis, directions))


def select_terms(coefficients: np.ndarray, basis: DiskBasis, axisymmetric: bool) -> np.ndarray:
    """Return which polynomials the data support, bool[…, polynomials].

    Dropping a coefficient loses the square of its true value, keeping it adds its variance.  For
    each m, terms up to some l are kept, and never more for a higher m: the choice of largest gain,
    and its neighbours, which the error estimate should cover.  The constant term is always kept: it
    is the hemispherical reflectance.

    Parameters
    ----------
    coefficients : float, shape (batches, …, polynomials)
    basis : DiskBasis
    axisymmetric : bool
        Whether the beam is normal to the surface, so that only m = 0 occurs.
    """
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    # Without light, no term has a gain.
    gain = mean**2 - VARIANCE_PENALTY * variance - np.finfo(float).tiny
    max_terms = basis.n_per_m[0]
    orders = basis.n_per_m[:1] if axisymmetric else basis.n_per_m
    # Best total gain of m and all higher ones, by the largest number of terms of m.
    best = np.zeros((len(orders) + 1, *mean.shape[:-1], max_terms + 1))
    choice = np.zeros(best.shape, dtype=int)
    n_terms = np.arange(max_terms + 1)
    ends = np.cumsum(basis.n_per_m)
    for m in reversed(range(len(orders))):
        terms = slice(ends[m] - orders[m], ends[m])
        gains = np.full(best.shape[1:], -np.inf)
        gains[..., 0] = 0.0
        gains[..., 1 : orders[m] + 1] = np.cumsum(gain[..., terms], axis=-1)
        gains += best[m + 1]
        best[m] = np.maximum.accumulate(gains, axis=-1)
        choice[m] = np.maximum.accumulate(np.where(gains == best[m], n_terms, 0), axis=-1)
    keep = np.zeros(mean.shape, dtype=bool)
    n_kept = np.full(mean.shape[:-1], max_terms)
    previous = np.zeros_like(n_kept)
    for m in range(len(orders)):
        terms = slice(ends[m] - orders[m], ends[m])
        n_kept = np.take_along_axis(choice[m], n_kept[..., np.newaxis], axis=-1)[..., 0]
        n_kept = np.maximum(n_kept, m == 0)
        # One more where some are kept, and two of the rotationally symmetric ones.
        kept = np.maximum(n_kept + (n_kept > 0) + (m == 0), previous)
        keep[..., terms] = np.arange(orders[m]) < kept[..., np.newaxis]
        previous = n_kept
    return keep


def compute_truncation_errors(
    noise_stderr: np.ndarray,
    coefficients: np.ndarray,
    term_mask: np.ndarray,
    directions: DirectionGrid,
    axisymmetric: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return standard errors with truncation: total, for the stopping rule, and of finer detail.

    The power of dropped terms is added where the kept terms are large, by class or, for detail that
    classes have in common, for their sum, whichever is more.  Up to an even distribution it counts
    after subtraction of the noise allowance; above, in lobes, in full.  For the stopping rule it is
    distributed evenly, including noise, so that no run stops early.  The error of a lobe of which
    no term is kept remains distributed evenly.

    Parameters
    ----------
    noise_stderr : float, shape (2, directions)
        Standard errors of the kept terms from batches.
    coefficients : float, shape (batches, classes, 2, polynomials)
    term_mask : bool, shape (classes, 2, polynomials)
        See `select_terms`.
    directions : DirectionGrid
    axisymmetric : bool
        See `select_terms`.

    Returns
    -------
    stderr, stopping_error, truncation_error : float, shape (2, directions)
        See `AngularEstimate`.
    """
    kept, dropped = np.where(term_mask, coefficients, 0.0), np.where(term_mask, 0.0, coefficients)
    (class_power, reduced_class_power), (sum_power, reduced_sum_power) = (
        estimate_dropped_power(terms, axisymmetric, directions.basis)
        for terms in (dropped, dropped.sum(axis=1))
    )
    even_power = np.maximum(class_power.sum(axis=0), sum_power)[:, np.newaxis]
    class_excess, sum_excess = (
        np.maximum(0.0, compute_power_concentration(terms, directions) - 1.0)
        for terms in (kept, kept.sum(axis=1))
    )
    by_class = reduced_class_power[..., np.newaxis] + class_power[..., np.newaxis] * class_excess
    by_sum = reduced_sum_power[:, np.newaxis] + sum_power[:, np.newaxis] * sum_excess
    local_power = np.maximum(by_class.sum(axis=0), by_sum)
    truncation_error = estimate_truncation_error(coefficients.sum(axis=1), axisymmetric, directions)
    stderr, stopping_error = (
        np.hypot(np.hypot(noise_stderr, np.sqrt(power)), truncation_error)
        for power in (local_power, even_power)
    )
    return stderr, stopping_error, truncation_error


def estimate_dropped_power(
    coefficients: np.ndarray, axisymmetric: bool, basis: DiskBasis
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square over the hemisphere of the detail in dropped coefficients.

    It is the sum of their squares minus their variances, where positive: terms that are
    individually insignificant may be significant in the sum.  From the second result, the noise
    allowance is subtracted: `NOISE_ALLOWANCE_SIGMA` standard errors of the sum for pure noise.
    """
    if axisymmetric:
        coefficients = coefficients[..., : basis.n_per_m[0]]
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    power = (coefficients.mean(axis=0) ** 2 - variance).sum(axis=-1)
    noise = NOISE_ALLOWANCE_SIGMA * np.sqrt(2.0 * (variance**2).sum(axis=-1))
    return np.maximum(power, 0.0) / np.pi, np.maximum(power - noise, 0.0) / np.pi


def compute_power_concentration(coefficients: np.ndarray, directions: DirectionGrid) -> np.ndarray:
    """Return the squared detail over its hemispherical mean, shape (…, directions).

    The dropped terms of a class are largest where its kept terms are: a truncated lobe has its
    error in the lobe, and an even distribution of its power would give too small an error there.
    Neither the polynomials that `select_terms` always keeps nor the noise of the others locate
    detail: for that part, the result is 1.

    Parameters
    ----------
    coefficients : float, shape (batches, …, polynomials)
        Coefficients, 0 for those that were dropped.
    """
    detail = coefficients[..., N_ALWAYS_KEPT:]
    mean, variance = detail.mean(axis=0), detail.var(axis=0, ddof=1) / len(detail)
    power = (mean**2).sum(axis=-1, keepdims=True)
    signal = np.maximum(power - variance.sum(axis=-1, keepdims=True), 0.0)
    signal_fraction = np.divide(signal, power, out=np.zeros_like(power), where=power > 0.0)
    square = np.pi * (mean @ directions.polynomials[:, N_ALWAYS_KEPT:].T) ** 2
    square = np.divide(square, power, out=np.zeros_like(square), where=power > 0.0)
    return signal_fraction * square + 1.0 - signal_fraction


def is_significant(mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return whether coefficients together are more than noise, shape (…).

    The sum of squares of k terms of equal variance is distributed as χ², whose quantiles are close
    to a cube (Wilson and Hilferty 1931); unequal variances act as a smaller k (Satterthwaite 1946).
    """
    total = variance.sum(axis=-1)
    fraction = np.divide(variance, total[..., np.newaxis], out=np.zeros_like(variance),
                     where=total[..., np.newaxis] > 0.0)  # fmt: skip
    ninths = 2.0 / 9.0 * (fraction**2).sum(axis=-1)
    bound: np.ndarray = total * (1.0 - ninths + SIGNIFICANCE_SIGMA * np.sqrt(ninths)) ** 3
    return (mean**2).sum(axis=-1) > bound + np.finfo(float).tiny


def estimate_truncation_error(
    coefficients: np.ndarray, axisymmetric: bool, directions: DirectionGrid
) -> np.ndarray:
    """Return the error of detail finer than the polynomials, shape (2, directions).

    The power of the highest polynomials, if it is significant, is extrapolated with the ratio of
    the last two bands of degrees: at full amplitude where they add up to a peak, and elsewhere as
    their mean square over the hemisphere.  For a lobe much narrower than the polynomials this is a
    lower bound, and also where slowly decreasing power is not yet well above the noise.
    """
    values = directions.polynomials
    if axisymmetric:
        coefficients = coefficients[..., : directions.basis.n_per_m[0]]
        values = values[:, : directions.basis.n_per_m[0]]
    degree = directions.basis.degrees[: coefficients.shape[-1]]
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    power = mean**2 - variance
    last_band = degree > degree.max() - BAND_DEGREES
    previous_band = (degree > degree.max() - 2 * BAND_DEGREES) & ~last_band
    (last_power, noise), (previous_power, previous_noise) = (
        (power[..., band].sum(axis=-1), np.sqrt(2.0 * (variance[..., band] ** 2).sum(axis=-1)))
        for band in (last_band, previous_band)
    )
    significant = is_significant(mean[..., last_band], variance[..., last_band])
    # A slow decrease, which gives large errors, is accepted only as far as noise cannot cause it.
    low = last_power - POWER_MARGIN_SIGMA * noise
    high = previous_power + POWER_MARGIN_SIGMA * previous_noise
    ratio = np.clip(low / np.maximum(high, np.finfo(float).tiny), 0.0, MAX_POWER_RATIO)
    mean_error = np.sqrt(np.where(significant, last_power * ratio / (1.0 - ratio), 0.0) / np.pi)
    ratio = np.sqrt(ratio)
    local_error = np.abs(mean[..., last_band] @ values[:, last_band].T)
    local_error *= np.where(significant, ratio / (1.0 - ratio), 0.0)[:, np.newaxis]
    return np.hypot(local_error, mean_error[:, np.newaxis])


# --------------------------------------------------------------------------------------------------
# Estimates of BRDFs: values and errors by direction, from coefficients by batch.

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
    hemispherical, hemispherical_stderr : float, shape (2, wavelengths)
        Directional-hemispherical reflectance and transmittance.
    unscattered, unscattered_stderr : float, shape (2, wavelengths)
        Their unscattered parts.
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
    hemispherical_stderr: np.ndarray
    unscattered: np.ndarray
    unscattered_stderr: np.ndarray
    degree: np.ndarray
    truncation_error: np.ndarray
    anisotropy: np.ndarray
    anisotropy_stderr: np.ndarray

    def compute_reference(self, target: ErrorTarget) -> np.ndarray:
        """Return the reference of errors, shape (wavelengths, directions of the target)."""
        values = self.mean[target.side][:, target.direction_mask]
        scattered = (self.hemispherical - self.unscattered)[target.side]
        return target.compute_reference(values, scattered)

    def compute_max_error(self, target: ErrorTarget, *, use_stopping_error: bool = False) -> float:
        """Return the largest error of a target, over wavelengths with light.

        It is that of the standard errors, or of the errors for the stopping rule.
        """
        stderr = (self.stopping_error if use_stopping_error else self.stderr)[target.side]
        reference = self.compute_reference(target)
        error = np.divide(
            stderr[:, target.direction_mask], reference, out=np.zeros_like(reference),
            where=reference != 0.0,
        )  # fmt: skip
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
    **dict.fromkeys(AngularEstimate._fields, 1), "anisotropy": 0, "anisotropy_stderr": 0,
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
    totals = scattered + unscattered
    # If no light was recorded, the error is that of one more ray in an unknown direction.  The
    # scatter of a few rays underestimates the error where the polynomials are 0, so that an
    # allowance is made for them, too; only the former enters the stopping rule.
    n_nonzero = scattered.astype(bool).sum(axis=0)
    unsampled = np.where(n_nonzero == 0, 1.0 / n_rays[-1], 0.0)
    few = np.where(n_nonzero <= MAX_SPARSE_BATCHES, scattered.mean(axis=0), 0.0)
    sparse = unsampled + few
    detail = np.sqrt(np.maximum(stderr[0] ** 2 - noise[0] ** 2, 0.0) + (sparse[0] / np.pi) ** 2)
    # Noise that the BRDF has in common with the reflectance cancels in the anisotropy factor.
    brdf, reflectance = values[:, 0], totals[:, 0]
    mean_brdf, mean_reflectance = brdf.mean(axis=0), reflectance.mean()
    ratio = mean_brdf / mean_reflectance if mean_reflectance > 0.0 else np.zeros_like(mean_brdf)
    own_noise = compute_batch_stderr(brdf - ratio * reflectance[:, np.newaxis])
    anisotropy, anisotropy_stderr = compute_anisotropy(
        mean_brdf, np.hypot(own_noise, detail), mean_reflectance
    )
    estimate = AngularEstimate(
        values.mean(axis=0),
        np.hypot(stderr, sparse[:, np.newaxis] / np.pi),
        np.hypot(stopping_error, unsampled[:, np.newaxis] / np.pi),
        totals.mean(axis=0),
        np.hypot(compute_batch_stderr(totals), unsampled),
        unscattered.mean(axis=0),
        np.hypot(compute_batch_stderr(unscattered), ~unscattered.any(axis=0) / n_rays[0]),
        np.where(keep, directions.basis.degrees, 0).max(axis=(0, -1)),
        truncation_error,
        anisotropy,
        anisotropy_stderr,
    )
    return estimate, variances


def join_wavelengths(
    estimates: Sequence[AngularEstimate], join: Callable[..., np.ndarray] = np.concatenate
) -> AngularEstimate:
    """Return estimates as one, with the wavelengths of one after those of the other.

    With `numpy.stack`, each estimate is that of one wavelength, without an axis of wavelengths.
    """
    arrays = zip(AngularEstimate._fields, zip(*estimates, strict=True), strict=True)
    return AngularEstimate(**{
        name: join(rows, axis=WAVELENGTH_AXES[name]) for name, rows in arrays
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
    of_totals, of_unscattered = (
        bound_fraction_error(interpolation_bound, fractions)
        for fractions in (estimate.hemispherical, estimate.unscattered)
    )
    return estimate._replace(
        stderr=np.hypot(estimate.stderr, error),
        stopping_error=np.hypot(estimate.stopping_error, error),
        hemispherical_stderr=np.hypot(estimate.hemispherical_stderr, of_totals),
        unscattered_stderr=np.hypot(estimate.unscattered_stderr, of_unscattered),
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
