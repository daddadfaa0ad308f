"""Tracing rays: batches, in jobs, on threads, and the same numbers whoever traces which."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.progress import Progress, ProgressCallback
from splits.kernels.compiler.features import Features
from splits.kernels.tallies.crossings import CROSSING_RAY
from splits.media.medium import Medium
from splits.simulation.tally import RAYS_PER_CHUNK, Stratum, Tally
from splits.simulation.threads import DaemonThreadPool, count_cpus
from splits.simulation.tracer import make_tracer

MAX_JOB_BYTES = 2**27
MAX_SEGMENTS_PER_JOB = 2e7
"""Largest memory (bytes) that a thread's job takes, and number of legs on lanes, for signs of life
every few seconds; of the scalar kernel's, an eighth.  Otherwise the more the
better: lanes stand idle while the last rays of a job end."""

WorkItem = tuple[Tally, Stratum, int, int]
"""Some batches of a level: ensemble, level, first ray, number of batches."""


class Runner:
    """Traces rays of a medium on several threads, the same whatever their number.

    Parameters
    ----------
    medium : GranularMedium or ParticleMedium
    incidence_deg : float or "diffuse"
    seed : int
    threads : int or None
        None takes every CPU this process may use.
    analog : bool
        Absorption by coin toss.
    kernel : {"auto", "vectorized", "scalar"}
    progress_callback : callable, optional
        Receives a `Progress` a few times per second at most.
    planes_m : sequence of float
        Depths (m) of planes to listen at, see `splits.simulation.tracer.GrainTracer`.

    Attributes
    ----------
    rays_per_chunk : int
        Rays whose weights are added up together.
    """

    def __init__(
        self,
        medium: Medium,
        incidence_deg: float | str,
        seed: int,
        threads: int | None,
        analog: bool,
        kernel: str = "auto",
        progress_callback: ProgressCallback = None,
        *,
        planes_m: Sequence[float] = (),
    ) -> None:
        self.seed = seed
        self.tracer = make_tracer(medium, incidence_deg, seed, analog, kernel, planes_m)
        self.threads = threads or count_cpus()
        self.rays_per_chunk = RAYS_PER_CHUNK
        self.progress_callback = progress_callback if callable(progress_callback) else None
        self.start_time = time.perf_counter()
        self._last_report_time = 0.0

    def trace(
        self,
        work: Sequence[tuple[Tally, Stratum, int]],
        stderr: float,
        target: float,
        remaining_rays: float = 0.0,
    ) -> None:
        """Trace so many more rays of each level and add them up in a fixed order.

        Parameters
        ----------
        work : sequence of (Ensemble, Stratum, int)
            Rays to add, rounded up to whole batches.
        stderr, target, remaining_rays : float
            What to report as reached, wanted, and still to do after this (in rays).

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        jobs = self.make_jobs(work)
        begun = time.perf_counter()
        costs = [
            sum(self.estimate_cost(level) * count for _, level, _, count in job) for job in jobs
        ]
        rays = self.rays_per_chunk * sum(count for job in jobs for *_, count in job)
        total = sum(costs) * (1.0 + remaining_rays / rays)
        done = 0.0
        with DaemonThreadPool(self.threads) as pool:
            found = pool.map(self.trace_job, jobs)
            for job, cost, tallied in zip(jobs, costs, found, strict=True):
                for (ensemble, level, *_), (tallies, legs) in zip(job, tallied, strict=True):
                    ensemble.add_scores(level, tallies)
                    level.n_segments += legs
                done += cost
                pace = (time.perf_counter() - begun) / done
                self._report_progress(rays, stderr, target, pace * (total - done))

    def make_jobs(self, work: Sequence[tuple[Tally, Stratum, int]]) -> list[list[WorkItem]]:
        """Return what threads are to trace at a time: levels of one kernel, cut at equal costs."""
        kinds: dict[Features | None, list[WorkItem]] = {}
        for ensemble, level, rays in work:
            piece = ensemble, level, level.n_rays, -(-rays // self.rays_per_chunk)
            kinds.setdefault(self.tracer.get_features(level), []).append(piece)
        jobs = []
        for features, pieces in kinds.items():
            # Short paths last, so that few lanes wait for the last long one.
            pieces.sort(key=lambda piece: -piece[1].expected_segments)
            batches = sum(count for *_, count in pieces)
            cost = sum(self.estimate_cost(level) * count for _, level, _, count in pieces)
            most = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
            held = min(self.compute_job_capacity(ensemble) for ensemble, *_ in pieces)
            # A multiple of the threads, so that all have as much to do.
            number = int(np.ceil(max(cost / most, batches / held) / self.threads)) * self.threads
            number = min(number, batches)
            jobs += self.split_jobs(pieces, number, cost / number, held)
        return jobs

    def compute_job_capacity(self, tally: Tally) -> int:
        """Return how many batches a job may hold: exits of their rays, and tallies."""
        numbers = (
            self.rays_per_chunk * self.tracer.allocate_exits(1).shape[1]
            + tally.count_score_values()
        )
        return max(1, MAX_JOB_BYTES // (8 * numbers))

    def split_jobs(
        self, items: Sequence[WorkItem], n_jobs: int, cost_per_job: float, max_chunks: int
    ) -> list[list[WorkItem]]:
        """Return pieces in a number of jobs that cost about a share each, in order.

        There are more of them where one would hold more than `max_chunks` batches.
        """
        jobs: list[list[WorkItem]] = [[]]
        room, held = cost_per_job, 0
        for ensemble, level, first, count in items:
            cost = self.estimate_cost(level)
            while count > 0:
                if held == max_chunks or (jobs[-1] and room < 0.5 * cost and len(jobs) < n_jobs):
                    jobs.append([])
                    room, held = cost_per_job + min(room, 0.5 * cost), 0
                now = min(count, max_chunks - held)
                if len(jobs) < n_jobs:
                    now = min(now, max(1, round(room / cost)))
                jobs[-1].append((ensemble, level, first, now))
                first += now * self.rays_per_chunk
                count -= now
                room -= now * cost
                held += now
        return jobs

    def estimate_cost(self, stratum: Stratum) -> float:
        """Return the legs to expect of a batch, and one to launch each ray; at first, a guess."""
        if stratum.n_rays == 0:
            return self.rays_per_chunk * (1.0 + stratum.expected_segments)
        return self.rays_per_chunk * (1.0 + stratum.n_segments / stratum.n_rays)

    def share_kernel(self, tallies: Sequence[Tally]) -> None:
        """Let all levels of these ensembles share a kernel, if they can."""
        self.tracer.share_kernel([level for ensemble in tallies for level in ensemble.strata])

    def list_kernels(self, tallies: Sequence[Tally]) -> str:
        """Return which kernels trace these ensembles, joined by a comma."""
        used = {
            "scalar" if self.tracer.get_features(level) is None else "vectorized"
            for ensemble in tallies
            for level in ensemble.strata
        }
        return ", ".join(sorted(used))

    def trace_job(self, job: Sequence[WorkItem]) -> list[tuple[list[Any], int]]:
        """Trace pieces that share a kernel; the same numbers whoever does, and in whatever job.

        Returns
        -------
        list of (list of tallies, int)
            For each piece: what its ensemble makes of each batch, in order, and the legs traced.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        work = np.array(
            [
                (level.stream, first, count * self.rays_per_chunk, level.max_order)
                for _, level, first, count in job
            ]
        )
        exits = self.tracer.allocate_exits(int(work[:, 2].sum()))
        followed = self.tracer.trace(work, [level for _, level, *_ in job], exits)
        if followed.lost:
            raise RuntimeError(followed.lost)
        parts = np.split(exits, np.cumsum(work[:, 2])[:-1])
        return [
            (self._score_item(piece, part, notes), int(cost))
            for piece, part, notes, cost in zip(
                job, parts, followed.crossings, followed.n_segments, strict=True
            )
        ]

    def _score_item(self, item: WorkItem, exits: np.ndarray, crossings: np.ndarray) -> list[Any]:
        """Return what a piece's ensemble makes of each of its batches, in order."""
        ensemble, level, first, count = item
        starts = np.arange(count) * self.rays_per_chunk
        parts = np.split(crossings, np.searchsorted(crossings[:, CROSSING_RAY], starts[1:]))
        sums = []
        for start, batch, part in zip(
            starts, exits.reshape(count, self.rays_per_chunk, -1), parts, strict=True
        ):
            part[:, CROSSING_RAY] -= start
            sums.append(ensemble.score_chunk(level, first + int(start), batch, part))
        return sums

    def _report_progress(
        self, n_rays: int, stderr: float, target: float, seconds_left: float
    ) -> None:
        now = time.perf_counter()
        if self.progress_callback and now - self._last_report_time > 0.5:
            self._last_report_time = now
            self.progress_callback(
                Progress(n_rays, stderr, target, now - self.start_time, seconds_left)
            )
