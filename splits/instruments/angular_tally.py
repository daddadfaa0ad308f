"""Ensembles of a goniophotometer: where light goes, by order of scattering.

Few scatterings carry the structure of a BRDF and cost little; many make most of the light, cost
most, and are nearly diffuse.  Orders of scattering are therefore grouped in classes.  Rays of a
level are given up after the last order of its class: they serve that class and all before it, so
that early classes can have many times the rays of the late ones (correlated through the paths they
share, which errors from groups of rays account for).
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
"""Equal parts of all rays, between which errors are estimated: to 9 %."""

RAYS_PER_ROUND = N_ANGULAR_BATCHES * RAYS_PER_CHUNK
"""Rays of a level come in multiples of this."""


ExpansionScore = tuple[int, np.ndarray, np.ndarray]
"""What a batch yields: group, sums of polynomials, sums of weights that met no grain."""


class ExpansionTally:
    """Paths traced with one set of refractive indices, and where they lead.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients (1/m) of all wavelengths.
    weights : float, shape (wavelengths,)
        How much each wavelength draws on this ensemble.
    basis : DiskBasis
    classes : sequence of int
        Largest order of scattering of each class, the last `NO_MAX_ORDER`.
    exclude_unscattered : bool
        Light that met no grain leaves as a beam, so that polynomials leave it out; of diffuse
        light they do not.

    Attributes
    ----------
    strata : list of Stratum
        One for each class.
    wavelength_rows : dict
        Rows of the wavelengths that draw on this ensemble in the arrays below.
    coefficient_sums : float, shape (groups, classes, 2, rows, polynomials)
        See `splits.kernels.tallies.angular.tally_expansion`.
    unscattered_sums : float, shape (groups, 2, rows)
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
        served = weights > 0.0
        self.absorption = absorption[served]
        self.weights = weights
        self.wavelength_rows = {
            int(column): row for row, column in enumerate(np.flatnonzero(served))
        }
        self.basis = basis
        self.exclude_unscattered = exclude_unscattered
        self.max_orders = np.array(max_orders, dtype=np.int64)
        rows = len(self.wavelength_rows)
        self.coefficient_sums = np.zeros(
            (N_ANGULAR_BATCHES, len(max_orders), 2, rows, basis.norms.size)
        )
        self.unscattered_sums = np.zeros((N_ANGULAR_BATCHES, 2, rows))
        optics = make_bounding_optics(index, self.absorption)
        first = random_streams.ANGULAR_EXPANSION + stream_index * len(max_orders)
        self.strata = [
            Stratum(first + i, optics, served, min(3.0 * most, 400.0), most)
            for i, most in enumerate(max_orders)
        ]

    def count_score_values(self) -> int:
        """Return how many numbers a tally holds."""
        return int(self.coefficient_sums[0].size + self.unscattered_sums[0].size)

    def score_chunk(
        self, stratum: Stratum, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> ExpansionScore:
        """Return the sums of a batch of exits of a level."""
        heard = self.max_orders[self.max_orders <= stratum.max_order]
        if not self.exclude_unscattered:
            exits[:, EXIT_ORDER] = np.maximum(exits[:, EXIT_ORDER], 1.0)
        return (first_ray // RAYS_PER_CHUNK) % N_ANGULAR_BATCHES, *tally_expansion(
            exits, self.absorption, heard, self.basis
        )

    def add_scores(self, stratum: Stratum, scores: Sequence[ExpansionScore]) -> None:
        """Add the sums of batches one by one: they do not depend on who traced them."""
        stratum.n_rays += RAYS_PER_CHUNK * len(scores)
        for group, sums, straight in scores:
            self.coefficient_sums[group, : len(sums)] += sums
            self.unscattered_sums[group] += straight

    def count_rays(self) -> np.ndarray:
        """Return the rays that each class listens to, shape (classes,)."""
        rays = np.array([level.n_rays for level in self.strata])
        return np.cumsum(rays[::-1])[::-1]

    def compute_coefficients(self, wavelength: int) -> np.ndarray:
        """Return its part of a wavelength's coefficients, shape (groups, classes, 2, …)."""
        each = (self.count_rays() / N_ANGULAR_BATCHES)[:, np.newaxis, np.newaxis]
        return (
            self.weights[wavelength]
            * self.coefficient_sums[:, :, :, self.wavelength_rows[wavelength]]
            / each
        )

    def compute_unscattered(self, wavelength: int) -> np.ndarray:
        """Return its part of a wavelength's light that met no grain, shape (groups, 2)."""
        each = self.count_rays()[0] / N_ANGULAR_BATCHES
        return (
            self.weights[wavelength]
            * self.unscattered_sums[:, :, self.wavelength_rows[wavelength]]
            / each
        )

    def compute_class_costs(self) -> np.ndarray:
        """Return the legs of a ray within each class, shape (classes,)."""
        legs = np.array([level.n_segments / max(level.n_rays, 1) for level in self.strata])
        return np.maximum(np.diff(legs, prepend=-1.0), 0.01)
