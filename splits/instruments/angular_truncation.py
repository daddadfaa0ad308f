"""Selection of expansion terms and the truncation error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.kernels.tallies.distributions import DiskBasis, evaluate_basis_at

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
        See `splits.instruments.angular_estimate.AngularEstimate`.
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
