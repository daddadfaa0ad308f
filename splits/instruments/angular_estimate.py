"""From coefficients by groups of rays to a BRDF, its errors, and the rays that are still wanted."""

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
"""What interpolation between refractive indices misses of a BRDF, relative, in units of its bound
for a reflectance near 1/2; see `splits.simulation.estimators`."""

MAX_SPARSE_BATCHES = 8
"""Groups of rays with light up to which the error is at least that of an even spread."""

MIN_REFERENCE_FRACTION = 0.05
"""Part of an even spread of light below which relative errors are not asked for."""


TallyVariances = dict[int, np.ndarray]
"""Variances by number of the ensemble, each of shape (classes, directions)."""


@dataclass(frozen=True)
class AngularEstimate:
    """A BRDF and a BTDF so far.

    Attributes
    ----------
    mean, stderr : float, shape (2, wavelengths, directions)
        Reflected and transmitted (1/sr), of light that met a grain.
    stopping_error : float, shape (2, wavelengths, directions)
        The error by which runs are steered: what was dropped is spread evenly over directions.
    hemispherical : float, shape (4, 2, wavelengths)
        Directional-hemispherical reflectance and transmittance, their standard errors, and the
        same of the part of these that met no grain.
    degree : int, shape (2, wavelengths)
        Largest degree of a polynomial that was kept.
    truncation_error : float, shape (2, wavelengths, directions)
        Part of the standard errors that stands for detail finer than the polynomials (1/sr).
    """

    mean: np.ndarray
    stderr: np.ndarray
    stopping_error: np.ndarray
    hemispherical: np.ndarray
    degree: np.ndarray
    truncation_error: np.ndarray

    def compute_scattered(self) -> np.ndarray:
        """Return the reflectance and the transmittance of light that met a grain."""
        return self.hemispherical[0] - self.hemispherical[2]


def estimate_brdf(
    tallies: Sequence[ExpansionTally],
    interpolation_bound: np.ndarray,
    directions: DirectionGrid,
    axisymmetric: bool,
    side: int,
    direction_mask: np.ndarray,
) -> tuple[AngularEstimate, list[TallyVariances]]:
    """Estimate BRDF and BTDF, and how much each class adds to their variance.

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
        Directions whose variances are wanted.

    Returns
    -------
    Estimate
    variance : list of TallyVariances
        For each wavelength, what the classes of the ensembles it draws on add to the variance.
    """
    mean, stderr, steering, beyond = np.zeros(
        (4, 2, len(interpolation_bound), len(directions.polynomials))
    )
    sums = np.zeros((4, 2, len(interpolation_bound)))
    degree = np.zeros((2, len(interpolation_bound)), dtype=int)
    variance: list[TallyVariances] = []
    for column in range(len(interpolation_bound)):
        drawn = [i for i, e in enumerate(tallies) if column in e.wavelength_rows]
        parts = [tallies[i].compute_coefficients(column) for i in drawn]
        together = np.sum(parts, axis=0)
        straight = np.sum([tallies[i].compute_unscattered(column) for i in drawn], axis=0)
        keep = select_terms(together, directions.basis, axisymmetric)
        shares = {}
        for i, part in zip(drawn, parts, strict=True):
            one = (
                np.where(keep[:, side], part[:, :, side], 0.0)
                @ directions.polynomials[direction_mask].T
            )
            shares[i] = one.var(axis=0, ddof=1) / N_ANGULAR_BATCHES
        variance.append(shares)
        values = np.where(keep, together, 0.0).sum(axis=1) @ directions.polynomials.T
        mean[:, column] = values.mean(axis=0)
        stated, steered, beyond[:, column] = compute_truncation_errors(
            compute_batch_stderr(values), together, keep, directions, axisymmetric
        )
        counts = np.min([tallies[i].count_rays() for i in drawn], axis=0)
        light = together[..., 0].sum(axis=1) / directions.basis.norms[0]
        sums[:, :, column], few, unseen = _compute_hemispherical(light, straight, counts)
        stderr[:, column] = np.hypot(stated, few[:, np.newaxis] / np.pi)
        steering[:, column] = np.hypot(steered, unseen[:, np.newaxis] / np.pi)
        degree[:, column] = np.where(keep, directions.basis.degrees, 0).max(axis=(0, -1))
    missed = INTERPOLATION_FACTOR * interpolation_bound[:, np.newaxis] * mean
    sums[1::2] = np.hypot(sums[1::2], bound_interpolation_error(interpolation_bound, sums[::2]))
    stderr, steering = np.hypot(stderr, missed), np.hypot(steering, missed)
    return AngularEstimate(mean, stderr, steering, sums, degree, beyond), variance


def _compute_hemispherical(
    scattered: np.ndarray, unscattered: np.ndarray, n_rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sums of an `AngularEstimate` at one wavelength, and light that its errors must allow for.

    Nothing seen is not certainty: it is as if one more ray had come, from no matter where.  Nor
    does the scatter of a few rays tell their errors where the polynomials cross 0.

    Parameters
    ----------
    scattered, unscattered : float, shape (groups, 2)
        Light that met a grain, and that met none.
    n_rays : int, shape (classes,)
        Rays.

    Returns
    -------
    sums : float, shape (4, 2)
    few, unseen : float, shape (2,)
        What was seen in too few groups, or not at all; only the latter steers a run.
    """
    whole = scattered + unscattered
    seen = scattered.astype(bool).sum(axis=0)
    unseen = np.where(seen == 0, 1.0 / n_rays[-1], 0.0)
    few = np.where(seen <= MAX_SPARSE_BATCHES, scattered.mean(axis=0), 0.0)
    errors = np.hypot(compute_batch_stderr(whole), unseen)
    sharp = np.hypot(compute_batch_stderr(unscattered), ~unscattered.any(axis=0) / n_rays[0])
    sums = np.array([whole.mean(axis=0), errors, unscattered.mean(axis=0), sharp])
    return sums, unseen + few, unseen


def bound_interpolation_error(interpolation_bound: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return what interpolation may miss of hemispherical quantities, as the spectrophotometer."""
    return interpolation_bound * np.clip(8.0 * value * (1.0 - value), 0.0, 1.0)


def compute_error_reference(estimate: AngularEstimate) -> np.ndarray:
    """Return what relative errors refer to, shape (2, wavelengths, directions).

    The value, or a twentieth of what it would be if the light were spread evenly, where it is less.
    """
    even = estimate.compute_scattered()[..., np.newaxis] / np.pi
    return np.maximum(estimate.mean, MIN_REFERENCE_FRACTION * even)


def compute_max_relative_error(
    estimate: AngularEstimate,
    side: int,
    direction_mask: np.ndarray | slice = slice(None),
    *,
    use_stopping_error: bool = False,
) -> float:
    """Return the largest relative error of one side; wavelengths without light do not count.

    Of the errors stated, or of those that steer.
    """
    stderr = (estimate.stopping_error if use_stopping_error else estimate.stderr)[side][
        :, direction_mask
    ]
    scale = compute_error_reference(estimate)[side][:, direction_mask]
    return float(np.divide(stderr, scale, out=np.zeros_like(scale), where=scale > 0.0).max())


def allocate_angular_rays(
    tallies: Sequence[ExpansionTally],
    variance: Sequence[TallyVariances],
    target_variances: np.ndarray,
) -> np.ndarray:
    """Return the rays that every level should have for the least cost, ensemble by ensemble.

    With V the variance per ray and c the legs that a ray spends in a class, Σ V/M reaches a target
    at the least Σ c·M for M = √(V/c)·Σ √(V·c)/target (Neyman's allocation), M being the rays that
    a class listens to; every direction has its say.  Rays serve all classes up to that of their
    level, so M may only fall from class to class.

    Parameters
    ----------
    tallies : sequence of ExpansionTally
    variance : sequence of TallyVariances
        As `estimate_brdf` returns it.
    target_variances : float, shape (wavelengths, directions)
        Variances to reach.
    """
    counts = np.array([e.count_rays() for e in tallies])[:, :, np.newaxis]
    costs = np.array([e.compute_class_costs() for e in tallies])[:, :, np.newaxis]
    listened = np.zeros(counts.shape[:2])
    for shares, goal in zip(variance, target_variances, strict=True):
        rows = list(shares)
        per_ray = np.stack([shares[i] for i in rows]) * counts[rows]
        need = np.sqrt(per_ray * costs[rows]).sum(axis=(0, 1))
        # Where no light goes no rays are asked for.
        factor = np.divide(need, goal, out=np.zeros_like(need), where=goal > 0.0)
        asked = (np.sqrt(per_ray / costs[rows]) * factor).max(axis=-1)
        listened[rows] = np.maximum(listened[rows], asked)
    listened = np.maximum.accumulate(listened[:, ::-1], axis=1)[:, ::-1]
    own = -np.diff(listened, axis=1, append=0.0)
    return np.maximum(np.ceil(1.1 * own.ravel() / RAYS_PER_ROUND), 1.0) * RAYS_PER_ROUND
