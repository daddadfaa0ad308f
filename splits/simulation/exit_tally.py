"""Tallies of the exits and crossings of rays, which the vectorized kernel traces where possible."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.kernels import vectorized
from splits.kernels.base.scene import NO_GROUND, Optics, Scene
from splits.kernels.base.work import N_RAYS
from splits.kernels.rough_surface.realization import allocate_realization
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.kernels.tallies.exits import EXIT_LENGTH, N_STOKES_COLUMNS, TraceResult, allocate_exits
from splits.kernels.transport import history
from splits.kernels.vectorized.eligibility import select_features
from splits.simulation.stratum import Stratum
from splits.simulation.tally import LOST_MESSAGE, ItemScores, Tally, WorkItem

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
            result = vectorized.trace_rays(seed, work, scene, optics, exits, strata[0].features)
            results = _split_by_item(result, end_rays)
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


def _split_by_item(result: TraceResult, end_rays: np.ndarray) -> list[TraceResult]:
    """Return the results of work items, whose rays end at `end_rays`."""
    n_segments, lost, crossings = result
    # Stable, so that the crossings of each ray remain in order of time.
    crossings = crossings[np.argsort(crossings[:, CROSSING_RAY], kind="stable")]
    by_item = np.split(crossings, np.searchsorted(crossings[:, CROSSING_RAY], end_rays[:-1]))
    for item_crossings, first_ray in zip(by_item[1:], end_rays[:-1], strict=True):
        item_crossings[:, CROSSING_RAY] -= first_ray
    return [
        TraceResult(count, lost, item_crossings)
        for count, item_crossings in zip(np.split(n_segments, len(by_item)), by_item, strict=True)
    ]
