"""Tallies of a goniophotometer: polynomial coefficients by order of scattering.

Low orders of scattering produce the structure of a BRDF and cost little; high orders make most of
the light, cost most, and are nearly diffuse.  Orders of scattering are therefore grouped in
classes. Rays of a stratum are terminated after the last order of its class: they contribute to that
class and all before it, so that low classes can have many times the rays of the high ones
(correlated through common paths, which errors from batches account for).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.kernels.grains.scene import NO_MAX_ORDER, make_bounding_optics
from splits.kernels.tallies.angular import DiskBasis, tally_expansion
from splits.kernels.tallies.exits import EXIT_ORDER
from splits.simulation import random_streams
from splits.simulation.runner import RAYS_PER_CHUNK
from splits.simulation.tally import Stratum

ORDER_CLASSES = (2, 8, 32, 128, NO_MAX_ORDER)
"""Largest order of scattering of each class."""

N_ANGULAR_BATCHES = 64
"""Number of batches for the estimation of errors, to 9 %."""

RAYS_PER_ROUND = N_ANGULAR_BATCHES * RAYS_PER_CHUNK
"""The rays of a stratum are a multiple of this."""


ExpansionScore = tuple[int, np.ndarray, np.ndarray]
"""Score of a chunk: batch, sums of polynomials, sums of unscattered weights."""


class ExpansionTally:
    """Tally of paths traced with one set of refractive indices, by direction of exit.

    Parameters
    ----------
    stream_index : int
        Position among the tallies of a run, which determines the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m) of all wavelengths.
    weights : float, shape (wavelengths,)
        Weight of this tally at each wavelength.
    basis : DiskBasis
    max_orders : sequence of int
        Largest order of scattering of each class, the last `NO_MAX_ORDER`.
    exclude_unscattered : bool
        Unscattered light of a beam leaves as a beam and is excluded from the polynomials; that of
        diffuse light is included.

    Attributes
    ----------
    strata : list of Stratum
        One for each class.
    wavelength_rows : dict
        Rows of the wavelengths that use this tally in the arrays below.
    coefficient_sums : float, shape (batches, classes, 2, rows, polynomials)
        See `splits.kernels.tallies.angular.tally_expansion`.
    unscattered_sums : float, shape (batches, 2, rows)
    """

    def __init__(
        self,
        stream_index: int,
        index: np.ndarray,
        absorption: np.ndarray,
        weights: np.ndarray,
        basis: DiskBasis,
        max_orders: Sequence[int] = ORDER_CLASSES,
        exclude_unscattered: bool = True,
    ) -> None:
        wavelength_mask = weights > 0.0
        self.absorption = absorption[wavelength_mask]
        self.weights = weights
        self.wavelength_rows = {
            int(column): row for row, column in enumerate(np.flatnonzero(wavelength_mask))
        }
        self.basis = basis
        self.exclude_unscattered = exclude_unscattered
        self.max_orders = np.array(max_orders, dtype=np.int64)
        n_rows = len(self.wavelength_rows)
        self.coefficient_sums = np.zeros(
            (N_ANGULAR_BATCHES, len(max_orders), 2, n_rows, basis.norms.size)
        )
        self.unscattered_sums = np.zeros((N_ANGULAR_BATCHES, 2, n_rows))
        optics = make_bounding_optics(index, self.absorption)
        first_stream = random_streams.ANGULAR_EXPANSION + stream_index * len(max_orders)
        self.strata = [
            Stratum(
                first_stream + i, optics, wavelength_mask, min(3.0 * max_order, 400.0), max_order
            )
            for i, max_order in enumerate(max_orders)
        ]

    def count_score_values(self) -> int:
        """Return the number of values in the score of a chunk."""
        return int(self.coefficient_sums[0].size + self.unscattered_sums[0].size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> ExpansionScore:
        """Return the sums of a chunk of exits of a stratum."""
        scored_orders = self.max_orders[self.max_orders <= stratum.max_order]
        if not self.exclude_unscattered:
            exits[:, EXIT_ORDER] = np.maximum(exits[:, EXIT_ORDER], 1.0)
        return (first_ray // RAYS_PER_CHUNK) % N_ANGULAR_BATCHES, *tally_expansion(
            exits, self.absorption, scored_orders, self.basis
        )

    def add_scores(self, stratum: Stratum, scores: Sequence[ExpansionScore]) -> None:
        """Add the sums of chunks one by one: they do not depend on the threads."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for batch, sums, unscattered in scores:
            self.coefficient_sums[batch, : len(sums)] += sums
            self.unscattered_sums[batch] += unscattered

    def count_rays(self) -> np.ndarray:
        """Return the rays that contribute to each class, shape (classes,)."""
        rays = np.array([stratum.n_rays for stratum in self.strata])
        return np.cumsum(rays[::-1])[::-1]

    def compute_coefficients(self, wavelength: int) -> np.ndarray:
        """Return the contribution to a wavelength's coefficients, (batches, classes, 2, …)."""
        rays_per_batch = (self.count_rays() / N_ANGULAR_BATCHES)[:, np.newaxis, np.newaxis]
        return (
            self.weights[wavelength]
            * self.coefficient_sums[:, :, :, self.wavelength_rows[wavelength]]
            / rays_per_batch
        )

    def compute_unscattered(self, wavelength: int) -> np.ndarray:
        """Return the contribution to a wavelength's unscattered light, shape (batches, 2)."""
        rays_per_batch = self.count_rays()[0] / N_ANGULAR_BATCHES
        return (
            self.weights[wavelength]
            * self.unscattered_sums[:, :, self.wavelength_rows[wavelength]]
            / rays_per_batch
        )

    def compute_class_costs(self) -> np.ndarray:
        """Return the segments of a ray within each class, shape (classes,)."""
        n_segments = np.array(
            [stratum.n_segments / max(stratum.n_rays, 1) for stratum in self.strata]
        )
        return np.maximum(np.diff(n_segments, prepend=-1.0), 0.01)
