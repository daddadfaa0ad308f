"""Tallies: they trace the rays of a scene, score them, and add up the scores."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.core.validation import invalid
from splits.kernels.records import (
    CROSSING_RAY,
    EXIT_LENGTH,
    N_STOKES_COLUMNS,
    TraceResult,
    allocate_exits,
)
from splits.kernels.scene import (
    N_RAYS,
    NO_GROUND,
    NO_MAX_ORDER,
    Optics,
    Scene,
    make_bounding_optics,
)
from splits.simulation.spectral_nodes import IndexNodes, bound_fraction_error
from splits.simulation.strata import (
    INITIAL_SEGMENTS,
    STRATUM_BOUNDS,
    Evaluation,
    StoppingRule,
    Stratum,
    compute_absorption_per_mfp,
)

# --------------------------------------------------------------------------------------------------
# Allowance for light that few rays carry, in variances that are estimated from the same rays.
#
# Where most of the light is in few rays of large weight, a run may contain none of them.  Its
# scatter is then that of many rays of small weight, and says nothing about the light that is
# missing.  For example, strongly absorbed light that grains reflect without letting it enter has
# the weight 1, and all other light hardly any.
#
# Of rays that have the weight W with the probability q, none is among n rays with the probability
# exp(−nq), which is 6 % for nq = 2√2.  Twice an error of √2·W/n covers the missing light qW in the
# other cases.  This error is that of two rays of the largest possible weight (Agresti and Coull
# 1998 add two successes to a binomial sample for the same coverage).  The allowance decreases
# linearly with the variance, to 0 where it is that of eight such rays.

UNSEEN_RAYS, SUFFICIENT_RAYS = 2.0, 8.0
"""Rays of the largest weight that may be missing, and whose scatter is reliable."""
_SCATTER_FRACTION = 1.0 - UNSEEN_RAYS / SUFFICIENT_RAYS


def allow_for_unseen_rays(
    variance: np.ndarray, single_ray_variance: np.ndarray | float
) -> np.ndarray:
    """Return variances that include rays of large weight that a run does not contain.

    Parameters
    ----------
    variance : float
        From the scatter.
    single_ray_variance : float
        Square of the contribution of one ray of the largest possible weight.

    Returns
    -------
    float
        The larger of σ² and 3σ²/4 + 2s² for the variance σ² and that of a single ray s².
    """
    allowed = _SCATTER_FRACTION * variance + UNSEEN_RAYS * single_ray_variance
    return np.maximum(variance, allowed)


def find_required_rays(
    variance: np.ndarray, single_ray_variance: np.ndarray, max_variance: np.ndarray
) -> np.ndarray:
    """Return the rays with which the variance of a mean, with the allowance, is the largest.

    Parameters
    ----------
    variance, single_ray_variance : float
        Variance of the weight of a ray, and square of its largest deviation from the mean.
    max_variance : float
        Largest variance of the mean.
    """
    scatter = _SCATTER_FRACTION * variance / max_variance
    unseen = UNSEEN_RAYS * single_ray_variance / max_variance
    required = 0.5 * (scatter + np.sqrt(scatter**2 + 4.0 * unseen))
    return np.maximum(variance / max_variance, required)


# --------------------------------------------------------------------------------------------------
# Tallies: they trace the rays of a scene, score them, and add up the scores.

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
        (`splits.kernels.rng`).  Each class of tallies owns a million numbers, so that with one
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

    def average_batches(self, batch_sums: np.ndarray) -> np.ndarray:
        """Return means by batch and row, from sums whose first axis is the batch.

        Their third axis is the node row, and that of the result the row.
        """
        per_batch = np.moveaxis(batch_sums, 2, -1) / (self.count_rays() / len(batch_sums))
        return np.moveaxis(self.combine_nodes(per_batch), -1, 2)

    def compute_fraction_error(
        self, by_batch: np.ndarray, interpolation_bound: np.ndarray
    ) -> np.ndarray:
        """Return the errors of mean fractions of the light, with the allowance for unseen rays.

        Parameters
        ----------
        by_batch : float, shape (batches, ...)
        interpolation_bound : float, shape (...)
        """
        mean = by_batch.mean(axis=0)
        single_ray = 1.0 / self.stratum_rays.min()
        variance = allow_for_unseen_rays(
            compute_batch_stderr(by_batch) ** 2, (single_ray * (1.0 - mean)) ** 2
        )
        return np.hypot(np.sqrt(variance), bound_fraction_error(interpolation_bound, mean))

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


# --------------------------------------------------------------------------------------------------
# Tallies of the exits and crossings of rays, which the vectorized kernel traces where possible.

CROSSINGS_PER_BOUNDARY = 4
"""Expected crossings of a boundary per ray, for the memory of a job."""


class ExitTally(Tally):
    """Tally of the exits and crossings of rays, see `Tally`."""

    @abstractmethod
    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> Any:
        """Return the score of a chunk of a stratum's rays, from their exits and crossings."""

    def count_ray_values(self, scene: Scene) -> int:
        """Return the number of values that are recorded of each ray."""
        n_lengths = self.absorption.shape[1]
        n_recorded = int(scene.ground_column != NO_GROUND)
        if scene.record_crossings:
            n_recorded = len(scene.layers.boundaries) - 1
        n_crossings = CROSSINGS_PER_BOUNDARY * n_recorded
        return EXIT_LENGTH + n_lengths + N_STOKES_COLUMNS + n_crossings * (3 + n_lengths)

    def select_kernel(self, scene: Scene, kernel: str) -> None:
        """Set the features of the vectorized kernel of each stratum, None for the scalar kernel.

        The kernel for reflection with extinction also handles negligible extinction, so that strata
        that differ only in extinction can share it.
        """
        if kernel == "scalar":
            return
        from splits.kernels.vectorized.trace import select_features

        for stratum in self.strata:
            stratum.features = select_features(scene, stratum.optics)
            if stratum.features is None:
                super().select_kernel(scene, kernel)
        if self.shares_kernel and any(
            one.features and one.features.absorbing for one in self.strata
        ):
            for stratum in self.strata:
                if stratum.features and not stratum.features.mixed:
                    stratum.features = stratum.features._replace(absorbing=True)

    def trace_job(self, seed: int, scene: Scene, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job and score their chunks."""
        from splits.kernels import vectorized
        from splits.kernels.rough_surface.realization import allocate_realization
        from splits.kernels.transport import history

        work = np.array([(one.stream, rays.start, len(rays), one.max_order) for one, rays in job])
        strata, end_rays = [stratum for stratum, _ in job], np.cumsum(work[:, N_RAYS])
        n_stokes = 0 if scene.stokes is None else N_STOKES_COLUMNS
        exits = allocate_exits(int(end_rays[-1]), self.absorption.shape[1], n_stokes)
        exits_by_item = np.split(exits, end_rays[:-1])
        if strata[0].features is None:
            fields = scene.height_fields
            realization = None if fields is None else allocate_realization(fields)
            results = [
                history.trace_rays(seed, item, scene, stratum.optics, item_exits, realization)
                for item, stratum, item_exits in zip(work, strata, exits_by_item, strict=True)
            ]
        else:
            optics = Optics(*map(np.stack, zip(*(one.optics for one in strata), strict=True)))
            n_segments, lost, crossings = vectorized.trace_rays(
                seed, work, scene, optics, exits, strata[0].features
            )
            # Stable, so that the crossings of each ray remain in order of time.
            crossings = crossings[np.argsort(crossings[:, CROSSING_RAY], kind="stable")]
            rows = np.searchsorted(crossings[:, CROSSING_RAY], end_rays[:-1])
            crossings_by_item = np.split(crossings, rows)
            for item_crossings, first_ray in zip(crossings_by_item[1:], end_rays[:-1], strict=True):
                item_crossings[:, CROSSING_RAY] -= first_ray
            results = [
                TraceResult(count, lost, item_crossings)
                for count, item_crossings in zip(
                    np.split(n_segments, len(job)), crossings_by_item, strict=True
                )
            ]
        if any(result.lost for result in results):
            raise RuntimeError(LOST_MESSAGE)
        return [
            (self._score_chunks(stratum, item_exits, crossings), int(n_segments[0]))
            for stratum, item_exits, (n_segments, _, crossings) in zip(
                strata, exits_by_item, results, strict=True
            )
        ]

    def _score_chunks(
        self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray
    ) -> list[Any]:
        """Return the score of each chunk of an item, in order."""
        starts, scores = np.arange(0, len(exits), self.rays_per_chunk), []
        rays = np.searchsorted(crossings[:, CROSSING_RAY], starts[1:])
        for start, chunk_crossings in zip(starts, np.split(crossings, rays), strict=True):
            chunk_crossings[:, CROSSING_RAY] -= start
            chunk_exits = exits[start : start + self.rays_per_chunk]
            scores.append(self.score(stratum, chunk_exits, chunk_crossings))
        return scores
