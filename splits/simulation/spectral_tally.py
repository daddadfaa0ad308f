"""Tally of spectra: paths shared by all wavelengths, by several media, and by derivatives.

The lengths of a path in the materials give its weight for any absorption (SPLITSnow Eqs 5-6).  One
ensemble of paths therefore gives results at all wavelengths with about the same refractive indices,
for every medium with the same grains and layers, and derivatives with respect to all absorption
parameters, without more tracing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.records import BLOCK_SIZE, N_BATCHES, WeightSums
from splits.kernels.scene import Scene
from splits.simulation.shared_paths import SpectralRows
from splits.simulation.spectral_nodes import (
    IndexNodes,
    bound_derivative_error,
    bound_fraction_error,
)
from splits.simulation.strata import (
    LARGE_PROBLEM_ROWS,
    STRATUM_BOUNDS,
    Evaluation,
    StoppingRule,
    Stratum,
    VarianceTerms,
    allocate_rays,
    compute_absorption_per_mfp,
)
from splits.simulation.tally import ExitTally, allow_for_unseen_rays, find_required_rays

SIDE_QUANTITIES = ("reflectance", "transmittance")
QUANTITY_LABELS = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}
"""Labels of the quantities of an estimate, in their order."""
PILOT_RAYS = 256
ANALOG_PILOT_RAYS = 2048
"""Rays of the first round per stratum, and with analog absorption.  The number of rays still needed
is predicted from them.  Stopping on the variance of the rays that also form the mean biases small
values low; a first round that is large against the few events seen keeps this bias far below the
error."""
ANALOG_STREAM = 9_000_000
"""First random stream with analog absorption."""
RAYS_PER_LARGE_CHUNK = 1024
"""Rays of a chunk for sums over many rows, which take more memory than the rays."""
SINGLE_STRATUM = (-1.0,)
"""Bound of a single stratum per node: all its rows use every ray, so that their noise is common."""


class Derivatives(NamedTuple):
    """Derivatives of reflected and transmitted fractions.

    Attributes
    ----------
    mean : float, shape (2, parameters, rows)
    batch_deviations : float, shape (batches, 2, parameters, rows)
        Contributions of batches to the deviations of the means: sums of products are covariances.
        There are `N_BATCHES` of rays, and none of a solution without noise.
    bias_bound : float, shape (2, parameters, rows)
        Bound on the systematic error.
    """

    mean: np.ndarray
    batch_deviations: np.ndarray
    bias_bound: np.ndarray

    def select(self, selection: slice) -> Derivatives:
        """Return the derivatives with respect to some of the parameters."""
        return Derivatives(
            self.mean[:, selection],
            self.batch_deviations[:, :, selection],
            self.bias_bound[:, selection],
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Derivatives]) -> Derivatives:
        """Return the derivatives with respect to the parameters of all parts."""
        mean, batch_deviations, bias_bound = zip(*parts, strict=True)
        return cls(
            np.concatenate(mean, axis=1),
            np.concatenate(batch_deviations, axis=2),
            np.concatenate(bias_bound, axis=1),
        )

    @classmethod
    def from_solution(cls, mean: np.ndarray, bias_bound: np.ndarray) -> Derivatives:
        """Return derivatives without noise."""
        return cls(mean, np.zeros((0, *mean.shape)), bias_bound)

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shaped like the means."""
        noise = np.sqrt((self.batch_deviations**2).sum(axis=0))
        # The square of a small bound would be 0.
        return np.hypot(noise, self.bias_bound)


@dataclass(frozen=True)
class SpectralEstimate:
    """Means and standard errors, shape (3, rows): reflected, transmitted, absorbed.

    A row is a wavelength of one medium; several media may share paths.

    Attributes
    ----------
    interpolation_error : float, shape (3, rows)
        Part of the standard error due to interpolation between refractive indices.
    batch_deviations : float, shape (batches, 2, rows)
        Contributions of batches to the deviations of the reflected and transmitted means: sums over
        them of squares are unbiased variances, sums of products covariances.
    derivatives : Derivatives
        Derivatives to the requested parameters.
    interpolation_bound : float, shape (rows,)
        See `splits.simulation.spectral_nodes.IndexNodes`.
    rays : dict of str to object
        Attributes about the rays of all rows, see `splits.simulation.tally.Tally.describe_rays`.
    """

    mean: np.ndarray
    stderr: np.ndarray
    interpolation_error: np.ndarray
    batch_deviations: np.ndarray
    derivatives: Derivatives
    interpolation_bound: np.ndarray
    rays: dict[str, Any]

    @classmethod
    def from_solution(
        cls, mean: np.ndarray, stderr: np.ndarray, attributes: dict[str, Any]
    ) -> SpectralEstimate:
        """Return a solution of the equation of transfer: no rays, no noise, no interpolation."""
        sides, none = mean[:2], mean[:2, np.newaxis][:, :0]
        return cls(
            mean, stderr, np.broadcast_to(0.0, stderr.shape), np.zeros((0, *sides.shape)),
            Derivatives.from_solution(none, none), np.zeros(mean.shape[1]),
            {"rays": 0, **attributes},
        )  # fmt: skip

    @property
    def max_stderr(self) -> float:
        """Largest standard error; NaN of rows without result are left out."""
        return float(np.nanmax(self.stderr, initial=0.0))

    def get_stop_reason(self, max_stderr: float, max_rays: int) -> str:
        """Return why tracing stopped: the rows reached an error, which others may not have.

        Without rays, it is that of discrete ordinates.
        """
        if self.max_stderr <= max_stderr:
            return "converged"
        if not self.rays["rays"]:
            return "solver_error"
        return "max_rays" if self.rays["rays"] >= max_rays else "interpolation_bound"

    def select(self, rows: slice) -> SpectralEstimate:
        """Return the estimate of some rows; derivatives are those of all rows."""
        by_row = (
            "mean",
            "stderr",
            "interpolation_error",
            "batch_deviations",
            "interpolation_bound",
        )
        return replace(self, **{name: getattr(self, name)[..., rows] for name in by_row})


class SpectralTally(ExitTally):
    """Tally of reflected and transmitted weights, see `Tally`.

    Parameters
    ----------
    rows : SpectralRows
    nodes : IndexNodes
    scene : Scene
    bounds : sequence of float
        Absorption at which strata begin, at most as many as `STRATUM_BOUNDS`; an analog tally has
        one stratum per node only.

    Attributes
    ----------
    moments : float, shape (3, 3, node rows)
        Over the rays, [reflected, transmitted, both][Σ weight, Σ weight², largest weight].
    min_weight : float, shape (node rows,)
        Smallest weight of a ray that left the medium; 0 once one was absorbed.
    batch_sums, derivative_sums : float, shape (N_BATCHES, 2, …, node rows)
        Σ weight of the rays of every batch, reflected and transmitted, and its derivatives.
    """

    first_stream = 0
    shares_kernel = True

    def __init__(
        self,
        rows: SpectralRows,
        nodes: IndexNodes,
        scene: Scene,
        bounds: Sequence[float] = STRATUM_BOUNDS,
    ) -> None:
        strength = compute_absorption_per_mfp(scene, rows.min_absorption)
        super().__init__(nodes, rows.absorption, strength)
        self.absorption_derivatives, self.scene = rows.absorption_derivatives, scene
        n_parameters, n_rows = len(rows.absorption_derivatives), len(self.rows)
        self.moments = np.zeros((3, 3, n_rows))
        self.min_weight = np.full(n_rows, np.inf)
        self.batch_sums = np.zeros((N_BATCHES, 2, n_rows))
        self.derivative_sums = np.zeros((N_BATCHES, 2, n_parameters, n_rows))
        analog = scene.rules.analog
        self.pilot_rays = ANALOG_PILOT_RAYS if analog else PILOT_RAYS
        if len(rows.absorption) > LARGE_PROBLEM_ROWS and not n_parameters:
            self.rays_per_chunk = self.rays_per_round = RAYS_PER_LARGE_CHUNK
            self.pilot_rays = max(self.pilot_rays, RAYS_PER_LARGE_CHUNK)
        blocks_per_chunk = self.rays_per_chunk // BLOCK_SIZE
        self.values_per_row = 10 + N_BATCHES + n_parameters * blocks_per_chunk
        self.first_stream = ANALOG_STREAM if analog else self.first_stream
        bounds = bounds[:1] if analog else bounds
        self.add_strata_by_absorption(rows.min_absorption, scene, bounds)

    def score(
        self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray
    ) -> tuple[WeightSums, np.ndarray | None]:
        """Return the sums of weights, and the derivatives of the block sums, if there are any."""
        from splits.kernels.tallies.exits import tally_derivatives, tally_weights

        rows, ground_column = self.rows[stratum.node_rows], self.scene.ground_column
        absorption = self.absorption[rows]
        sums = tally_weights(
            exits, crossings, absorption, not self.scene.rules.analog, ground_column
        )
        if not len(self.absorption_derivatives):
            return sums, None
        derivatives = self.absorption_derivatives[:, rows]
        return sums, tally_derivatives(exits, crossings, absorption, derivatives, ground_column)

    def merge(self, stratum: Stratum, score: tuple[WeightSums, np.ndarray | None]) -> None:
        """Add the score of the next chunk of a stratum to the sums."""
        (moments, min_weight, block_sums), derivatives = score
        rows, first = stratum.node_rows, stratum.n_rays // BLOCK_SIZE % N_BATCHES
        self.moments[:, :2, rows] += moments[:, :2]
        self.moments[:, 2, rows] = np.maximum(self.moments[:, 2, rows], moments[:, 2])
        self.min_weight[rows] = np.minimum(self.min_weight[rows], min_weight)
        self.batch_sums[first : first + len(block_sums), :, rows] += block_sums
        if derivatives is not None:
            self.derivative_sums[first : first + len(derivatives), :, :, rows] += derivatives

    def compute_scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Return variances per ray, and the square of the largest deviation of a weight.

        Both are of reflected, transmitted and absorbed weight, shape (3, node rows).  To the rays,
        two are added, of the largest and of the smallest weight that were recorded or are possible
        (after Agresti & Coull 1998), so that equal arrivals do not give a zero variance.
        """
        total, square, largest = self.moments[:, 0], self.moments[:, 1], self.moments[:, 2]
        smallest = np.zeros_like(largest)
        is_absorbing = self.absorption[self.rows].max(axis=1) > 0.0
        particles = self.scene.particles
        may_vanish = self.scene.rules.analog & is_absorbing
        may_vanish |= particles is not None and bool((particles.albedo < 1.0).any())
        smallest[2] = np.where(may_vanish, 0.0, self.min_weight)
        n = self.count_rays() + 2.0
        mean = (total + largest + smallest) / n
        variance = np.maximum((square + largest**2 + smallest**2) / n - mean**2, 0.0)
        return variance, np.maximum(1.0 - mean, mean - smallest) ** 2

    def compute_variances(self) -> np.ndarray:
        """Return the variances of the means of reflected, transmitted and absorbed weight."""
        n_rays = self.count_rays()
        variance, largest_square = self.compute_scatter()
        return allow_for_unseen_rays(variance / n_rays, largest_square / n_rays**2)

    def compute_means(self) -> np.ndarray:
        """Return the reflected, transmitted and absorbed fractions, shape (3, rows)."""
        mean = self.combine_nodes(self.moments[:2, 0] / self.count_rays())
        return np.concatenate([mean, 1.0 - mean.sum(axis=0, keepdims=True)])

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest standard error, and the estimate."""
        estimate = self.make_estimate()
        return Evaluation(float(estimate.stderr.max()), estimate)

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays with which the largest standard error is the requested one."""
        target = stop.max_error**2 - evaluation.estimate.interpolation_error**2
        target = target[:, self.rows]
        # The allowance for rare light decreases faster with the number of rays than scatter.
        rays = find_required_rays(*self.compute_scatter(), target)
        terms = VarianceTerms(self.weights**2 * rays, self.rows, self.find_contributions())
        return allocate_rays(terms, self.strata)

    def make_estimate(self) -> SpectralEstimate:
        """Return means, errors, batch deviations and derivatives."""
        variance = self.combine_nodes(self.compute_variances(), power=2)
        mean, bound = self.compute_means(), self.nodes.interpolation_bound
        bias = bound_fraction_error(bound, mean)
        means, derivative_means = self.moments[:2, 0], self.derivative_sums.sum(axis=0)
        deviations = self.combine_nodes(self._compute_deviations(self.batch_sums, means))
        derivatives = self.combine_nodes(derivative_means / self.count_rays())
        return SpectralEstimate(
            mean,
            np.sqrt(variance + bias**2),
            bias,
            rescale_deviations(deviations, variance[:2]),
            Derivatives(
                derivatives,
                self.combine_nodes(
                    self._compute_deviations(self.derivative_sums, derivative_means)
                ),
                bound_derivative_error(bound, derivatives),
            ),
            bound,
            self.describe_rays(),
        )

    def _compute_deviations(self, batch_sums: np.ndarray, total: np.ndarray) -> np.ndarray:
        """Return contributions of batches to the deviations of means, from sums of weights.

        Sums over batches of products of two of them estimate covariances of means (random groups;
        Wolter 2007, Introduction to Variance Estimation, chapter 2).
        """
        rays_per_batch = np.zeros((N_BATCHES, len(self.rows)))
        for stratum in self.strata:
            n_cycles, remainder = divmod(stratum.n_rays // BLOCK_SIZE, N_BATCHES)
            n_blocks = n_cycles + (np.arange(N_BATCHES) < remainder)
            rays_per_batch[:, stratum.node_rows] += BLOCK_SIZE * n_blocks[:, np.newaxis]
        n_rays = self.count_rays()
        rays_per_batch = rays_per_batch.reshape(N_BATCHES, *[1] * (batch_sums.ndim - 2), -1)
        return (batch_sums - rays_per_batch * (total / n_rays)) / n_rays


def rescale_deviations(deviations: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return batch deviations whose squares add up to a more precisely known variance.

    Their correlations are preserved; zero deviations remain zero.

    Parameters
    ----------
    deviations : float, shape (batches, ...)
    variance : float, shape (...)
    """
    sum_of_squares = (deviations**2).sum(axis=0)
    nonzero = sum_of_squares > 0.0
    return deviations * np.sqrt(
        np.divide(variance, sum_of_squares, out=np.zeros_like(sum_of_squares), where=nonzero)
    )
