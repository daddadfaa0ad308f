"""Tracers: what traces the rays of a scene for a tally."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.kernels.tallies.exits import allocate_exits
from splits.simulation.tally import ExitTally, Stratum, TransportTraits

ItemScores = tuple[list[Any], int]
"""The score of each chunk of a work item, in order, and the segments traced."""


class WorkItem(NamedTuple):
    """Successive rays of a stratum, a multiple of the rays of a chunk."""

    stratum: Stratum
    first_ray: int
    n_rays: int


class TraceResult(NamedTuple):
    """Result of tracing work items, besides the exits.

    Attributes
    ----------
    n_segments : int, shape (items,)
    crossings : list of float, shape (crossings, columns)
        Boundary crossings of each item, ray by ray, rays counted from its first; see
        `splits.kernels.tallies.crossings`.
    lost : bool
        Whether a ray was lost.
    """

    n_segments: Sequence[int]
    crossings: list[np.ndarray]
    lost: bool


class Tracer(ABC):
    """Traces rays of a scene and scores them.

    Attributes
    ----------
    n_exit_columns : int
        Numbers that are recorded of each ray.
    """

    n_exit_columns = 0

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

    @abstractmethod
    def trace_job(self, seed: int, tally: Any, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job, which use one kernel, and return the scores of each.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """


class ExitTracer(Tracer):
    """Tracer that records exits and crossings of rays for the tally.

    Attributes
    ----------
    traits : TransportTraits
    normal_incidence : bool
        Whether the beam is along the normal, so that the scene is axisymmetric.
    diffuse : bool
        Whether the incident light is diffuse.
    boundary_depths_m : float, shape (boundaries,)
        Depths (m) of all boundaries of the scene; of a rough top, a height above it.
    n_length_columns : int
        Columns of exits that hold path lengths.
    stokes_columns : tuple of int
        Columns of exits that hold Q, U, V over I, or nothing.
    """

    LOST_MESSAGE = ""
    traits: TransportTraits
    normal_incidence: bool
    diffuse: bool
    boundary_depths_m: np.ndarray
    n_length_columns: int
    stokes_columns: tuple[int, ...] = ()

    @property
    def n_exit_columns(self) -> int:  # type: ignore[override]
        """Numbers that are recorded of each ray."""
        return self.allocate_exits(1).shape[1]

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return an array for the exits of `n_rays` rays."""
        return allocate_exits(n_rays, self.n_length_columns, len(self.stokes_columns))

    @abstractmethod
    def trace(
        self, seed: int, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray
    ) -> TraceResult:
        """Trace items of strata that share features.

        Parameters
        ----------
        seed : int
        work : int64, shape (items, 4)
            See `splits.kernels.grains.history.trace_batch`.
        strata : sequence of Stratum
            One for each item.
        exits : float, shape (rays, columns)
            Of all items together.
        """

    def trace_job(self, seed: int, tally: ExitTally, job: Sequence[WorkItem]) -> list[ItemScores]:
        """Trace the items of a job and score their chunks."""
        work = np.array(
            [(one.stratum.stream, one.first_ray, one.n_rays, one.stratum.max_order) for one in job]
        )
        exits = self.allocate_exits(int(work[:, 2].sum()))
        result = self.trace(seed, work, [item.stratum for item in job], exits)
        if result.lost:
            raise RuntimeError(self.LOST_MESSAGE)
        exits_by_item = np.split(exits, np.cumsum(work[:, 2])[:-1])
        return [
            (list(_score_chunks(tally, item.stratum, item_exits, crossings)), int(n_segments))
            for item, item_exits, crossings, n_segments in zip(
                job, exits_by_item, result.crossings, result.n_segments, strict=True
            )
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
