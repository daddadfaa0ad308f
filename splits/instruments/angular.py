"""From coefficients by groups of rays to a BRDF, its errors, and the rays that are still wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.instruments.directional import GROUPS, ROUND, Directional
from splits.transport.directions import Basis, evaluate_all

PENALTY = 4.0
"""Variances by which coefficients' squares must on average exceed 0 to be kept.  From 1 on, what
one adds in noise is less than what it takes away in bias; 1 more because its square holds its
noise; the rest because the best of many choices is taken."""

ALWAYS = 3
"""Polynomials that are kept in any case: the constant one and its neighbours with m = 0."""

BIAS = 8.0
"""What interpolation between refractive indices misses of a BRDF, relative, in units of its bound
for a reflectance near 1/2; see `splits.instruments.estimators`."""


BAND = 4
"""Degrees whose power is compared with that of as many below, to tell what lies beyond."""
SLOWEST = 0.95
"""Largest ratio of these powers to go on with."""
DOUBT = 2.0
"""Standard errors of noise alone by which a power may be raised and the one before it lowered."""

LEAST = 0.05
"""Part of an even spread of light below which relative errors are not asked for."""


Shares = dict[int, np.ndarray]
"""Variances by number of the ensemble, each of shape (classes, directions)."""


@dataclass(frozen=True)
class Angles:
    """Directions in which results are wanted, azimuth running fastest.

    Attributes
    ----------
    basis : Basis
    values : float, shape (directions, polynomials)
        The polynomials there.
    """

    basis: Basis
    values: np.ndarray


def angles_of(polar_deg: np.ndarray, azimuth_deg: np.ndarray, basis: Basis) -> Angles:
    """Return a grid of directions with the polynomials there."""
    polar, azimuth = np.radians(np.meshgrid(polar_deg, azimuth_deg, indexing="ij")).reshape(2, -1)
    sine = np.sin(polar)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=1)
    return Angles(basis, evaluate_all(basis, directions))


@dataclass(frozen=True)
class Estimate:
    """A BRDF and a BTDF so far.

    Attributes
    ----------
    mean, stderr : float, shape (2, wavelengths, directions)
        Reflected and transmitted (1/sr), of light that met a grain.
    steering : float, shape (2, wavelengths, directions)
        The error by which runs are steered: what was dropped is spread evenly over directions.
    sums : float, shape (4, 2, wavelengths)
        Directional-hemispherical reflectance and transmittance, their standard errors, and the
        same of the part of these that met no grain.
    degree : int, shape (2, wavelengths)
        Largest degree of a polynomial that was kept.
    beyond : float, shape (2, wavelengths, directions)
        Part of the standard errors that stands for detail finer than the polynomials (1/sr).
    """

    mean: np.ndarray
    stderr: np.ndarray
    steering: np.ndarray
    sums: np.ndarray
    degree: np.ndarray
    beyond: np.ndarray

    def scattered(self) -> np.ndarray:
        """Return the reflectance and the transmittance of light that met a grain."""
        return self.sums[0] - self.sums[2]


def supported(coefficients: np.ndarray, basis: Basis, symmetric: bool) -> np.ndarray:
    """Tell which polynomials the data support, bool[…, polynomials].

    Of each coefficient, the square it really has is lost if it is dropped, and its variance is
    gained if it is kept.  For each m those up to some l are kept, and never more for a higher m:
    the choice of largest gain, and its neighbours: what has only just been out of sight is what
    errors should cover.  The constant one always stays: it is the hemispherical reflectance.

    Parameters
    ----------
    coefficients : float, shape (groups, …, polynomials)
    basis : Basis
    symmetric : bool
        The beam is normal to the surface, so that only m = 0 can be.
    """
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    # Where there is no light, nothing is gained by keeping anything.
    gain = mean**2 - PENALTY * variance - np.finfo(float).tiny
    tallest = basis.per_m[0]
    orders = basis.per_m[:1] if symmetric else basis.per_m
    # Best total gain of m and all higher ones, if m keeps at most so many.
    best = np.zeros((len(orders) + 1, *mean.shape[:-1], tallest + 1))
    choice = np.zeros(best.shape, dtype=int)
    heights = np.arange(tallest + 1)
    ends = np.cumsum(basis.per_m)
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


def estimate(
    ensembles: Sequence[Directional],
    bias: np.ndarray,
    angles: Angles,
    symmetric: bool,
    side: int,
    counted: np.ndarray,
) -> tuple[Estimate, list[Shares]]:
    """Estimate BRDF and BTDF, and how much each class adds to their variance.

    Parameters
    ----------
    ensembles : sequence of Directional
    bias : float, shape (wavelengths,)
        See `splits.instruments.nodes.Nodes`.
    angles : Angles
    symmetric : bool
        See `supported`.
    side : int
        0 reflected, 1 transmitted; for the variances.
    counted : bool, shape (directions,)
        Directions whose variances are wanted.

    Returns
    -------
    Estimate
    variance : list of Shares
        For each wavelength, what the classes of the ensembles it draws on add to the variance.
    """
    basis = ensembles[0].basis
    wavelengths, directions = len(bias), len(angles.values)
    mean, stderr, steering = np.zeros((3, 2, wavelengths, directions))
    sums = np.zeros((4, 2, wavelengths))
    degree = np.zeros((2, wavelengths), dtype=int)
    beyond = np.zeros((2, wavelengths, directions))
    variance: list[Shares] = []
    for column in range(wavelengths):
        drawn = [i for i, e in enumerate(ensembles) if column in e.place]
        parts = [ensembles[i].coefficients(column) for i in drawn]
        together = np.sum(parts, axis=0)
        straight = np.sum([ensembles[i].unscattered(column) for i in drawn], axis=0)
        keep = supported(together, basis, symmetric)
        values = np.where(keep, together, 0.0).sum(axis=1) @ angles.values.T
        shares = {}
        for i, part in zip(drawn, parts, strict=True):
            one = np.where(keep[:, side], part[:, :, side], 0.0) @ angles.values[counted].T
            shares[i] = one.var(axis=0, ddof=1) / GROUPS
        variance.append(shares)
        whole = together[..., 0].sum(axis=1) / basis.scale[0] + straight
        rest = np.where(keep, 0.0, together)
        # Classes may have the same detail, or each its own.
        apart = _detail(rest, symmetric, basis)
        even = np.maximum(apart.sum(axis=0), _detail(rest.sum(axis=1), symmetric, basis))
        even = even[:, np.newaxis]
        finest = finer(together.sum(axis=1), symmetric, angles)
        beyond[:, column] = finest
        mean[:, column] = values.mean(axis=0)
        where = np.maximum(1.0, concentration(np.where(keep, together, 0.0), angles))
        there = np.maximum(even, (apart[..., np.newaxis] * where).sum(axis=0))
        for errors, dropped in ((steering, even), (stderr, there)):
            errors[:, column] = np.hypot(stderr_of(values), np.sqrt(dropped))
            errors[:, column] = np.hypot(errors[:, column], finest)
        sums[:, :, column] = (
            whole.mean(axis=0), stderr_of(whole), straight.mean(axis=0), stderr_of(straight),
        )  # fmt: skip
        # Nothing seen is not certainty: as if one more ray had come, from no matter where.
        unseen = 1.0 / min(ensembles[i].counts()[-1] for i in drawn)
        dark = ~together[..., 0].any(axis=(0, 1))
        stderr[dark, column] = steering[dark, column] = unseen / np.pi
        sums[1, dark, column] = np.hypot(sums[1, dark, column], unseen)
        degree[:, column] = np.where(keep, basis.degree, 0).max(axis=(0, -1))
    missed = BIAS * bias[:, np.newaxis] * mean
    sums[1::2] = np.hypot(sums[1::2], missed_of_totals(bias, sums[::2]))
    stderr, steering = np.hypot(stderr, missed), np.hypot(steering, missed)
    return Estimate(mean, stderr, steering, sums, degree, beyond), variance


def _detail(dropped: np.ndarray, symmetric: bool, basis: Basis) -> np.ndarray:
    """Return the mean square, over the hemisphere, of the detail that dropped coefficients hold.

    Their squares less their variances, as far as the sum is positive: what is too weak to be told
    from noise one by one may show in its sum.
    """
    if symmetric:
        dropped = dropped[..., : basis.per_m[0]]
    variance = dropped.var(axis=0, ddof=1) / len(dropped)
    return np.maximum((dropped.mean(axis=0) ** 2 - variance).sum(axis=-1), 0.0) / np.pi


def concentration(kept: np.ndarray, angles: Angles) -> np.ndarray:
    """Return the detail's square over its mean over the hemisphere, shape (…, directions).

    What a class drops adds up where what it keeps does: a lobe is cut where the lobe is.  To spread
    its power evenly would state too small an error there.  Polynomials that `supported` keeps in
    any case tell nothing of where detail is, nor does the part of the others that is noise: for
    that part, the answer is 1.

    Parameters
    ----------
    kept : float, shape (groups, …, polynomials)
        Coefficients, 0 for those that were dropped.
    """
    detail = kept[..., ALWAYS:]
    mean, variance = detail.mean(axis=0), detail.var(axis=0, ddof=1) / len(detail)
    power = (mean**2).sum(axis=-1, keepdims=True)
    real = np.maximum(power - variance.sum(axis=-1, keepdims=True), 0.0)
    share = np.divide(real, power, out=np.zeros_like(power), where=power > 0.0)
    square = np.pi * (mean @ angles.values[:, ALWAYS:].T) ** 2
    square = np.divide(square, power, out=np.zeros_like(square), where=power > 0.0)
    found: np.ndarray = share * square + 1.0 - share
    return found


def finer(coefficients: np.ndarray, symmetric: bool, angles: Angles) -> np.ndarray:
    """Return what detail finer than the polynomials may add, shape (2, directions).

    What the finest polynomials hold, if it stands out from noise, is taken to go on falling from
    band to band of degrees as it fell last: where they add up to a peak, finer ones would; and
    anywhere else their mean square over the hemisphere counts.  Of a lobe much narrower than the
    polynomials this is a lower bound, and so it is where detail that hardly falls has not yet
    risen well above the noise.
    """
    values = angles.values
    if symmetric:
        coefficients = coefficients[..., : angles.basis.per_m[0]]
        values = values[:, : angles.basis.per_m[0]]
    degree = angles.basis.degree[: coefficients.shape[-1]]
    mean = coefficients.mean(axis=0)
    variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
    power = mean**2 - variance
    fine = degree > degree.max() - BAND
    coarse = (degree > degree.max() - 2 * BAND) & ~fine
    last, before = power[..., fine].sum(axis=-1), power[..., coarse].sum(axis=-1)
    noise, noise_before = (
        np.sqrt(2.0 * (variance[..., band] ** 2).sum(axis=-1)) for band in (fine, coarse)
    )
    tiny = np.finfo(float).tiny
    seen = last > PENALTY * noise + tiny
    # A slow fall, which much follows from, is believed as far as noise does not feign it.
    least, most = last - DOUBT * noise, np.maximum(before + DOUBT * noise_before, tiny)
    fall = np.clip(least / most, 0.0, SLOWEST)
    everywhere = np.sqrt(np.where(seen, last * fall / (1.0 - fall), 0.0) / np.pi)
    fall = np.sqrt(fall)
    there = np.abs(mean[..., fine] @ values[:, fine].T)
    there *= np.where(seen, fall / (1.0 - fall), 0.0)[:, np.newaxis]
    return np.hypot(there, everywhere[:, np.newaxis])


def stderr_of(groups: np.ndarray) -> np.ndarray:
    """Return the standard error of the mean of groups of rays."""
    return groups.std(axis=0, ddof=1) / np.sqrt(len(groups))


def missed_of_totals(bias: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return what interpolation may miss of hemispherical quantities, as the spectrophotometer."""
    return bias * np.clip(8.0 * total * (1.0 - total), 0.0, 1.0)


def reference(result: Estimate) -> np.ndarray:
    """Return what relative errors refer to, shape (2, wavelengths, directions).

    The value, or a twentieth of what it would be if the light were spread evenly, where it is less.
    """
    even = result.scattered()[..., np.newaxis] / np.pi
    return np.maximum(result.mean, LEAST * even)


def largest_error(
    result: Estimate,
    side: int,
    seen: np.ndarray | slice = slice(None),
    *,
    steering: bool = False,
) -> float:
    """Return the largest relative error of one side; wavelengths without light do not count.

    Of the errors stated, or of those that steer.
    """
    stderr = (result.steering if steering else result.stderr)[side][:, seen]
    scale = reference(result)[side][:, seen]
    return float(np.divide(stderr, scale, out=np.zeros_like(scale), where=scale > 0.0).max())


def rays_wanted(
    ensembles: Sequence[Directional], variance: Sequence[Shares], target: np.ndarray
) -> np.ndarray:
    """Return the rays that every level should have for the least cost, ensemble by ensemble.

    With V the variance per ray and c the legs that a ray spends in a class, Σ V/M reaches a target
    at the least Σ c·M for M = √(V/c)·Σ √(V·c)/target (Neyman's allocation), M being the rays that
    a class listens to; every direction has its say.  Rays serve all classes up to that of their
    level, so M may only fall from class to class.

    Parameters
    ----------
    ensembles : sequence of Directional
    variance : sequence of Shares
        As `estimate` returns it.
    target : float, shape (wavelengths, directions)
        Variances to reach.
    """
    counts = np.array([e.counts() for e in ensembles])[:, :, np.newaxis]
    costs = np.array([e.costs() for e in ensembles])[:, :, np.newaxis]
    listened = np.zeros(counts.shape[:2])
    for shares, goal in zip(variance, target, strict=True):
        rows = list(shares)
        per_ray = np.stack([shares[i] for i in rows]) * counts[rows]
        need = np.sqrt(per_ray * costs[rows]).sum(axis=(0, 1))
        # Where no light goes no rays are asked for.
        factor = np.divide(need, goal, out=np.zeros_like(need), where=goal > 0.0)
        asked = (np.sqrt(per_ray / costs[rows]) * factor).max(axis=-1)
        listened[rows] = np.maximum(listened[rows], asked)
    listened = np.maximum.accumulate(listened[:, ::-1], axis=1)[:, ::-1]
    own = -np.diff(listened, axis=1, append=0.0)
    return np.maximum(np.ceil(1.1 * own.ravel() / ROUND), 1.0) * ROUND
