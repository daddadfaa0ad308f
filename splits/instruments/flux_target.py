"""Quantities inside a medium whose errors determine when a run stops, and the rays they need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.kernels.tallies.exits import N_BATCHES
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.ray_allocation import VarianceTerms, allocate_rays
from splits.simulation.tally import RAYS_PER_CHUNK, Stratum

MIN_SCATTER_FRACTION = 0.1
"""Fraction of the requested variance that is always available for statistical scatter."""
MIN_ROUND_GROWTH = 1.25
"""Smallest growth of the rays of a stratum that needs more, so that there are few rounds."""
_MIN_RELATIVE_VARIANCE = 1e-9


class FluxTarget(NamedTuple):
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
        """Return the quantities to which the error applies, by wavelength.

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


class NodeQuantities(NamedTuple):
    """Contributions of node rows to quantities, see `splits.simulation.tally.Tally`.

    Attributes
    ----------
    values : float, shape (N_BATCHES, quantities, node rows)
        Weighted contributions by batch.
    rows : int, shape (node rows,)
        Wavelengths.
    contributes : bool, shape (strata, node rows)
        Where the rays of a stratum contribute.
    """

    values: np.ndarray
    rows: np.ndarray
    contributes: np.ndarray


def make_variance_terms(target: FluxTarget, quantities: NodeQuantities) -> VarianceTerms:
    """Return the terms of the variances of quantities by wavelength, or by band.

    The wavelengths of a band that use the same strata are correlated and form one term.
    """
    values, rows, contributes = quantities
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
    quantities: NodeQuantities,
    irreducible_error: np.ndarray,
) -> np.ndarray:
    """Return the rays per stratum that satisfy a target at the least cost.

    Parameters
    ----------
    target : FluxTarget
    strata : sequence of Stratum
    quantities : NodeQuantities
    irreducible_error : float, shape (quantities, columns)
        Error that more rays do not reduce.
    """
    n_rays = np.array([stratum.n_rays for stratum in strata], dtype=float)
    terms = make_variance_terms(target, quantities)
    limits = np.maximum(
        target.stderr_limits**2 - irreducible_error**2,
        MIN_SCATTER_FRACTION * target.stderr_limits**2,
    )
    if target.band_weights is not None:
        # Terms of one node use the same rays and are correlated.
        by_band = quantities.values @ target.band_weights[:, quantities.rows].T
        total_variance = compute_batch_stderr(by_band) ** 2
        summed_variance = terms.sum_columns(terms.variances)
        limits *= np.divide(
            summed_variance,
            total_variance,
            out=np.ones_like(summed_variance),
            where=(summed_variance > 0) & (total_variance > 0),
        )
    variances = terms.variances * (n_rays @ terms.contributes) / limits[:, terms.columns]
    # Rows without scatter need almost no rays.
    terms = terms._replace(variances=np.maximum(variances, _MIN_RELATIVE_VARIANCE))
    allocated = allocate_rays(terms, strata)
    needs_more = allocated > n_rays + RAYS_PER_CHUNK
    if not needs_more.any():
        # Quantities that no ray has reached have no scatter.
        return 2.0 * n_rays
    return np.where(needs_more, np.maximum(allocated, MIN_ROUND_GROWTH * n_rays), n_rays)
