"""Stopping rule of flux estimates, and the allocation of rays to strata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.flux_tally import FluxPathTally
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.ray_allocation import allocate_rays
from splits.simulation.tally import N_BATCHES, RAYS_PER_CHUNK

MIN_SCATTER_FRACTION = 0.1
"""Fraction of the requested variance that is always available for statistical scatter."""
MIN_ROUND_GROWTH = 1.25
"""Smallest growth of the rays of a stratum that needs more, so that there are few rounds."""
_MIN_RELATIVE_VARIANCE = 1e-9


class FluxStoppingRule(NamedTuple):
    """Quantities whose standard errors determine when a run stops.

    Attributes
    ----------
    max_stderr : float
        Largest standard error.
    limit_irradiance : bool
        Whether it applies to irradiances at all depths, besides absorptances and reflectance.
    band_weights : float, shape (bands, wavelengths), or None
        Fractions of each band's light; None applies to every wavelength.
    variance_fractions : float, shape (bands,), or None
        Fraction of the variance of each band that is allowed here.
    """

    max_stderr: float
    limit_irradiance: bool = True
    band_weights: np.ndarray | None = None
    variance_fractions: np.ndarray | None = None

    @property
    def stderr_limits(self) -> np.ndarray:
        """Largest standard error of each column of `select_quantities`, shape (bands,) or (1,)."""
        fractions = np.ones(1) if self.variance_fractions is None else self.variance_fractions
        return self.max_stderr * np.sqrt(fractions)

    def select_quantities(self, irradiance: np.ndarray, absorptance: np.ndarray) -> np.ndarray:
        """Return the quantities to which the rule applies, by wavelength.

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
        """Return quantities by band, or by wavelength without bands."""
        return quantities if self.band_weights is None else quantities @ self.band_weights.T


class VarianceTerms(NamedTuple):
    """Terms whose sum gives the quantities, each from the rays of some strata.

    Attributes
    ----------
    values : float, shape (members, N_BATCHES, quantities, columns)
    membership : float, shape (members, strata)
        1 where the rays of a stratum contribute to a member.
    column_mask : bool, shape (strata, columns)
        Where the rays of a stratum contribute.
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

    The wavelengths of a band that use the same strata of a tally form one member.

    Parameters
    ----------
    stopping_rule : FluxStoppingRule
    tallies : sequence of FluxPathTally
    quantities : sequence of float, shape (N_BATCHES, quantities, wavelengths)
        Of each tally, see `FluxStoppingRule.select_quantities`.
    """
    n_strata = [len(tally.strata) for tally in tallies]
    wavelengths = slice(quantities[0].shape[-1])
    column_mask = np.stack(
        [stratum.wavelength_mask[wavelengths] for tally in tallies for stratum in tally.strata]
    )
    if stopping_rule.band_weights is None:
        membership = np.repeat(np.eye(len(tallies)), n_strata, axis=1)
        return VarianceTerms(np.stack(quantities), membership, column_mask)
    values, memberships = [], []
    first_stratum = 0
    for tally_quantities, count in zip(quantities, n_strata, strict=True):
        n_used = column_mask[first_stratum : first_stratum + count].sum(axis=0)
        for number in np.unique(n_used[n_used > 0]):
            same_depth = n_used == number
            values.append(
                tally_quantities[..., same_depth] @ stopping_rule.band_weights[:, same_depth].T
            )
            memberships.append(np.zeros(len(column_mask)))
            memberships[-1][first_stratum : first_stratum + number] = 1.0
        first_stratum += count
    everywhere = np.ones((len(column_mask), len(stopping_rule.band_weights)), dtype=bool)
    return VarianceTerms(np.stack(values), np.stack(memberships), everywhere)


def allocate_flux_rays(
    stopping_rule: FluxStoppingRule,
    tallies: Sequence[FluxPathTally],
    quantities: Sequence[np.ndarray],
    irreducible_error: np.ndarray,
) -> np.ndarray:
    """Return the rays per stratum that satisfy a stopping rule at the least cost.

    Parameters
    ----------
    stopping_rule, tallies, quantities
        As for `make_variance_terms`.
    irreducible_error : float, shape (quantities, columns)
        Error that more rays do not reduce.
    """
    strata = [stratum for tally in tallies for stratum in tally.strata]
    n_rays = np.array([stratum.n_rays for stratum in strata], dtype=float)
    terms = make_variance_terms(stopping_rule, tallies, quantities)
    variances = terms.values.var(axis=1, ddof=1) / N_BATCHES
    target = np.maximum(
        stopping_rule.stderr_limits**2 - irreducible_error**2,
        MIN_SCATTER_FRACTION * stopping_rule.stderr_limits**2,
    )
    if stopping_rule.band_weights is not None:
        # Members of one tally use the same rays and are correlated.
        total_variance = (
            compute_batch_stderr(stopping_rule.average_over_bands(np.sum(quantities, axis=0))) ** 2
        )
        summed_variance = variances.sum(axis=0)
        target *= np.divide(
            summed_variance,
            total_variance,
            out=np.ones_like(summed_variance),
            where=(summed_variance > 0) & (total_variance > 0),
        )
    rays_per_member = (terms.membership * n_rays) @ terms.column_mask
    # Rows without scatter need almost no rays, members without rays none.
    min_variance = np.where(rays_per_member > 0.0, _MIN_RELATIVE_VARIANCE, 0.0)[:, np.newaxis]
    relative_variances = np.maximum(
        variances * rays_per_member[:, np.newaxis] / target, min_variance
    )
    allocated = allocate_rays(relative_variances, terms.membership, terms.column_mask, strata)
    needs_more = allocated > n_rays + RAYS_PER_CHUNK
    if not needs_more.any():
        # Quantities that no ray has reached have no scatter.
        return 2.0 * n_rays
    return np.where(needs_more, np.maximum(allocated, MIN_ROUND_GROWTH * n_rays), n_rays)
