"""Parallel tracing with results independent of the number of threads."""

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
from splits.simulation.tracer import SceneTracer

MAX_JOB_BYTES = 2**27
MAX_SEGMENTS_PER_JOB = 2e7
"""Largest memory (bytes) of a thread's job, and its largest number of segments with the vectorized
kernel, so that progress is reported every few seconds; an eighth of it with the scalar kernel.
Larger jobs are more efficient, as lanes are idle while the last rays of a job end."""

WorkItem = tuple[Tally, Stratum, int, int]
"""Some chunks of a stratum: tally, stratum, first ray, number of chunks."""


class Runner:
    """Runs tracing jobs on several threads, with the same results on any number of them.

    Parameters
    ----------
    medium : GranularMedium or ParticleMedium
    incidence_deg : float or "diffuse"
    seed : int
    threads : int or None
        None gives every CPU that this process may use.
    analog : bool
        Whether absorption is analog, sampled at each segment.
    kernel : {"auto", "vectorized", "scalar"}
    progress_callback : callable, optional
        Receives a `Progress` at most twice per second.
    planes_m : sequence of float
        Depths (m) of recording planes, see `splits.simulation.tracer.SceneTracer`.

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
        self.tracer = SceneTracer(medium, incidence_deg, seed, analog, kernel, planes_m)
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
        """Trace additional rays of each stratum and add their scores in a fixed order.

        Parameters
        ----------
        work : sequence of (Tally, Stratum, int)
            Rays to add, rounded up to whole chunks.
        stderr, target, remaining_rays : float
            Error reached, error requested and rays remaining after this call, for progress reports.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        jobs = self.make_jobs(work)
        start_time = time.perf_counter()
        costs = [
            sum(self.estimate_cost(stratum) * count for _, stratum, _, count in job) for job in jobs
        ]
        rays = self.rays_per_chunk * sum(count for job in jobs for *_, count in job)
        total = sum(costs) * (1.0 + remaining_rays / rays)
        done = 0.0
        with DaemonThreadPool(self.threads) as pool:
            results = pool.map(self.trace_job, jobs)
            for job, cost, job_scores in zip(jobs, costs, results, strict=True):
                for (tally, stratum, *_), (scores, n_segments) in zip(job, job_scores, strict=True):
                    tally.add_scores(stratum, scores)
                    stratum.n_segments += n_segments
                done += cost
                seconds_per_cost = (time.perf_counter() - start_time) / done
                self._report_progress(rays, stderr, target, seconds_per_cost * (total - done))

    def make_jobs(self, work: Sequence[tuple[Tally, Stratum, int]]) -> list[list[WorkItem]]:
        """Return jobs for threads: strata of one kernel, divided at equal costs."""
        by_kernel: dict[Features | None, list[WorkItem]] = {}
        for tally, stratum, rays in work:
            item = tally, stratum, stratum.n_rays, -(-rays // self.rays_per_chunk)
            by_kernel.setdefault(self.tracer.get_features(stratum), []).append(item)
        jobs = []
        for features, items in by_kernel.items():
            # Short paths last, so that few lanes are idle while the last long path ends.
            items.sort(key=lambda item: -item[1].expected_segments)
            n_chunks = sum(count for *_, count in items)
            cost = sum(self.estimate_cost(stratum) * count for _, stratum, _, count in items)
            max_segments = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
            max_chunks = min(self.compute_job_capacity(tally) for tally, *_ in items)
            # A multiple of the threads, so that all have the same load.
            n_jobs = (
                int(np.ceil(max(cost / max_segments, n_chunks / max_chunks) / self.threads))
                * self.threads
            )
            n_jobs = min(n_jobs, n_chunks)
            jobs += self.split_jobs(items, n_jobs, cost / n_jobs, max_chunks)
        return jobs

    def compute_job_capacity(self, tally: Tally) -> int:
        """Return the largest number of chunks of a job that fit into memory."""
        n_values = (
            self.rays_per_chunk * self.tracer.allocate_exits(1).shape[1]
            + tally.count_score_values()
        )
        return max(1, MAX_JOB_BYTES // (8 * n_values))

    def split_jobs(
        self, items: Sequence[WorkItem], n_jobs: int, cost_per_job: float, max_chunks: int
    ) -> list[list[WorkItem]]:
        """Return the items divided among a number of jobs of about equal cost, in order.

        There are more jobs where one would hold more than `max_chunks` chunks.
        """
        jobs: list[list[WorkItem]] = [[]]
        remaining_cost, n_chunks = cost_per_job, 0
        for tally, stratum, first, count in items:
            cost = self.estimate_cost(stratum)
            while count > 0:
                if n_chunks == max_chunks or (
                    jobs[-1] and remaining_cost < 0.5 * cost and len(jobs) < n_jobs
                ):
                    jobs.append([])
                    remaining_cost, n_chunks = cost_per_job + min(remaining_cost, 0.5 * cost), 0
                n_added = min(count, max_chunks - n_chunks)
                if len(jobs) < n_jobs:
                    n_added = min(n_added, max(1, round(remaining_cost / cost)))
                jobs[-1].append((tally, stratum, first, n_added))
                first += n_added * self.rays_per_chunk
                count -= n_added
                remaining_cost -= n_added * cost
                n_chunks += n_added
        return jobs

    def estimate_cost(self, stratum: Stratum) -> float:
        """Return the expected segments of a chunk, plus one per ray; a default at first."""
        if stratum.n_rays == 0:
            return self.rays_per_chunk * (1.0 + stratum.expected_segments)
        return self.rays_per_chunk * (1.0 + stratum.n_segments / stratum.n_rays)

    def share_kernel(self, tallies: Sequence[Tally]) -> None:
        """Let all strata of these tallies use one kernel, if possible."""
        self.tracer.share_kernel([stratum for tally in tallies for stratum in tally.strata])

    def format_kernels(self, tallies: Sequence[Tally]) -> str:
        """Return the kernels that trace these tallies, joined by a comma."""
        used = {
            "scalar" if self.tracer.get_features(stratum) is None else "vectorized"
            for tally in tallies
            for stratum in tally.strata
        }
        return ", ".join(sorted(used))

    def trace_job(self, job: Sequence[WorkItem]) -> list[tuple[list[Any], int]]:
        """Trace items of one kernel; results do not depend on threads or jobs.

        Returns
        -------
        list of (list of scores, int)
            For each item: the score of each chunk, in order, and the segments traced.

        Raises
        ------
        RuntimeError
            If a ray was lost.
        """
        work = np.array(
            [
                (stratum.stream, first, count * self.rays_per_chunk, stratum.max_order)
                for _, stratum, first, count in job
            ]
        )
        exits = self.tracer.allocate_exits(int(work[:, 2].sum()))
        result = self.tracer.trace(work, [stratum for _, stratum, *_ in job], exits)
        if result.lost:
            raise RuntimeError(result.lost)
        exits_by_item = np.split(exits, np.cumsum(work[:, 2])[:-1])
        return [
            (self._score_item(item, item_exits, crossings), int(n_segments))
            for item, item_exits, crossings, n_segments in zip(
                job, exits_by_item, result.crossings, result.n_segments, strict=True
            )
        ]

    def _score_item(self, item: WorkItem, exits: np.ndarray, crossings: np.ndarray) -> list[Any]:
        """Return the score of each chunk of an item, in order."""
        tally, stratum, first, count = item
        starts = np.arange(count) * self.rays_per_chunk
        crossings_by_chunk = np.split(
            crossings, np.searchsorted(crossings[:, CROSSING_RAY], starts[1:])
        )
        scores = []
        for start, chunk, chunk_crossings in zip(
            starts, exits.reshape(count, self.rays_per_chunk, -1), crossings_by_chunk, strict=True
        ):
            chunk_crossings[:, CROSSING_RAY] -= start
            scores.append(tally.score_chunk(stratum, first + int(start), chunk, chunk_crossings))
        return scores

    def _report_progress(
        self, n_rays: int, stderr: float, target: float, seconds_left: float
    ) -> None:
        now = time.perf_counter()
        if self.progress_callback and now - self._last_report_time > 0.5:
            self._last_report_time = now
            self.progress_callback(
                Progress(n_rays, stderr, target, now - self.start_time, seconds_left)
            )
