"""Tally of the transmittance of optically thick samples, with splitting and roulette."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.base.scene import Scene
from splits.kernels.transport.splitting import trace_with_splitting
from splits.simulation.scene import OpticalConstants
from splits.simulation.spectral_nodes import make_separate_nodes
from splits.simulation.stopping_rule import Evaluation, StoppingRule
from splits.simulation.stratum import Stratum
from splits.simulation.tally import LOST_MESSAGE, Tally

HISTORIES_PER_CHUNK = 64
"""Histories per chunk, the unit of parallel work."""
PILOT_HISTORIES = 512
"""Histories of each pilot run and of the first round."""
MAX_HISTORY_FRACTION = 0.05
"""Largest fraction of the sum from a single history for convergence: the error would be
underestimated if rare large contributions dominate it that were mostly not sampled yet."""
N_PILOTS = 3
"""Pilot runs, each of which samples deeper than the one before."""
N_DEPTH_SLICES = 24
"""Depth slices in which pilot runs record the decrease of the light."""
_MIN_SLICE_COLLISIONS = 200
"""Smallest number of collisions in a slice for the fit."""

TransmittanceScore = tuple[np.ndarray, np.ndarray]
"""Σ weight, Σ weight² and the largest weight of transmitted histories; and the depth profile."""


class TransmittanceEstimate(NamedTuple):
    """Transmittances, shape (wavelengths,).

    Attributes
    ----------
    mean, stderr : float
    largest_fraction : float
        Largest fraction of the sum from a single history.
    """

    mean: np.ndarray
    stderr: np.ndarray
    largest_fraction: np.ndarray

    @property
    def relative_error(self) -> np.ndarray:
        """Relative standard errors, infinite where a single history dominates or none arrived."""
        is_reliable = self.largest_fraction <= MAX_HISTORY_FRACTION
        unreliable_error = np.full_like(self.mean, np.inf)
        return np.divide(self.stderr, self.mean, out=unreliable_error, where=is_reliable)


class TransmittanceTally(Tally):
    """Tally of transmitted weights, and of the weight at collisions by depth; see `Tally`.

    Each wavelength is traced separately, until its own error is reached.

    Parameters
    ----------
    constants : OpticalConstants
    splitting_rates : float, shape (wavelengths,)
        Rates (1/m) at which rays are split with depth.
    stage : int
        0 to `N_PILOTS`; each has its own random streams.

    Attributes
    ----------
    moments : float, shape (3, wavelengths)
        Σ weight, Σ weight², largest weight of a history.
    depth_profile : float, shape (2, slices, wavelengths)
        Number of collisions, and their total weight.
    """

    rays_per_chunk = rays_per_round = HISTORIES_PER_CHUNK
    pilot_rays = PILOT_HISTORIES
    values_per_row = 3 + 2 * N_DEPTH_SLICES
    first_stream = 3_000_000

    def __init__(
        self, constants: OpticalConstants, splitting_rates: np.ndarray, stage: int
    ) -> None:
        super().__init__(make_separate_nodes(constants.indices), constants.absorption)
        self.splitting_rates = splitting_rates
        self.moments = np.zeros((3, len(splitting_rates)))
        self.depth_profile = np.zeros((2, N_DEPTH_SLICES, len(splitting_rates)))
        self.add_strata()
        for row, stratum in enumerate(self.strata):
            stratum.stream = self.first_stream + (N_PILOTS + 1) * row + stage
            stratum.splitting_rate = float(splitting_rates[row])

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[TransmittanceScore, int]:
        """Trace a chunk of histories with splitting, and return its score and the segments.

        Raises
        ------
        RuntimeError
            If no grain fits between the boundaries along a ray.
        """
        moments, profile = np.zeros(3), np.zeros((2, N_DEPTH_SLICES))
        work = np.array([stratum.stream, first_ray, self.rays_per_chunk, stratum.max_order])
        result = trace_with_splitting(
            seed, work, scene, stratum.optics, stratum.splitting_rate, moments, profile
        )
        if result.lost:
            raise RuntimeError(LOST_MESSAGE)
        return (moments, profile), int(result.n_segments[0])

    def merge(self, stratum: Stratum, score: TransmittanceScore) -> None:
        """Add the score of the next chunk of a stratum."""
        (total, square, largest), profile = score
        moments = self.moments[:, stratum.node_rows.start]
        moments[:2] += total, square
        moments[2] = max(moments[2], largest)
        self.depth_profile[..., stratum.node_rows.start] += profile

    def make_estimate(self) -> TransmittanceEstimate:
        """Estimate the transmittances."""
        total, square, largest = self.moments
        n_rays = self.stratum_rays
        mean = total / n_rays
        stderr = np.sqrt(np.maximum(square / n_rays - mean**2, 0.0) / n_rays)
        fraction = np.divide(largest, total, out=np.ones_like(total), where=total > 0.0)
        return TransmittanceEstimate(mean, stderr, fraction)

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest relative error, and "max_rays" where each wavelength has its share."""
        estimate = self.make_estimate()
        needs_more = estimate.relative_error > stop.max_error
        exhausted = self.stratum_rays >= stop.max_rays / len(self.strata)
        gave_up = needs_more.any() and exhausted[needs_more].all()
        error = float(estimate.relative_error.max())
        return Evaluation(error, estimate, "max_rays" if gave_up else "")

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the histories that each wavelength needs, within its share of all histories."""
        n_rays, max_rays = self.stratum_rays, stop.max_rays / len(self.strata)
        error = evaluation.estimate.relative_error
        predicted = 1.1 * n_rays * (error / stop.max_error) ** 2
        target_rays = np.minimum(np.clip(predicted, 1.5 * n_rays, 4.0 * n_rays), max_rays)
        return np.floor(np.where(error <= stop.max_error, n_rays, np.maximum(target_rays, n_rays)))

    def fit_attenuation_rates(self, depth: float) -> np.ndarray:
        """Return the rates (1/m) at which the weight decreases with depth, from sampled slices.

        Where too few slices are sampled, they are the splitting rates.
        """
        rates = self.splitting_rates.copy()
        for row, (count, weight) in enumerate(np.moveaxis(self.depth_profile, -1, 0)):
            # Without the slices at the top and bottom, where light escapes.
            inside = (count >= _MIN_SLICE_COLLISIONS) & (weight > 0.0)
            inside[[0, -1]] = False
            if inside.sum() >= 3:
                depths = depth * (np.arange(N_DEPTH_SLICES)[inside] + 0.5) / N_DEPTH_SLICES
                rates[row] = max(-float(np.polyfit(depths, np.log(weight[inside]), 1)[0]), 0.0)
        return rates
