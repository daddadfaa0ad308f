"""Tally of the scattering matrix of single grains, and its errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.kernels.base.scene import Scene
from splits.kernels.grains.matrix_tally import (
    N_ELEMENTS,
    N_MATRIX_BATCHES,
    tally_scattering_matrix,
)
from splits.kernels.grains.single_grain import IsolatedGrain
from splits.simulation.interpolation_bounds import INTERPOLATION_FACTOR
from splits.simulation.single_scattering_tally import GRAIN_RAYS_PER_CHUNK
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stratum import Stratum
from splits.simulation.tally import Tally


class MatrixEstimate(NamedTuple):
    """Scattering matrix with errors, shapes (6, wavelengths, angles).

    The elements are P11, P12, P33, P34, P22 and P44; the mean of P11 over all directions is 1, or 0
    where nothing is scattered.
    """

    elements: np.ndarray
    stderr: np.ndarray


class ScatteringMatrixTally(Tally):
    """Tally of polarized rays that hit one grain each, see `Tally`.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    wet_fractions : float, shape (nodes,)
        Fraction of the light in pore space that is in wet pores, at each index node.
    angle_deg : float, shape (angles,)
        Scattering angles (degrees), rising from 0 to 180.

    Attributes
    ----------
    sums : float, shape (batches, 6, node rows, angles)
        See `splits.kernels.grains.matrix_tally.tally_scattering_matrix`; rising cosines.
    """

    first_stream = 3_000_000
    rays_per_round = GRAIN_RAYS_PER_CHUNK

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        wet_fractions: np.ndarray,
        angle_deg: np.ndarray,
    ) -> None:
        super().__init__(nodes, absorption)
        self.wet_fractions = wet_fractions
        self.cosines = np.cos(np.radians(angle_deg[::-1]))
        self.cosines[[0, -1]] = -1.0, 1.0
        shape = (N_MATRIX_BATCHES, N_ELEMENTS, len(self.rows), angle_deg.size)
        self.sums = np.zeros(shape)
        self.values_per_row = N_MATRIX_BATCHES * N_ELEMENTS * angle_deg.size
        self.add_strata()

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[np.ndarray, int]:
        """Return the sums of a chunk of rays that hit one grain each, and their number."""
        wet_fraction = self.wet_fractions[self.node_of_row[stratum.node_rows.start]]
        grain = IsolatedGrain(wet_fraction, scene, stratum.optics)
        work = np.array([stratum.stream, first_ray, GRAIN_RAYS_PER_CHUNK, stratum.max_order])
        sums = tally_scattering_matrix(seed, work, self.cosines, grain, stratum.absorption)
        return sums, GRAIN_RAYS_PER_CHUNK

    def merge(self, stratum: Stratum, score: np.ndarray) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.sums[:, :, stratum.node_rows] += score

    def estimate_matrix(self) -> MatrixEstimate:
        """Return the matrix, with errors from the scatter of batches and of interpolation."""
        width = np.diff(self.cosines)
        # Integral over all directions of the linear function of the cosine that is 1 at an angle.
        weight = 0.5 * (np.append(width, 0.0) + np.append(0.0, width))
        by_batch = np.moveaxis(self.sums, 2, -1) * (N_MATRIX_BATCHES / self.count_rays())
        batches = np.moveaxis(self.combine_nodes(by_batch), -1, 2)
        scattered = batches[:, 0].sum(axis=-1).mean(axis=0)
        scale = np.divide(2.0, scattered, out=np.zeros_like(scattered), where=scattered > 0.0)
        batches = (batches * scale[:, np.newaxis] / weight)[..., ::-1]
        mean = batches.mean(axis=0)
        bound = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        stderr = np.hypot(compute_batch_stderr(batches), bound * np.abs(mean))
        return MatrixEstimate(mean, stderr)
