"""What is asked of the light inside, and how many rays that takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.flux_tally import FluxPathTally
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.estimators import allocate_rays
from splits.simulation.tally import N_BATCHES, RAYS_PER_CHUNK

MIN_SCATTER_FRACTION = 0.1
"""Part of the variance asked for that scatter may have in any case."""
MIN_ROUND_GROWTH = 1.25
"""Times as many rays, at least, of a level that wants more: rounds are to be few."""
_MIN_RELATIVE_VARIANCE = 1e-9


class FluxStoppingRule(NamedTuple):
    """Quantities whose standard errors decide when a profile is finished.

    Attributes
    ----------
    max_stderr : float
        Largest standard error.
    limit_irradiance : bool
        Whether it holds for irradiances at all depths, besides absorptances and reflectance.
    band_weights : float, shape (bands, wavelengths), or None
        Parts of each band's light; None asks for every wavelength.
    variance_fractions : float, shape (bands,), or None
        Part of the variance of each band that is allowed here.
    """

    max_stderr: float
    limit_irradiance: bool = True
    band_weights: np.ndarray | None = None
    variance_fractions: np.ndarray | None = None

    @property
    def stderr_limits(self) -> np.ndarray:
        """Largest standard error of each column of `select_quantities`, shape (bands,) or (1,)."""
        share = np.ones(1) if self.variance_fractions is None else self.variance_fractions
        return self.max_stderr * np.sqrt(share)

    def select_quantities(self, irradiance: np.ndarray, absorptance: np.ndarray) -> np.ndarray:
        """Return the quantities that errors are asked of, by wavelength.

        Parameters
        ----------
        irradiance : float, shape (..., 2, depths, wavelengths)
        absorptance : float, shape (..., intervals, wavelengths)

        Returns
        -------
        float, shape (..., quantities, wavelengths)
        """
        down, up = irradiance[..., DOWNWARD, :, :], irradiance[..., UPWARD, :, :]
        parts = [down, up, absorptance] if self.limit_irradiance else [up[..., :1, :], absorptance]
        return np.concatenate(parts, axis=-2)

    def average_over_bands(self, quantities: np.ndarray) -> np.ndarray:
        """Return quantities by band, or by wavelength where there are no bands."""
        return quantities if self.band_weights is None else quantities @ self.band_weights.T


class VarianceTerms(NamedTuple):
    """Sums that add up to the quantities asked for, each of rays of some levels.

    Attributes
    ----------
    values : float, shape (members, GROUPS, quantities, columns)
    membership : float, shape (members, levels)
        1 where the rays of a level count for a member.
    column_mask : bool, shape (levels, columns)
        Where the rays of a level count.
    """

    values: np.ndarray
    membership: np.ndarray
    column_mask: np.ndarray


def make_variance_terms(
    stopping_rule: FluxStoppingRule,
    tallies: Sequence[FluxPathTally],
    quantities: Sequence[np.ndarray],
) -> VarianceTerms:
    """Return the members of quantities by wavelength, or by band.

    The wavelengths of a band that the same levels of an ensemble serve make one member.

    Parameters
    ----------
    stopping_rule : Goal
    tallies : sequence of FluxPathTally
    quantities : sequence of float, shape (GROUPS, quantities, wavelengths)
        Of each ensemble, see `Goal.rows`.
    """
    counts = [len(e.strata) for e in tallies]
    every = slice(quantities[0].shape[-1])
    served = np.stack([level.wavelength_mask[every] for e in tallies for level in e.strata])
    if stopping_rule.band_weights is None:
        owner = np.repeat(np.eye(len(tallies)), counts, axis=1)
        return VarianceTerms(np.stack(quantities), owner, served)
    values, owners = [], []
    first = 0
    for row, count in zip(quantities, counts, strict=True):
        depth = served[first : first + count].sum(axis=0)
        for number in np.unique(depth[depth > 0]):
            alike = depth == number
            values.append(row[..., alike] @ stopping_rule.band_weights[:, alike].T)
            owners.append(np.zeros(len(served)))
            owners[-1][first : first + number] = 1.0
        first += count
    everywhere = np.ones((len(served), len(stopping_rule.band_weights)), dtype=bool)
    return VarianceTerms(np.stack(values), np.stack(owners), everywhere)


def allocate_flux_rays(
    stopping_rule: FluxStoppingRule,
    tallies: Sequence[FluxPathTally],
    quantities: Sequence[np.ndarray],
    irreducible_error: np.ndarray,
) -> np.ndarray:
    """Return the rays per level that reach a goal at the least cost.

    Parameters
    ----------
    goal, ensembles, rows
        As for `make_variance_terms`.
    irreducible_error : float, shape (quantities, columns)
        What rays do not lower.
    """
    levels = [level for e in tallies for level in e.strata]
    rays = np.array([level.n_rays for level in levels], dtype=float)
    members = make_variance_terms(stopping_rule, tallies, quantities)
    each = members.values.var(axis=1, ddof=1) / N_BATCHES
    target = np.maximum(
        stopping_rule.stderr_limits**2 - irreducible_error**2,
        MIN_SCATTER_FRACTION * stopping_rule.stderr_limits**2,
    )
    if stopping_rule.band_weights is not None:
        # Members of one ensemble share rays and scatter together.
        whole = (
            compute_batch_stderr(stopping_rule.average_over_bands(np.sum(quantities, axis=0))) ** 2
        )
        parts = each.sum(axis=0)
        target *= np.divide(parts, whole, out=np.ones_like(parts), where=(parts > 0) & (whole > 0))
    count = (members.membership * rays) @ members.column_mask
    # Rows without scatter want hardly anything, members that no ray counts for nothing at all.
    least = np.where(count > 0.0, _MIN_RELATIVE_VARIANCE, 0.0)[:, np.newaxis]
    shares = np.maximum(each * count[:, np.newaxis] / target, least)
    found = allocate_rays(shares, members.membership, members.column_mask, levels)
    more = found > rays + RAYS_PER_CHUNK
    if not more.any():
        # What no ray has reached does not scatter.
        return 2.0 * rays
    return np.where(more, np.maximum(found, MIN_ROUND_GROWTH * rays), rays)
