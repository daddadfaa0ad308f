"""Quantities inside a medium whose errors determine when a run stops, and the rays they need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.kernels.tallies.exits import N_BATCHES
from splits.simulation.engine import MIN_ROUND_GROWTH
from splits.simulation.strata import Stratum, VarianceTerms, allocate_rays

_MIN_RELATIVE_VARIANCE = 1e-9


class FluxTarget(NamedTuple):
    """Quantities whose standard errors determine when a run stops.

    Attributes
    ----------
    limit_irradiance : bool
        Whether the largest error applies to irradiances at all depths, besides absorptances and
        reflectance.
    band_weights : float, shape (bands, wavelengths), or None
        Fractions of each band's light; None applies to every wavelength.
    variance_fractions : float, shape (bands,)
        Fraction of the variance of each band that is allowed here.
    """

    limit_irradiance: bool = True
    band_weights: np.ndarray | None = None
    variance_fractions: np.ndarray | float = 1.0

    def select_quantities(self, quantities: np.ndarray, n_depths: int) -> np.ndarray:
        """Return the quantities to which the error applies.

        Parameters
        ----------
        quantities : float, shape (..., quantities, wavelengths)
            See `splits.instruments.flux_tally.FluxEstimate`.
        n_depths : int
            Number of depths of irradiances.
        """
        if self.limit_irradiance:
            return quantities
        reflectance, absorptance = slice(n_depths, n_depths + 1), slice(2 * n_depths, None)
        parts = [quantities[..., rows, :] for rows in (reflectance, absorptance)]
        return np.concatenate(parts, axis=-2)

    def average_over_bands(self, quantities: np.ndarray) -> np.ndarray:
        """Return quantities by band, or by wavelength without bands."""
        return quantities if self.band_weights is None else quantities @ self.band_weights.T


def make_variance_terms(
    target: FluxTarget, values: np.ndarray, rows: np.ndarray, contributes: np.ndarray
) -> VarianceTerms:
    """Return the terms of the variances of quantities by wavelength, or by band.

    The wavelengths of a band that use the same strata are correlated and form one term.

    Parameters
    ----------
    target : FluxTarget
    values : float, shape (N_BATCHES, quantities, node rows)
        Weighted contributions of node rows by batch, see `splits.simulation.tally.Tally`.
    rows : int, shape (node rows,)
        Wavelengths.
    contributes : bool, shape (strata, node rows)
        Where the rays of a stratum contribute.
    """
    if target.band_weights is None:
        return VarianceTerms(values.var(axis=0, ddof=1) / N_BATCHES, rows, contributes)
    n_bands = len(target.band_weights)
    patterns, pattern = np.unique(contributes, axis=1, return_inverse=True)
    by_pattern = [
        values[..., same] @ target.band_weights[:, rows[same]].T
        for same in (pattern.ravel() == number for number in range(patterns.shape[1]))
    ]
    variances = np.stack(by_pattern, axis=2).var(axis=0, ddof=1) / N_BATCHES
    return VarianceTerms(
        variances.reshape(len(variances), -1),
        np.tile(np.arange(n_bands), patterns.shape[1]),
        np.repeat(patterns, n_bands, axis=1),
    )


def allocate_flux_rays(
    target: FluxTarget,
    strata: Sequence[Stratum],
    values: np.ndarray,
    rows: np.ndarray,
    contributes: np.ndarray,
    max_variance: np.ndarray,
) -> np.ndarray:
    """Return the rays per stratum with which variances reach their limits at the least cost.

    Parameters
    ----------
    target : FluxTarget
    strata : sequence of Stratum
    values, rows, contributes
        See `make_variance_terms`.
    max_variance : float, shape (quantities, columns)
        Largest variances, by wavelength or by band.
    """
    n_rays = np.array([stratum.n_rays for stratum in strata], dtype=float)
    terms = make_variance_terms(target, values, rows, contributes)
    if target.band_weights is not None:
        # Terms of one node use the same rays and are correlated.
        total = compute_batch_stderr(values @ target.band_weights[:, rows].T) ** 2
        summed = terms.sum_columns(terms.variances)
        has_scatter = (summed > 0) & (total > 0)
        max_variance = max_variance * np.divide(
            summed, total, out=np.ones_like(summed), where=has_scatter
        )
    variances = terms.variances * (n_rays @ terms.contributes) / max_variance[:, terms.columns]
    # Rows without scatter need almost no rays.
    terms = terms._replace(variances=np.maximum(variances, _MIN_RELATIVE_VARIANCE))
    allocated = allocate_rays(terms, strata)
    return np.where(allocated > n_rays, np.maximum(allocated, MIN_ROUND_GROWTH * n_rays), n_rays)
