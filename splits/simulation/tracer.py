"""Tracers: what traces the rays of a scene on a thread, and scores them for a tally."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.kernels import vectorized
from splits.kernels.base.scene import NO_GROUND, Optics
from splits.kernels.base.work import N_RAYS
from splits.kernels.rough_surface.realization import allocate_realization
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.kernels.tallies.exits import EXIT_LENGTH, TraceResult, allocate_exits
from splits.kernels.transport import history
from splits.kernels.vectorized.eligibility import select_features
from splits.media.medium import Medium
from splits.simulation.scene import (
    add_recording_planes,
    build_scene,
    count_length_columns,
    make_height_fields,
)
from splits.simulation.tally import ExitTally, Stratum

LOST_MESSAGE = (
    "no grain fits between the boundaries along a ray, or a ray is lost at a rough surface: "
    "the sample is barely thicker than its grains, or the incidence too close to 90 degrees"
)

CROSSINGS_PER_BOUNDARY = 4
"""Expected crossings of a boundary per ray, for the memory of a job."""

WorkItem = tuple[Stratum, range]
"""Successive rays of a stratum, a multiple of the rays of a chunk."""
ItemScores = tuple[list[Any], int]
"""The score of each chunk of a work item, in order, and the segments traced."""


class Tracer:
    """Traces rays of a scene and scores them.

    A subclass traces chunk by chunk and defines `trace_chunk`, or redefines `trace_job`.

    Attributes
    ----------
    values_per_ray : int
        Values that are recorded of each ray.
    """

    values_per_ray = 0

    def select_kernel(self, strata: Sequence[Stratum], kernel: str, share: bool) -> None:
        """Set the features of the kernel of each stratum; here, there is a scalar kernel only.

        Parameters
        ----------
        strata : sequence of Stratum
        kernel : {"auto", "vectorized", "scalar"}
        share : bool
            Let all strata use one kernel, if possible.

        Raises
        ------
        ValueError
            If the vectorized kernel is requested and does not support the scene.
        """
        if kernel == "vectorized":
            raise invalid(
                "kernel", "vectorized", "'auto' or 'scalar' for this sample",
                "not for particle layers, analog absorption, stacked coatings, extreme inputs",
            )  # fmt: skip

    def trace_job(self, seed: int, tally: Any, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job, which use one kernel, and return the scores of each.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        results = []
        for stratum, rays in job:
            n_segments, scores = 0, []
            for first_ray in rays[:: tally.rays_per_chunk]:
                score, n_chunk_segments = self.trace_chunk(seed, tally, stratum, first_ray)
                n_segments += n_chunk_segments
                scores.append(score)
            results.append((scores, n_segments))
        return results

    def trace_chunk(
        self, seed: int, tally: Any, stratum: Stratum, first_ray: int
    ) -> tuple[Any, int]:
        """Trace a chunk of a stratum's rays, and return its score and the segments traced."""
        raise NotImplementedError


class SceneTracer(Tracer):
    """Tracer that records exits and crossings of rays in a medium, vectorized where possible.

    Parameters
    ----------
    medium : Medium
    incidence_deg : float or "diffuse"
    analog : bool
        Whether absorption is analog, sampled at each segment.
    planes_m : sequence of float
        Depths (m) of recording planes, besides all boundaries between layers; without any,
        crossings are not recorded.

    Attributes
    ----------
    scene : Scene
    stokes_columns : tuple of int
        Columns of exits that hold Q, U, V over I, or nothing.
    """

    def __init__(
        self,
        medium: Medium,
        incidence_deg: float | str,
        *,
        analog: bool = False,
        planes_m: Sequence[float] = (),
    ) -> None:
        self.scene = build_scene(medium, incidence_deg, analog)
        self.height_fields = make_height_fields(medium)
        self.n_length_columns = count_length_columns(medium)
        # After the path lengths in all materials.
        first = EXIT_LENGTH + self.n_length_columns
        is_polarized = self.scene.stokes is not None
        self.stokes_columns = (first, first + 1, first + 2) if is_polarized else ()
        self.values_per_ray = first + len(self.stokes_columns)
        n_recorded = int(self.scene.ground_column != NO_GROUND)
        if planes_m:
            self.scene = add_recording_planes(self.scene, planes_m)
            n_recorded = len(self.scene.layers.boundaries) - 1
        n_crossings = CROSSINGS_PER_BOUNDARY * n_recorded
        self.values_per_ray += n_crossings * (3 + self.n_length_columns)

    def select_kernel(self, strata: Sequence[Stratum], kernel: str, share: bool) -> None:
        """Set the features of the vectorized kernel of each stratum, None for the scalar kernel.

        The kernel for reflection with extinction also handles negligible extinction, so that strata
        that differ only in extinction can share it.
        """
        if kernel == "scalar":
            return
        for stratum in strata:
            stratum.features = select_features(self.scene, stratum.optics)
            if stratum.features is None:
                super().select_kernel(strata, kernel, share)
        if share and any(one.features and one.features.absorbing for one in strata):
            for stratum in strata:
                if stratum.features and not stratum.features.mixed:
                    stratum.features = stratum.features._replace(absorbing=True)

    def trace_job(self, seed: int, tally: ExitTally, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job and score their chunks."""
        work = np.array([(one.stream, rays.start, len(rays), one.max_order) for one, rays in job])
        exits = allocate_exits(
            int(work[:, N_RAYS].sum()), self.n_length_columns, len(self.stokes_columns)
        )
        strata, end_rays = [stratum for stratum, _ in job], np.cumsum(work[:, N_RAYS])
        exits_by_item = np.split(exits, end_rays[:-1])
        if strata[0].features is None:
            fields = self.height_fields
            realization = None if fields is None else allocate_realization(fields)
            results = [
                history.trace_rays(
                    seed, item, self.scene, stratum.optics, item_exits, fields, realization
                )
                for item, stratum, item_exits in zip(work, strata, exits_by_item, strict=True)
            ]
        else:
            optics = Optics(*map(np.stack, zip(*(one.optics for one in strata), strict=True)))
            result = vectorized.trace_rays(
                seed, work, self.scene, optics, exits, strata[0].features
            )
            results = _split_by_item(result, end_rays)
        if any(result.lost for result in results):
            raise RuntimeError(LOST_MESSAGE)
        return [
            (list(_score_chunks(tally, stratum, item_exits, crossings)), int(n_segments[0]))
            for stratum, item_exits, (n_segments, _, crossings) in zip(
                strata, exits_by_item, results, strict=True
            )
        ]


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


def _score_chunks(
    tally: ExitTally, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray
) -> Iterator[Any]:
    """Yield the score of each chunk of an item, in order."""
    starts = np.arange(0, len(exits), tally.rays_per_chunk)
    rays = np.searchsorted(crossings[:, CROSSING_RAY], starts[1:])
    for start, chunk_crossings in zip(starts, np.split(crossings, rays), strict=True):
        chunk_crossings[:, CROSSING_RAY] -= start
        yield tally.score(stratum, exits[start : start + tally.rays_per_chunk], chunk_crossings)
