"""Tally of radiative fluxes at planes in a medium, by batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.flux_errors import SystematicError, estimate_systematic_error
from splits.instruments.flux_media import TracedMedium
from splits.instruments.flux_target import (
    MIN_SCATTER_FRACTION,
    FluxTarget,
    NodeQuantities,
    allocate_flux_rays,
)
from splits.kernels.base.scene import Scene
from splits.kernels.tallies.exits import N_BATCHES
from splits.kernels.tallies.flux import DOWNWARD, UPWARD, FluxSums, tally_flux
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.tally import (
    Evaluation,
    ExitTally,
    StoppingRule,
    Stratum,
    compute_absorption_per_mfp,
)

FLUX_RAYS_PER_CHUNK = 32
"""Rays whose weights are added up together: few, so that a first round of all batches is short."""
CROSSINGS_PER_BOUNDARY = 4
"""Expected crossings of a boundary per ray, for the memory of a job."""


class FluxEstimate(NamedTuple):
    """Batch means at the requested depths, and between them.

    Attributes
    ----------
    irradiance : float, shape (N_BATCHES, 2, depths, wavelengths)
        Downward and upward irradiances, relative to the incident irradiance.
    absorptance : float, shape (N_BATCHES, intervals, wavelengths)
        Difference of the net irradiances at the planes of an interval.
    material_absorptance : float, shape (N_BATCHES, intervals, materials, wavelengths)
        From the lengths in each material.
    path_length : float, shape (N_BATCHES, intervals, wavelengths)
        Metres; of a semi-infinite interval, down to the end of tracing.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    material_absorptance: np.ndarray
    path_length: np.ndarray

    def select_wavelengths(self, wavelengths: slice) -> FluxEstimate:
        """Return the estimate at some wavelengths."""
        return FluxEstimate(*(array[..., wavelengths] for array in self))


class FluxResult(NamedTuple):
    """Estimate with its systematic error.

    Attributes
    ----------
    estimate : FluxEstimate
    systematic_error : SystematicError
    perturbed_estimate : FluxEstimate or None
        Estimate with a more absorbing substrate below a truncation depth, see `TracedMedium`.
    """

    estimate: FluxEstimate
    systematic_error: SystematicError
    perturbed_estimate: FluxEstimate | None


class FluxTally(ExitTally):
    """Tally of light that crosses the boundaries of all layers, and of paths between them.

    Parameters
    ----------
    nodes : IndexNodes
    traced_medium : TracedMedium
    scene : Scene
        Of the medium, with its planes.
    target : FluxTarget
        Quantities to which the requested error applies.

    Attributes
    ----------
    irradiance_sums : float, shape (N_BATCHES, 2, boundaries, node rows)
        Of light that crosses a boundary, downwards and upwards.
    absorptance_sums : float, shape (N_BATCHES, layers, materials, node rows)
    path_length_sums : float, shape (N_BATCHES, layers, node rows)
        Metres.
    """

    first_stream = 8_000_000
    rays_per_chunk = FLUX_RAYS_PER_CHUNK
    rays_per_round = pilot_rays = FLUX_RAYS_PER_CHUNK * N_BATCHES
    shares_kernel = True

    def __init__(
        self,
        nodes: IndexNodes,
        traced_medium: TracedMedium,
        scene: Scene,
        target: FluxTarget,
    ) -> None:
        absorption = traced_medium.constants.absorption
        super().__init__(nodes, absorption, compute_absorption_per_mfp(scene, absorption))
        self.traced_medium, self.target, self.scene = traced_medium, target, scene
        self.path_fractions = traced_medium.path_fractions
        # The boundary above a rough surface is above the depth 0.
        self.boundary_rows = np.append(
            0, np.searchsorted(-scene.layers.boundaries, traced_medium.planes_m[1:])
        )
        self.n_layers = len(scene.layers.boundaries) - 1
        n_rows, n_materials = len(self.rows), absorption.shape[1]
        self.irradiance_sums = np.zeros((N_BATCHES, 2, self.n_layers + 1, n_rows))
        self.absorptance_sums = np.zeros((N_BATCHES, self.n_layers, n_materials, n_rows))
        self.path_length_sums = np.zeros((N_BATCHES, self.n_layers, n_rows))
        self.add_strata_by_absorption(absorption, scene)

    def count_score_values(self) -> int:
        """Return the number of values in the score and the crossings of a chunk."""
        n_materials, n_rows = self.absorption.shape[1], int(np.diff(self.first_rows).max())
        n_crossings = FLUX_RAYS_PER_CHUNK * CROSSINGS_PER_BOUNDARY * self.n_layers
        return n_crossings * (n_materials + 3) + self.n_layers * (3 + n_materials) * n_rows

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> FluxSums:
        """Return the sums of a chunk of rays of a stratum."""
        ground_column = self.scene.ground_column
        sums: FluxSums = tally_flux(
            exits, crossings, stratum.absorption, self.path_fractions, self.n_layers, ground_column
        )
        return sums

    def merge(self, stratum: Stratum, score: FluxSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_BATCHES), stratum.node_rows
        self.irradiance_sums[batch][..., rows] += score.boundary_weight
        self.absorptance_sums[batch][..., rows] += score.absorbed
        self.path_length_sums[batch][..., rows] += score.path_length

    def estimate_node_rows(self) -> FluxEstimate:
        """Return the estimate of each node row at the planes.

        In a semi-infinite medium, the last boundary is the end of tracing, and the last interval
        continues below it.
        """
        planes, n_batch_rays = self.boundary_rows, self.count_rays() / N_BATCHES
        irradiance = self.irradiance_sums[:, :, planes] / n_batch_rays
        irradiance[:, 0, 0] = 1.0
        absorbed = self.absorptance_sums[:, : planes[-1]] / n_batch_rays
        path_length = self.path_length_sums[:, : planes[-1]] / n_batch_rays
        net = irradiance[:, DOWNWARD] - irradiance[:, UPWARD]
        absorptance = net[:, :-1] - net[:, 1:]
        by_material = np.add.reduceat(absorbed, planes[:-1], axis=1)
        path_length = np.add.reduceat(path_length, planes[:-1], axis=1)
        if self.traced_medium.semi_infinite:
            irradiance, absorptance[:, -1] = irradiance[:, :, :-1], net[:, -2]
            # Light that enters the rest is absorbed in proportion to the layer just above.
            last = absorbed[:, -1].mean(axis=0)
            total = last.sum(axis=0)
            fraction = np.divide(last, total, out=np.zeros_like(last), where=total > 0.0)
            by_material[:, -1] += fraction * net[:, -1, np.newaxis]
        return FluxEstimate(irradiance, absorptance, by_material, path_length)

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest standard error, and why tracing stops or which rays are needed.

        It stops with "interpolation_bound" where the rest of the error is a bound that more rays do
        not reduce.
        """
        by_node = self.estimate_node_rows()
        result = self._combine(by_node)
        stderr, irreducible = self._compute_target_errors(result)
        limits, max_stderr = self.target.stderr_limits, self.target.max_stderr
        error = float((stderr / limits).max()) * max_stderr
        if error <= max_stderr:
            return Evaluation(error, "converged", None, result)
        scatter = stderr**2 - irreducible**2
        if (irreducible > limits).any() and (scatter < MIN_SCATTER_FRACTION * limits**2).all():
            return Evaluation(error, "interpolation_bound", None, result)
        requested = self.rows < self.traced_medium.n_wavelengths
        values = self.target.select_quantities(by_node.irradiance, by_node.absorptance)
        quantities = NodeQuantities(
            (self.weights * values)[..., requested],
            self.rows[requested],
            self.find_contributions()[:, requested],
        )
        target_rays = allocate_flux_rays(self.target, self.strata, quantities, irreducible)
        return Evaluation(error, "", target_rays, result)

    def _combine(self, by_node: FluxEstimate) -> FluxResult:
        """Return the result of all wavelengths from the estimates of node rows."""
        n_wavelengths = self.traced_medium.n_wavelengths
        whole = FluxEstimate(*(self.combine_nodes(array) for array in by_node))
        estimate = whole.select_wavelengths(slice(n_wavelengths))
        perturbed = None
        if self.traced_medium.truncated:
            perturbed = whole.select_wavelengths(slice(n_wavelengths, None))
        single_ray_error = np.zeros(len(self.absorption))
        np.maximum.at(single_ray_error, self.rows, self.weights / self.count_rays())
        systematic_error = estimate_systematic_error(
            estimate[:2],
            None if perturbed is None else perturbed[:2],
            self.nodes.interpolation_bound[:n_wavelengths],
            single_ray_error[:n_wavelengths],
        )
        return FluxResult(estimate, systematic_error, perturbed)

    def _compute_target_errors(self, result: FluxResult) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard errors of the target's quantities, and their irreducible parts."""
        estimate, systematic_error, _ = result

        def select(irradiance: np.ndarray, absorptance: np.ndarray) -> np.ndarray:
            quantities = self.target.select_quantities(irradiance, absorptance)
            return self.target.average_over_bands(quantities)

        scatter = compute_batch_stderr(select(estimate.irradiance, estimate.absorptance))
        systematic = select(systematic_error.irradiance, systematic_error.absorptance)
        return np.hypot(scatter, systematic), select(*systematic_error.irreducible)
