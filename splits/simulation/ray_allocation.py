"""Allocation of rays to strata for the least cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.simulation.tally import (
    RAYS_PER_CHUNK,
    Stratum,
    Tally,
)

LARGE_PROBLEM_ROWS = 4000
"""Number of rows up to which ray allocation considers all of them."""


def allocate_spectral_rays(
    weighted_variances: np.ndarray, target_variances: np.ndarray, tallies: Sequence[Tally]
) -> np.ndarray:
    """Return the rays per stratum that bring every variance to its target at the least cost.

    Parameters
    ----------
    weighted_variances : float, shape (tallies, quantities, wavelengths)
        Variance per ray times squared weight.
    target_variances : float, shape (quantities, wavelengths)
        Variances to reach.
    tallies : sequence of Tally
    """
    strata = [stratum for tally in tallies for stratum in tally.strata]
    membership = np.repeat(np.eye(len(tallies)), [len(tally.strata) for tally in tallies], axis=1)
    return allocate_rays(
        weighted_variances / target_variances,
        membership,
        np.stack([stratum.wavelength_mask for stratum in strata]),
        strata,
    )


def allocate_rays(
    relative_variances: np.ndarray,
    membership: np.ndarray,
    column_mask: np.ndarray,
    strata: Sequence[Stratum],
) -> np.ndarray:
    """Return the rays per stratum that bring sums of variances to their targets at the least cost.

    The cost of a ray is its number of segments.  At the optimum the marginal gain of a stratum,
    summed over wavelengths with multipliers that are nonzero where the target binds, equals its
    cost; multipliers and rays are iterated by multiplicative updates, and then scaled to
    feasibility.

    Parameters
    ----------
    relative_variances : float, shape (members, quantities, columns)
        Variances per ray of the terms that add up, in units of the targets.
    membership : float, shape (members, strata)
        1 where the rays of a stratum contribute to a member, 0 elsewhere.
    column_mask : bool, shape (strata, columns)
        Where the rays of a stratum contribute.
    strata : sequence of Stratum
    """
    floor = np.array([stratum.n_rays for stratum in strata], dtype=float)
    cost = np.array([stratum.n_segments / stratum.n_rays for stratum in strata]) + 1.0
    binding = _select_binding_rows(relative_variances, column_mask)
    variances, mask = relative_variances[..., binding], column_mask[:, binding].astype(float)
    stratum_rays = floor.copy()
    multipliers = np.full(variances.shape[1:], 1.0 / variances[0].size)

    def compute_relative_variance(
        stratum_rays: np.ndarray, variances: np.ndarray = variances, mask: np.ndarray = mask
    ) -> np.ndarray:
        n_rays = np.maximum((membership * stratum_rays) @ mask, 1e-9)
        return (variances / n_rays[:, np.newaxis]).sum(axis=0)

    for _ in range(200):
        before = stratum_rays.copy()
        ratio = compute_relative_variance(stratum_rays)
        multipliers *= (ratio / ratio.max()) ** 0.5
        multipliers /= multipliers.sum()
        n_rays = np.maximum((membership * stratum_rays) @ mask, 1e-9)
        gain = (multipliers * variances).sum(axis=1) / n_rays**2
        stratum_rays *= np.sqrt((((membership.T @ gain) * mask).sum(axis=1) / cost).clip(1e-30))
        stratum_rays *= compute_relative_variance(stratum_rays).max()
        if (np.abs(stratum_rays - before) <= 1e-4 * before).all():
            break
    stratum_rays = np.maximum(stratum_rays, floor)
    # Rays above the optimum in one stratum allow fewer in others.  A margin of 3 % is added, but
    # only where more rays are needed, or strata that have enough would grow with every round.
    target_rays = stratum_rays * max(
        compute_relative_variance(
            stratum_rays, relative_variances, column_mask.astype(float)
        ).max(),
        0.1,
    )
    more = target_rays > floor * (1.0 + 1e-6)
    return (
        np.where(more, np.ceil(1.03 * target_rays), floor) if more.any() else floor + RAYS_PER_CHUNK
    )


def _select_binding_rows(relative_variances: np.ndarray, column_mask: np.ndarray) -> np.ndarray:
    """Return the rows that determine the number of rays: of few rows all of them.

    Of many rows served by the same strata, those with the largest variance in a tally or in total.

    Parameters
    ----------
    relative_variances : float, shape (tallies, quantities, rows)
    column_mask : bool, shape (strata, rows)
    """
    n_rows = relative_variances.shape[2]
    if n_rows <= LARGE_PROBLEM_ROWS:
        return np.arange(n_rows)
    _, pattern = np.unique(np.packbits(column_mask, axis=0), axis=1, return_inverse=True)
    chosen: list[int] = []
    for number in range(int(pattern.max()) + 1):
        rows = np.flatnonzero(pattern.ravel() == number)
        variances = relative_variances[..., rows]
        chosen += rows[variances.argmax(axis=2)].ravel().tolist()
        chosen += rows[variances.sum(axis=0).argmax(axis=1)].tolist()
    return np.unique(chosen)
