"""The adaptive loop: rounds of rays on several threads, until a stopping rule is satisfied."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from splits.core.progress import Progress, ProgressCallback
from splits.kernels.scene import Features, Scene
from splits.simulation.run_options import RunOptions
from splits.simulation.strata import Evaluation, StoppingRule, Stratum
from splits.simulation.tally import Tally, WorkItem
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads

MAX_JOB_BYTES = 2**27
MAX_SEGMENTS_PER_JOB = 2e7
"""Largest memory (bytes) of a thread's job, and its largest number of segments with the vectorized
kernel, so that progress is reported every few seconds; an eighth of it with the scalar kernel.
Larger jobs are more efficient, as lanes are idle while the last rays of a job end."""
MIN_ROUND_GROWTH, MAX_ROUND_GROWTH = 1.25, 8.0
"""Limits of the ratio of the rays of a stratum after a round and before it, if it needs more."""
MIN_REPORT_INTERVAL_S = 0.5


def simulate(scene: Scene, tally: Tally, stop: StoppingRule, run: RunOptions) -> Evaluation:
    """Trace rounds of rays and merge their scores, until a stopping rule is satisfied.

    Parameters
    ----------
    scene : Scene
    tally : Tally
        Traces rays and adds up their scores.
    stop : StoppingRule
    run : RunOptions
        Seed, threads, kernel and progress.  Results do not depend on the threads.

    Raises
    ------
    ValueError
        If the vectorized kernel is requested and does not support the scene.
    RuntimeError
        If a ray was lost.
    """
    tally.select_kernel(scene, run.kernel)
    report = ProgressReport(run.progress, stop.max_error)
    new_rays, remaining_rays, stop_reason = tally.plan_first_round(stop), 0.0, ""
    with DaemonThreadPool(run.threads) as pool:
        while not stop_reason:
            jobs = make_jobs(scene, tally, new_rays, run.threads)
            costs = [sum(estimate_cost(one) * len(rays) for one, rays in job) for job in jobs]
            report.begin_round(int(new_rays.sum()), sum(costs), remaining_rays)
            traced = pool.map(partial(tally.trace_job, run.seed, scene), jobs)
            for job, cost, results in zip(jobs, costs, traced, strict=True):
                for (stratum, _), (scores, n_segments) in zip(job, results, strict=True):
                    # In a fixed order, so that sums do not depend on the threads.
                    for score in scores:
                        tally.merge(stratum, score)
                        stratum.n_rays += tally.rays_per_chunk
                    stratum.n_segments += n_segments
                report.advance(cost)
            with limit_blas_threads():
                evaluation = tally.evaluate(stop)
                stop_reason = stop.find_reason(evaluation, tally.n_rays)
                if not stop_reason:
                    target_rays = tally.allocate_rays(stop, evaluation)
                    new_rays = limit_round(tally, target_rays, stop.max_rays)
                    last_ray = predict_rays(tally, stop, target_rays, evaluation.error)
                    remaining_rays = max(last_ray - tally.n_rays - int(new_rays.sum()), 0.0)
            report.error = evaluation.error
    return evaluation._replace(stop_reason=stop_reason)


def limit_round(tally: Tally, target_rays: np.ndarray, max_rays: int) -> np.ndarray:
    """Return the rays of the next round by stratum: those required, within the limits.

    Where no stratum needs more, all grow: the error is larger than their variances predict.

    Parameters
    ----------
    tally : Tally
    target_rays : float, shape (strata,)
        Rays that would satisfy the stopping rule.
    max_rays : int
        Largest number of all rays.
    """
    n_rays, size = tally.stratum_rays, tally.rays_per_round
    step = np.clip(target_rays - n_rays, 0.0, (MAX_ROUND_GROWTH - 1.0) * n_rays) / size
    if not step.any():
        step = (MIN_ROUND_GROWTH - 1.0) * n_rays / size
    rounds, budget = np.ceil(step), (max_rays - n_rays.sum()) / size
    if rounds.sum() > budget:
        # Fewer rays than needed, or than whole rounds: the largest remainders get the last ones.
        step *= min(1.0, budget / step.sum())
        rounds = np.floor(step)
        n_left = int(np.ceil(budget) - rounds.sum())
        rounds[np.argsort(rounds - step, kind="stable")[:n_left]] += 1.0
    return rounds.astype(np.int64) * size


def predict_rays(tally: Tally, stop: StoppingRule, target_rays: np.ndarray, error: float) -> float:
    """Return the number of rays at which a run will end: `max_rays`, or fewer for the error.

    Parameters
    ----------
    tally : Tally
    stop : StoppingRule
    target_rays : float, shape (strata,)
        Rays that would satisfy the stopping rule by the variances of the strata.
    error : float
        Error reached so far.
    """
    if stop.fixed:
        return stop.max_rays
    needed = float(np.maximum(target_rays, tally.stratum_rays).sum())
    if not needed > tally.n_rays:
        # The error is larger than the variances predict.
        needed = tally.n_rays * (error / stop.max_error) ** 2
    return min(needed, stop.max_rays)


def estimate_cost(stratum: Stratum) -> float:
    """Return the expected segments of a ray, plus one; a default at first."""
    if stratum.n_rays == 0:
        return 1.0 + stratum.expected_segments
    return 1.0 + stratum.n_segments / stratum.n_rays


def make_jobs(
    scene: Scene, tally: Tally, new_rays: np.ndarray, threads: int
) -> list[list[WorkItem]]:
    """Return jobs for threads: strata of one kernel, divided at equal costs.

    Parameters
    ----------
    scene : Scene
    tally : Tally
    new_rays : int, shape (strata,)
        Rays to add to each stratum, rounded up to whole chunks.
    threads : int
    """
    size = tally.rays_per_chunk
    by_kernel: dict[Features | None, list[WorkItem]] = {}
    for stratum, n_rays in zip(tally.strata, new_rays.tolist(), strict=True):
        if n_rays > 0:
            rays = range(stratum.n_rays, stratum.n_rays - n_rays // -size * size)
            by_kernel.setdefault(stratum.features, []).append((stratum, rays))
    values_per_chunk = size * tally.count_ray_values(scene) + tally.count_score_values()
    max_job_rays = max(1, MAX_JOB_BYTES // (8 * values_per_chunk)) * size
    jobs = []
    for features, items in by_kernel.items():
        # Short paths last, so that few lanes are idle while the last long path ends.
        items.sort(key=lambda item: -item[0].expected_segments)
        n_rays = sum(len(rays) for _, rays in items)
        cost = sum(estimate_cost(stratum) * len(rays) for stratum, rays in items)
        max_segments = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
        # A multiple of the threads, so that all have the same load.
        n_jobs = int(np.ceil(max(cost / max_segments, n_rays / max_job_rays) / threads)) * threads
        n_jobs = min(n_jobs, n_rays // size)
        jobs += split_jobs(items, n_jobs, cost / n_jobs, max_job_rays, size)
    return jobs


def split_jobs(
    items: Sequence[WorkItem], n_jobs: int, cost_per_job: float, max_job_rays: int, chunk_size: int
) -> list[list[WorkItem]]:
    """Return the items divided among a number of jobs of about equal cost, in order.

    There are more jobs where one would hold more than `max_job_rays` rays.
    """
    jobs: list[list[WorkItem]] = [[]]
    remaining_cost, n_rays = cost_per_job, 0
    for stratum, rays in items:
        cost = estimate_cost(stratum) * chunk_size
        while rays:
            if n_rays == max_job_rays or (
                jobs[-1] and remaining_cost < 0.5 * cost and len(jobs) < n_jobs
            ):
                jobs.append([])
                remaining_cost, n_rays = cost_per_job + min(remaining_cost, 0.5 * cost), 0
            n_added = min(len(rays), max_job_rays - n_rays)
            if len(jobs) < n_jobs:
                n_added = min(n_added, max(1, round(remaining_cost / cost)) * chunk_size)
            jobs[-1].append((stratum, rays[:n_added]))
            rays = rays[n_added:]
            remaining_cost -= n_added / chunk_size * cost
            n_rays += n_added
    return jobs


class ProgressReport:
    """Reports of the progress of a run, at most two per second.

    Parameters
    ----------
    callback : callable or None
        Receives a `Progress`.
    target : float
        Requested error.
    """

    def __init__(self, callback: ProgressCallback, target: float) -> None:
        self.callback = callback if callable(callback) else None
        self.target, self.error = target, np.inf
        self._start_time = self._round_start = time.perf_counter()
        self._last_report = 0.0

    def begin_round(self, n_rays: int, cost: float, remaining_rays: float) -> None:
        """Begin a round of rays of a cost, after which more rays remain."""
        self._n_rays, self._done = n_rays, 0.0
        self._total = cost * (1.0 + remaining_rays / n_rays)
        self._round_start = time.perf_counter()

    def advance(self, cost: float) -> None:
        """Report that a part of the round is done."""
        self._done += cost
        now = time.perf_counter()
        if self.callback and now - self._last_report > MIN_REPORT_INTERVAL_S:
            self._last_report = now
            left = (now - self._round_start) / self._done * (self._total - self._done)
            elapsed = now - self._start_time
            self.callback(Progress(self._n_rays, self.error, self.target, elapsed, left))
