"""Tally of a goniophotometer: polynomial coefficients by order of scattering.

Low orders of scattering produce the structure of a BRDF and cost little; high orders make most of
the light, cost most, and are nearly diffuse.  Orders of scattering are therefore grouped in
classes.  Rays of a stratum are terminated after the last order of its class: they contribute to
that class and all before it, so that low classes can have many times the rays of the high ones
(correlated through common paths, which errors from batches account for).
"""

from __future__ import annotations

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.instruments.angular_estimate import (
    N_ANGULAR_BATCHES,
    AngularEstimate,
    AngularTally,
    estimate_row,
    stack_rows,
)
from splits.instruments.angular_truncation import DirectionGrid
from splits.kernels.scene import NO_MAX_ORDER
from splits.kernels.tallies.distributions import AngularSums, tally_expansion
from splits.kernels.tallies.exits import EXIT_ORDER
from splits.simulation.spectral_nodes import INTERPOLATION_FACTOR, IndexNodes
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, ExitTally

MAX_DEGREE = 24
"""Largest degree of the polynomials, which resolve details of about 180°/24."""
ORDER_CLASSES = (2, 8, 32, 128, NO_MAX_ORDER)
"""Largest order of scattering of each class."""

RowVariances = tuple[np.ndarray, np.ndarray]
"""Nodes of a row, and their contributions to its variance, shape (nodes, classes, directions)."""


class ExpansionTally(AngularTally, ExitTally):
    """Tally of exits by direction, as coefficients of orthonormal polynomials.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    directions : DirectionGrid
    incidence : float or "diffuse"
        Unscattered light of a beam leaves as a beam and is excluded from the polynomials; that of
        diffuse light is included.
    target : ErrorTarget

    Attributes
    ----------
    coefficient_sums : float, shape (batches, classes, 2, node rows, polynomials)
        See `splits.kernels.tallies.distributions.tally_expansion`.
    unscattered_sums : float, shape (batches, 2, node rows)
    """

    first_stream = 4_000_000
    rays_per_round = N_ANGULAR_BATCHES * RAYS_PER_CHUNK

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        directions: DirectionGrid,
        incidence: float | str,
        target: ErrorTarget,
    ) -> None:
        super().__init__(nodes, absorption)
        self.directions, self.incidence, self.target = directions, incidence, target
        self.basis = directions.basis
        self.max_orders = np.array(ORDER_CLASSES, dtype=np.int64)
        n_classes, n_rows = len(ORDER_CLASSES), len(self.rows)
        self.coefficient_sums = np.zeros(
            (N_ANGULAR_BATCHES, n_classes, 2, n_rows, self.basis.norms.size)
        )
        self.unscattered_sums = np.zeros((N_ANGULAR_BATCHES, 2, n_rows))
        self.values_per_row = 2 * (1 + n_classes * self.basis.norms.size)
        self.add_strata(ORDER_CLASSES)
        self._earlier_errors: list[tuple[int, float]] = []

    def plan_first_round(self, stop: StoppingRule) -> np.ndarray:
        """Return the rays of each stratum in the first round, from which the others follow."""
        return np.full(len(self.strata), self.rays_per_round)

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> AngularSums:
        """Return the sums of a chunk of exits."""
        scored_orders = self.max_orders[self.max_orders <= stratum.max_order]
        if self.incidence == "diffuse":
            exits[:, EXIT_ORDER] = np.maximum(exits[:, EXIT_ORDER], 1.0)
        return tally_expansion(exits, stratum.absorption, scored_orders, self.basis)

    def merge(self, stratum: Stratum, score: AngularSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_ANGULAR_BATCHES), stratum.node_rows
        self.coefficient_sums[batch, : len(score.scattered), :, rows] += score.scattered
        self.unscattered_sums[batch, :, rows] += score.unscattered

    def count_class_rays(self) -> np.ndarray:
        """Return the rays that contribute to each class, shape (nodes, classes)."""
        rays = self.stratum_rays.reshape(-1, len(ORDER_CLASSES))
        return np.cumsum(rays[:, ::-1], axis=1)[:, ::-1]

    def _estimate_rows(self) -> tuple[AngularEstimate, list[RowVariances]]:
        """Return the estimate, and the contributions to the variance of each wavelength."""
        class_rays = self.count_class_rays()[self.node_of_row]
        estimates, all_variances = [], []
        for row in range(len(self.absorption)):
            used = np.flatnonzero(self.rows == row)
            coefficients, unscattered = [], np.zeros((N_ANGULAR_BATCHES, 2))
            for one in used:
                weight, rays = self.weights[one], class_rays[one] / N_ANGULAR_BATCHES
                sums = self.coefficient_sums[:, :, :, one]
                coefficients.append(weight * sums / rays[:, np.newaxis, np.newaxis])
                unscattered += weight * self.unscattered_sums[:, :, one] / rays[0]
            n_rays = class_rays[used].min(axis=0)
            estimate, variances = estimate_row(
                coefficients, unscattered, n_rays, self.directions,
                self.incidence in (0.0, "diffuse"), self.target,
            )  # fmt: skip
            estimates.append(estimate)
            all_variances.append((self.node_of_row[used], np.stack(variances)))
        return stack_rows(estimates, self.nodes.interpolation_bound), all_variances

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest relative error, and why tracing stops if no rays would reduce it."""
        estimate, self.variances = self._estimate_rows()
        target, n_rays = self.target, self.n_rays
        error = estimate.compute_max_error(target, use_stopping_error=True)
        if error <= stop.max_error:
            resolved = estimate.compute_max_error(target) <= stop.max_error
            return Evaluation(error, estimate, "" if resolved else "unresolved_lobe")
        # Eight times the rays should reduce a statistical error by a factor of nearly three.
        stagnates = any(
            n_rays >= 8.0 * earlier_rays and error > 0.8 * earlier
            for earlier_rays, earlier in self._earlier_errors
        )
        self._earlier_errors.append((n_rays, error))
        limited = estimate.is_truncation_limited(target, stop.max_error)
        return Evaluation(error, estimate, "max_degree" if stagnates or limited else "")

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays of every stratum for the least cost.

        With V the variance per ray and c the segments of a ray in a class, Σ V/M reaches a target
        at the least Σ c·M for M = √(V/c)·Σ √(V·c)/target (Neyman's allocation), M being the rays
        that contribute to a class; the largest M over directions is taken.  Rays contribute to all
        classes up to that of their stratum, so M must not increase from class to class.
        """
        class_rays = self.count_class_rays()
        segments = np.array([one.n_segments / max(one.n_rays, 1) for one in self.strata])
        costs = np.maximum(np.diff(segments.reshape(class_rays.shape), prepend=-1.0, axis=1), 0.01)
        interpolation_error = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        reference = evaluation.estimate.compute_reference(self.target)
        mean = evaluation.estimate.mean[self.target.side][:, self.target.direction_mask]
        targets = (stop.max_error * reference) ** 2 - (interpolation_error * mean) ** 2
        target_rays = np.zeros(class_rays.shape)
        for (nodes, row_variances), target in zip(self.variances, targets, strict=True):
            cost = costs[nodes][:, :, np.newaxis]
            per_ray = row_variances * class_rays[nodes][:, :, np.newaxis]
            root_cost = np.sqrt(per_ray * cost).sum(axis=(0, 1))
            # Directions without light need no rays.
            factor = np.divide(root_cost, target, out=np.zeros_like(root_cost), where=target > 0.0)
            required_rays = (np.sqrt(per_ray / cost) * factor).max(axis=-1)
            target_rays[nodes] = np.maximum(target_rays[nodes], required_rays)
        target_rays = np.maximum.accumulate(target_rays[:, ::-1], axis=1)[:, ::-1]
        stratum_rays = -np.diff(target_rays, axis=1, append=0.0).ravel()
        size = self.rays_per_round
        stratum_rays = np.maximum(np.ceil(1.1 * stratum_rays / size), 1.0) * size
        if stop.fixed:
            stratum_rays *= self._find_scale(stratum_rays, stop.max_rays)
        return stratum_rays

    def _find_scale(self, target_rays: np.ndarray, max_rays: int) -> float:
        """Return the factor of the required rays with which they add up to a number."""
        n_rays = self.stratum_rays
        low, high = 0.0, max_rays / target_rays.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.maximum(middle * target_rays, n_rays).sum() >= max_rays
            low, high = (low, middle) if enough else (middle, high)
        return high
