"""How much detail coefficients of a BRDF support, and what errors the rest of it leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.kernels.tallies.angular import DiskBasis, evaluate_basis_at

VARIANCE_PENALTY = 4.0
"""Variances by which coefficients' squares must on average exceed 0 to be kept.  From 1 on, what
one adds in noise is less than what it takes away in bias; 1 more because its square holds its
noise; the rest because the best of many choices is taken."""

N_ALWAYS_KEPT = 3
"""Polynomials that are kept in any case: the constant one and its neighbours with m = 0."""

BAND_DEGREES = 4
"""Degrees whose power is compared with that of as many below, to tell what lies beyond."""
SIGNIFICANCE_SIGMA = 4.0
"""Standard deviations of a normal variable that something found by chance exceeds as rarely as
coefficients must that are to tell of what lies beyond the polynomials."""
MAX_POWER_RATIO = 0.95
"""Largest ratio of these powers to go on with."""
POWER_MARGIN_SIGMA = 2.0
"""Standard errors of noise alone by which a power may be raised and the one before it lowered."""
NOISE_ALLOWANCE_SIGMA = 1.0
"""Standard errors of noise alone that are taken off the power of what was dropped.  Noise makes
it positive half of the time: counted in full, errors are a quarter too large where nothing is."""


@dataclass(frozen=True)
class DirectionGrid:
    """Directions in which results are wanted, azimuth running fastest.

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
    """Tell which polynomials the data support, bool[…, polynomials].

    Of each coefficient, the square it really has is lost if it is dropped, and its variance is
    gained if it is kept.  For each m those up to some l are kept, and never more for a higher m:
    the choice of largest gain, and its neighbours: what has only just been out of sight is what
    errors should cover.  The constant one always stays: it is the hemispherical reflectance.

    Parameters
    ----------
    coefficients : float, shape (groups, …, polynomials)
    basis : DiskBasis
    axisymmetric : bool
        The beam is normal to the surface, so that only m = 0 can be.
    """
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    # Where there is no light, nothing is gained by keeping anything.
    gain = mean**2 - VARIANCE_PENALTY * variance - np.finfo(float).tiny
    tallest = basis.n_per_m[0]
    orders = basis.n_per_m[:1] if axisymmetric else basis.n_per_m
    # Best total gain of m and all higher ones, if m keeps at most so many.
    best = np.zeros((len(orders) + 1, *mean.shape[:-1], tallest + 1))
    choice = np.zeros(best.shape, dtype=int)
    heights = np.arange(tallest + 1)
    ends = np.cumsum(basis.n_per_m)
    for m in reversed(range(len(orders))):
        part = slice(ends[m] - orders[m], ends[m])
        gained = np.full(best.shape[1:], -np.inf)
        gained[..., 0] = 0.0
        gained[..., 1 : orders[m] + 1] = np.cumsum(gain[..., part], axis=-1)
        gained += best[m + 1]
        best[m] = np.maximum.accumulate(gained, axis=-1)
        choice[m] = np.maximum.accumulate(np.where(gained == best[m], heights, 0), axis=-1)
    keep = np.zeros(mean.shape, dtype=bool)
    height = np.full(mean.shape[:-1], tallest)
    above = np.zeros_like(height)
    for m in range(len(orders)):
        part = slice(ends[m] - orders[m], ends[m])
        height = np.take_along_axis(choice[m], height[..., np.newaxis], axis=-1)[..., 0]
        height = np.maximum(height, m == 0)
        # One more where some are kept, and two of the rotationally symmetric ones.
        kept = np.maximum(height + (height > 0) + (m == 0), above)
        keep[..., part] = np.arange(orders[m]) < kept[..., np.newaxis]
        above = height
    return keep


def compute_truncation_errors(
    noise_stderr: np.ndarray,
    coefficients: np.ndarray,
    term_mask: np.ndarray,
    directions: DirectionGrid,
    axisymmetric: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return standard errors with detail that was dropped: stated, for steering, and what is finer.

    What was dropped adds up where what was kept does, class by class or, of the detail that classes
    have in common, in their sum, whichever is more.  Of an even spread it counts as far as noise
    does not feign it, and beyond that, in lobes, in full.  To steer, it is spread evenly, noise and
    all, so that no run stops early.  A lobe of which nothing is kept shows nowhere: its error
    remains spread evenly.

    Parameters
    ----------
    noise_stderr : float, shape (2, directions)
        Standard errors of what was kept as groups of rays tell them.
    coefficients : float, shape (groups, classes, 2, polynomials)
    term_mask : bool, shape (classes, 2, polynomials)
        See `select_terms`.
    directions : DirectionGrid
    axisymmetric : bool
        See `select_terms`.

    Returns
    -------
    stderr, steering, beyond : float, shape (2, directions)
        See `splits.instruments.angular_estimate.AngularEstimate`.
    """
    kept, rest = np.where(term_mask, coefficients, 0.0), np.where(term_mask, 0.0, coefficients)
    (apart, less), (common, less_common) = (
        [
            estimate_dropped_power(one, axisymmetric, directions.basis, doubt)
            for doubt in (0.0, NOISE_ALLOWANCE_SIGMA)
        ]
        for one in (rest, rest.sum(axis=1))
    )
    even = np.maximum(apart.sum(axis=0), common)[:, np.newaxis]
    where, joint = (
        np.maximum(1.0, compute_power_concentration(one, directions))
        for one in (kept, kept.sum(axis=1))
    )
    there = np.maximum(
        (less[..., np.newaxis] + apart[..., np.newaxis] * (where - 1.0)).sum(axis=0),
        less_common[:, np.newaxis] + common[:, np.newaxis] * (joint - 1.0),
    )
    beyond = estimate_truncation_error(coefficients.sum(axis=1), axisymmetric, directions)
    stderr, steering = (
        np.hypot(np.hypot(noise_stderr, np.sqrt(dropped)), beyond) for dropped in (there, even)
    )
    return stderr, steering, beyond


def estimate_dropped_power(
    coefficients: np.ndarray, axisymmetric: bool, basis: DiskBasis, noise_sigma: float = 0.0
) -> np.ndarray:
    """Return the mean square, over the hemisphere, of the detail that dropped coefficients hold.

    Their squares less their variances, as far as the sum is positive: what is too weak to be told
    from noise one by one may show in its sum.  So many standard errors (`noise_sigma`) of what that sum
    is by noise alone are taken off.
    """
    if axisymmetric:
        coefficients = coefficients[..., : basis.n_per_m[0]]
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    power = (coefficients.mean(axis=0) ** 2 - variance).sum(axis=-1)
    noise = np.sqrt(2.0 * (variance**2).sum(axis=-1))
    return np.maximum(power - noise_sigma * noise, 0.0) / np.pi


def compute_power_concentration(coefficients: np.ndarray, directions: DirectionGrid) -> np.ndarray:
    """Return the detail's square over its mean over the hemisphere, shape (…, directions).

    What a class drops adds up where what it keeps does: a lobe is cut where the lobe is.  To spread
    its power evenly would state too small an error there.  Polynomials that `select_terms` keeps in
    any case tell nothing of where detail is, nor does the part of the others that is noise: for
    that part, the answer is 1.

    Parameters
    ----------
    coefficients : float, shape (groups, …, polynomials)
        Coefficients, 0 for those that were dropped.
    """
    detail = coefficients[..., N_ALWAYS_KEPT:]
    mean, variance = detail.mean(axis=0), detail.var(axis=0, ddof=1) / len(detail)
    power = (mean**2).sum(axis=-1, keepdims=True)
    real = np.maximum(power - variance.sum(axis=-1, keepdims=True), 0.0)
    share = np.divide(real, power, out=np.zeros_like(power), where=power > 0.0)
    square = np.pi * (mean @ directions.polynomials[:, N_ALWAYS_KEPT:].T) ** 2
    square = np.divide(square, power, out=np.zeros_like(square), where=power > 0.0)
    found: np.ndarray = share * square + 1.0 - share
    return found


def is_significant(mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Tell whether coefficients together are more than noise, shape (…).

    Of k equal variances the sum of squares is distributed as χ², whose quantiles are near a cube
    (Wilson and Hilferty 1931); unequal ones are as if they were fewer (Satterthwaite 1946).
    """
    total = variance.sum(axis=-1)
    part = np.divide(variance, total[..., np.newaxis], out=np.zeros_like(variance),
                     where=total[..., np.newaxis] > 0.0)  # fmt: skip
    ninths = 2.0 / 9.0 * (part**2).sum(axis=-1)
    bound: np.ndarray = total * (1.0 - ninths + SIGNIFICANCE_SIGMA * np.sqrt(ninths)) ** 3
    return (mean**2).sum(axis=-1) > bound + np.finfo(float).tiny


def estimate_truncation_error(
    coefficients: np.ndarray, axisymmetric: bool, directions: DirectionGrid
) -> np.ndarray:
    """Return what detail finer than the polynomials may add, shape (2, directions).

    What the finest polynomials hold, if it stands out from noise, is taken to go on falling from
    band to band of degrees as it fell last: where they add up to a peak, finer ones would; and
    anywhere else their mean square over the hemisphere counts.  Of a lobe much narrower than the
    polynomials this is a lower bound, and so it is where detail that hardly falls has not yet
    risen well above the noise.
    """
    values = directions.polynomials
    if axisymmetric:
        coefficients = coefficients[..., : directions.basis.n_per_m[0]]
        values = values[:, : directions.basis.n_per_m[0]]
    degree = directions.basis.degrees[: coefficients.shape[-1]]
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    power = mean**2 - variance
    fine = degree > degree.max() - BAND_DEGREES
    coarse = (degree > degree.max() - 2 * BAND_DEGREES) & ~fine
    last, before = power[..., fine].sum(axis=-1), power[..., coarse].sum(axis=-1)
    noise, noise_before = (
        np.sqrt(2.0 * (variance[..., band] ** 2).sum(axis=-1)) for band in (fine, coarse)
    )
    tiny = np.finfo(float).tiny
    seen = is_significant(mean[..., fine], variance[..., fine])
    # A slow fall, which much follows from, is believed as far as noise does not feign it.
    least, most = (
        last - POWER_MARGIN_SIGMA * noise,
        np.maximum(before + POWER_MARGIN_SIGMA * noise_before, tiny),
    )
    fall = np.clip(least / most, 0.0, MAX_POWER_RATIO)
    everywhere = np.sqrt(np.where(seen, last * fall / (1.0 - fall), 0.0) / np.pi)
    fall = np.sqrt(fall)
    there = np.abs(mean[..., fine] @ values[:, fine].T)
    there *= np.where(seen, fall / (1.0 - fall), 0.0)[:, np.newaxis]
    return np.hypot(there, everywhere[:, np.newaxis])
