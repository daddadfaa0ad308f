"""Tallies: they trace the rays of a scene, score them, and add up the scores."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.kernels.base.scene import Scene, make_bounding_optics
from splits.kernels.base.work import NO_MAX_ORDER
from splits.simulation.rare_light import allow_for_unseen_rays
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stopping_rule import Evaluation, StoppingRule
from splits.simulation.stratum import (
    INITIAL_SEGMENTS,
    STRATUM_BOUNDS,
    Stratum,
    compute_absorption_per_mfp,
)

RAYS_PER_CHUNK = 128
"""Rays whose scores are added up together: fixed, so that sums do not depend on the threads."""
LOST_MESSAGE = (
    "no grain fits between the boundaries along a ray, or a ray is lost at a rough surface: "
    "the sample is barely thicker than its grains, or the incidence too close to 90 degrees"
)


WorkItem = tuple[Stratum, range]
"""Successive rays of a stratum, a multiple of the rays of a chunk."""
ItemScores = tuple[list[Any], int]
"""The score of each chunk of a work item, in order, and the segments traced."""


class Tally(ABC):
    """Scores of rays, summed by node row; it traces the rays, too.

    A subclass traces chunk by chunk and defines `trace_chunk`, or redefines `trace_job`.

    A row of a result, a wavelength of one medium, is the weighted mean of the results at the index
    nodes around it.  A node row is a row at one of its nodes.

    Parameters
    ----------
    nodes : IndexNodes
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m) of all rows.
    order : float, shape (rows,), optional
        The node rows of a node are in increasing order of this.

    Attributes
    ----------
    strata : list of Stratum
    rows, node_of_row : int, shape (node rows,)
        Row and node of each node row, node after node.
    weights : float, shape (node rows,)
        Weight of the node in the row.
    rays_per_chunk : int
        Rays whose scores are added up together.
    values_per_row : int
        Values in the score of a chunk for each of the node rows.
    rays_per_round : int
        The rays of a stratum are a multiple of this.
    pilot_rays : int
        Rays of each stratum in the first round.
    first_stream : int
        First number of the random streams, which are identified by seed, stream number and ray
        (`splits.kernels.math.rng`).  Each class of tallies owns a million numbers, so that with one
        seed no two instruments use the same random numbers.
    shares_kernel : bool
        Whether all strata are traced by one kernel, if possible, so that they fill its lanes.
    """

    rays_per_chunk = rays_per_round = pilot_rays = RAYS_PER_CHUNK
    values_per_row = 1
    shares_kernel = False
    first_stream: int

    def __init__(
        self, nodes: IndexNodes, absorption: np.ndarray, order: np.ndarray | None = None
    ) -> None:
        self.nodes, self.absorption = nodes, absorption
        used = [np.flatnonzero(weights) for weights in nodes.weights]
        if order is not None:
            used = [rows[np.argsort(order[rows], kind="stable")] for rows in used]
        self.first_rows = np.cumsum([0, *map(len, used)])
        self.rows = np.concatenate(used)
        self.node_of_row = np.repeat(np.arange(len(used)), np.diff(self.first_rows))
        self.weights = nodes.weights[self.node_of_row, self.rows]
        self.strata: list[Stratum] = []

    def select_node(self, node: int) -> slice:
        """Return the node rows of a node."""
        return slice(int(self.first_rows[node]), int(self.first_rows[node + 1]))

    def add_strata(self, max_orders: Sequence[int] = (NO_MAX_ORDER,)) -> None:
        """Add a stratum for each node and largest order of scattering."""
        for node, index in enumerate(self.nodes.index):
            node_rows = self.select_node(node)
            absorption = self.absorption[self.rows[node_rows]]
            optics = make_bounding_optics(index, absorption)
            for max_order in max_orders:
                stream = self.first_stream + len(self.strata)
                segments = min(3.0 * max_order, INITIAL_SEGMENTS)
                self.strata.append(
                    Stratum(stream, optics, node_rows, absorption, segments, max_order)
                )

    def add_strata_by_absorption(
        self, absorption: np.ndarray, scene: Scene, bounds: Sequence[float] = STRATUM_BOUNDS
    ) -> None:
        """Add strata for increasingly absorbed rows of each node, which are in this order.

        Parameters
        ----------
        absorption : float, shape (rows, columns)
            Absorption that determines strata and roulette.
        scene : Scene
        bounds : sequence of float
            Absorption at which strata begin, at most as many as `STRATUM_BOUNDS`.
        """
        strength = compute_absorption_per_mfp(scene, absorption)
        for node, index in enumerate(self.nodes.index):
            last_count, end = 0, self.select_node(node).stop
            for step, threshold in enumerate(bounds):
                rows = self.rows[self.select_node(node)]
                rows = rows[strength[rows] >= threshold]
                if len(rows) in (0, last_count):
                    continue
                last_count = len(rows)
                stream = self.first_stream + node * len(STRATUM_BOUNDS) + step
                optics = make_bounding_optics(index, absorption[rows])
                segments = INITIAL_SEGMENTS / 1.5**step
                node_rows = slice(end - len(rows), end)
                stratum = Stratum(stream, optics, node_rows, self.absorption[rows], segments)
                self.strata.append(stratum)

    def count_score_values(self) -> int:
        """Return the largest number of values in the score of a chunk."""
        return self.values_per_row * int(np.diff(self.first_rows).max())

    def count_ray_values(self, scene: Scene) -> int:
        """Return the number of values that are recorded of each ray."""
        return 0

    def select_kernel(self, scene: Scene, kernel: str) -> None:
        """Set the features of the kernel of each stratum; here, there is a scalar kernel only.

        Raises
        ------
        ValueError
            If the vectorized kernel is requested and does not support the scene.
        """
        if kernel == "vectorized":
            raise invalid(
                "kernel", "vectorized", "'auto' or 'scalar' for this sample",
                "not for particle layers, polarization, analog absorption, stacked coatings, "
                "extreme inputs",
            )  # fmt: skip

    def trace_job(self, seed: int, scene: Scene, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job, which use one kernel, and return the scores of each.

        Threads trace jobs at the same time; no method that they call changes the tally.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        results = []
        for stratum, rays in job:
            chunks = [
                self.trace_chunk(seed, scene, stratum, first_ray)
                for first_ray in rays[:: self.rays_per_chunk]
            ]
            scores, n_segments = zip(*chunks, strict=True)
            results.append((list(scores), sum(n_segments)))
        return results

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[Any, int]:
        """Trace a chunk of a stratum's rays, and return its score and the segments traced."""
        raise NotImplementedError

    @abstractmethod
    def merge(self, stratum: Stratum, score: Any) -> None:
        """Add the score of the next chunk of a stratum to the sums."""

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the error reached, and the estimate; without an error to reach, infinity."""
        return Evaluation(np.inf)

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays of each stratum that would satisfy the stopping rule."""
        return np.full(len(self.strata), np.inf)

    def plan_first_round(self, stop: StoppingRule) -> np.ndarray:
        """Return the rays of each stratum in the first round."""
        n_strata = len(self.strata)
        if not stop.fixed:
            return np.full(n_strata, self.pilot_rays)
        rounds = -(-stop.max_rays // (n_strata * self.rays_per_round))
        return np.full(n_strata, rounds * self.rays_per_round)

    def describe_run(self, stop_reason: str) -> dict[str, Any]:
        """Return the attributes of a dataset about the cost of a run, and why it stopped."""
        return {
            "stop_reason": stop_reason,
            "interpolation_error_bound": float(self.nodes.interpolation_bound.max()),
            **self.describe_rays(),
        }

    def describe_rays(self) -> dict[str, Any]:
        """Return the attributes of a dataset about the rays traced."""
        return {"rays": self.n_rays, "ensembles": len(self.nodes.index), "kernel": self.kernel}

    @property
    def stratum_rays(self) -> np.ndarray:
        """Rays traced of each stratum, shape (strata,)."""
        return np.array([stratum.n_rays for stratum in self.strata])

    @property
    def n_rays(self) -> int:
        """Number of all rays traced."""
        return int(self.stratum_rays.sum())

    @property
    def kernel(self) -> str:
        """Kernel of the run: "vectorized", "scalar", or both where strata differ."""
        kernels = {"scalar" if one.features is None else "vectorized" for one in self.strata}
        return ", ".join(sorted(kernels))

    def get_batch(self, stratum: Stratum, n_batches: int) -> int:
        """Return the batch of the next chunk of a stratum: chunks take turns."""
        return stratum.n_rays // self.rays_per_chunk % n_batches

    def count_rays(self) -> np.ndarray:
        """Return the rays of each node row, at least 1, shape (node rows,)."""
        count = np.zeros(len(self.rows))
        for stratum in self.strata:
            count[stratum.node_rows] += stratum.n_rays
        return np.maximum(count, 1.0)

    def find_contributions(self) -> np.ndarray:
        """Return where the rays of a stratum contribute, bool, shape (strata, node rows)."""
        contributes = np.zeros((len(self.strata), len(self.rows)), dtype=bool)
        for mask, stratum in zip(contributes, self.strata, strict=True):
            mask[stratum.node_rows] = True
        return contributes

    def combine_nodes(self, values: np.ndarray, power: int = 1) -> np.ndarray:
        """Return sums over nodes of values times a power of the weight, shape (…, rows).

        Parameters
        ----------
        values : float, shape (…, node rows)
        power : int
            1 for means, 2 for variances.
        """
        total = np.zeros((*values.shape[:-1], len(self.absorption)))
        for node in range(len(self.nodes.index)):
            rows = self.select_node(node)
            total[..., self.rows[rows]] += self.weights[rows] ** power * values[..., rows]
        return total

    def combine_moments(
        self, total: np.ndarray, square: np.ndarray, largest: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, ...]:
        """Return means and their standard errors, shape (…, rows).

        Parameters
        ----------
        total, square : float, shape (…, node rows)
            Sums over rays of weights, and of their squares.
        largest : float
            Largest possible weight of a ray; 0 without allowance for unseen rays.
        """
        n_rays = self.count_rays()
        mean = total / n_rays
        variance = np.maximum(square / n_rays - mean**2, 0.0) / n_rays
        variance = allow_for_unseen_rays(
            variance, (np.maximum(largest - np.abs(mean), 0.0) / n_rays) ** 2
        )
        return self.combine_nodes(mean), np.sqrt(self.combine_nodes(variance, power=2))
