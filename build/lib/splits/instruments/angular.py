"""From coefficients by groups of rays to a BRDF, its errors, and the rays that are still wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.instruments.detail import Angles, errors_of_detail, supported
from splits.instruments.directional import GROUPS, ROUND, Directional
from splits.uncertainty import stderr_of

BIAS = 8.0
"""What interpolation between refractive indices misses of a BRDF, relative, in units of its bound
for a reflectance near 1/2; see `splits.instruments.estimators`."""

FEW = 8
"""Groups of rays with light up to which the error is at least that of an even spread."""

LEAST = 0.05
"""Part of an even spread of light below which relative errors are not asked for."""


Shares = dict[int, np.ndarray]
"""Variances by number of the ensemble, each of shape (classes, directions)."""


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
    mean, stderr, steering, beyond = np.zeros((4, 2, len(bias), len(angles.values)))
    sums = np.zeros((4, 2, len(bias)))
    degree = np.zeros((2, len(bias)), dtype=int)
    variance: list[Shares] = []
    for column in range(len(bias)):
        drawn = [i for i, e in enumerate(ensembles) if column in e.place]
        parts = [ensembles[i].coefficients(column) for i in drawn]
        together = np.sum(parts, axis=0)
        straight = np.sum([ensembles[i].unscattered(column) for i in drawn], axis=0)
        keep = supported(together, angles.basis, symmetric)
        shares = {}
        for i, part in zip(drawn, parts, strict=True):
            one = np.where(keep[:, side], part[:, :, side], 0.0) @ angles.values[counted].T
            shares[i] = one.var(axis=0, ddof=1) / GROUPS
        variance.append(shares)
        values = np.where(keep, together, 0.0).sum(axis=1) @ angles.values.T
        mean[:, column] = values.mean(axis=0)
        stated, steered, beyond[:, column] = errors_of_detail(
            stderr_of(values), together, keep, angles, symmetric
        )
        counts = np.min([ensembles[i].counts() for i in drawn], axis=0)
        light = together[..., 0].sum(axis=1) / angles.basis.scale[0]
        sums[:, :, column], few, unseen = _totals(light, straight, counts)
        stderr[:, column] = np.hypot(stated, few[:, np.newaxis] / np.pi)
        steering[:, column] = np.hypot(steered, unseen[:, np.newaxis] / np.pi)
        degree[:, column] = np.where(keep, angles.basis.degree, 0).max(axis=(0, -1))
    missed = BIAS * bias[:, np.newaxis] * mean
    sums[1::2] = np.hypot(sums[1::2], missed_of_totals(bias, sums[::2]))
    stderr, steering = np.hypot(stderr, missed), np.hypot(steering, missed)
    return Estimate(mean, stderr, steering, sums, degree, beyond), variance


def _totals(
    scattered: np.ndarray, straight: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sums of an `Estimate` at one wavelength, and light that its errors must allow for.

    Nothing seen is not certainty: it is as if one more ray had come, from no matter where.  Nor
    does the scatter of a few rays tell their errors where the polynomials cross 0.

    Parameters
    ----------
    scattered, straight : float, shape (groups, 2)
        Light that met a grain, and that met none.
    counts : int, shape (classes,)
        Rays.

    Returns
    -------
    sums : float, shape (4, 2)
    few, unseen : float, shape (2,)
        What was seen in too few groups, or not at all; only the latter steers a run.
    """
    whole = scattered + straight
    seen = scattered.astype(bool).sum(axis=0)
    unseen = np.where(seen == 0, 1.0 / counts[-1], 0.0)
    few = np.where(seen <= FEW, scattered.mean(axis=0), 0.0)
    errors = np.hypot(stderr_of(whole), unseen)
    sharp = np.hypot(stderr_of(straight), ~straight.any(axis=0) / counts[0])
    sums = np.array([whole.mean(axis=0), errors, straight.mean(axis=0), sharp])
    return sums, unseen + few, unseen


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
