"""Allocation of rays to strata for the least cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.simulation.stratum import Stratum

LARGE_PROBLEM_ROWS = 4000
"""Number of rows up to which ray allocation considers all of them."""


class VarianceTerms(NamedTuple):
    """Terms whose sum over the strata and nodes is the variance of a column of results.

    Attributes
    ----------
    variances : float, shape (quantities, terms)
        Variances per ray, in units of the variance to reach.
    columns : int, shape (terms,)
        Column to whose variance a term contributes.
    contributes : bool, shape (strata, terms)
        Where the rays of a stratum contribute.
    """

    variances: np.ndarray
    columns: np.ndarray
    contributes: np.ndarray

    def select(self, columns: np.ndarray) -> VarianceTerms:
        """Return the terms of some columns, which are numbered anew."""
        terms = np.isin(self.columns, columns)
        numbers = np.searchsorted(columns, self.columns[terms])
        return VarianceTerms(self.variances[:, terms], numbers, self.contributes[:, terms])

    def sum_columns(self, values: np.ndarray) -> np.ndarray:
        """Return sums of the terms of each column, shape (quantities, columns)."""
        n_columns = int(self.columns.max()) + 1
        return np.stack([np.bincount(self.columns, value, n_columns) for value in values])


def allocate_rays(terms: VarianceTerms, strata: Sequence[Stratum]) -> np.ndarray:
    """Return the rays per stratum that bring all variances to their targets at the least cost.

    The cost of a ray is its number of segments.  At the optimum the marginal gain of a stratum,
    summed over columns with multipliers that are nonzero where the target binds, equals its cost;
    multipliers and rays are iterated by multiplicative updates, and then scaled to feasibility.

    Parameters
    ----------
    terms : VarianceTerms
    strata : sequence of Stratum
    """
    floor = np.array([stratum.n_rays for stratum in strata], dtype=float)
    cost = np.array([stratum.n_segments / stratum.n_rays for stratum in strata]) + 1.0
    binding = terms.select(_select_binding_columns(terms))
    mask = binding.contributes.astype(float)
    stratum_rays = floor.copy()
    multipliers = np.full((len(terms.variances), int(binding.columns.max()) + 1), 1.0)
    multipliers /= multipliers.size
    for _ in range(200):
        before = stratum_rays.copy()
        ratio = binding.sum_columns(binding.variances / np.maximum(stratum_rays @ mask, 1e-9))
        multipliers *= (ratio / ratio.max()) ** 0.5
        multipliers /= multipliers.sum()
        gain = (multipliers[:, binding.columns] * binding.variances).sum(axis=0)
        gain /= np.maximum(stratum_rays @ mask, 1e-9) ** 2
        stratum_rays *= np.sqrt((mask @ gain / cost).clip(1e-30))
        rays_per_term = np.maximum(stratum_rays @ mask, 1e-9)
        stratum_rays *= binding.sum_columns(binding.variances / rays_per_term).max()
        if (np.abs(stratum_rays - before) <= 1e-4 * before).all():
            break
    stratum_rays = np.maximum(stratum_rays, floor)
    # Rays above the optimum in one stratum allow fewer in others.  A margin of 3 % is added, but
    # only where more rays are needed, or strata that have enough would grow with every round.
    rays_per_term = np.maximum(stratum_rays @ terms.contributes, 1e-9)
    largest = terms.sum_columns(terms.variances / rays_per_term).max()
    target_rays = stratum_rays * max(largest, 0.1)
    more = target_rays > floor * (1.0 + 1e-6)
    return np.where(more, np.ceil(1.03 * target_rays), floor)


def _select_binding_columns(terms: VarianceTerms) -> np.ndarray:
    """Return the columns that determine the number of rays: of few columns all of them.

    Of many columns served by the same strata, those with the largest variance in a term or in
    total.
    """
    columns = np.unique(terms.columns)
    if len(columns) <= LARGE_PROBLEM_ROWS:
        return columns
    served = np.stack([np.bincount(terms.columns, one) > 0.0 for one in terms.contributes])
    _, pattern = np.unique(np.packbits(served, axis=0), axis=1, return_inverse=True)
    total = terms.sum_columns(terms.variances)
    chosen: list[int] = []
    for number in range(int(pattern.max()) + 1):
        same = np.flatnonzero(pattern.ravel() == number)
        chosen += same[total[:, same].argmax(axis=1)].tolist()
        members = np.flatnonzero(np.isin(terms.columns, same))
        first_stratum = terms.contributes[:, members].argmax(axis=0)
        for stratum in np.unique(first_stratum):
            part = members[first_stratum == stratum]
            chosen += terms.columns[part[terms.variances[:, part].argmax(axis=1)]].tolist()
    return np.unique(chosen)
