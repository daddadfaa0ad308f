"""The adaptive loop: rounds of rays on several threads, until a stopping rule is satisfied."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from splits.core.progress import Progress, ProgressCallback
from splits.simulation.jobs import estimate_cost, make_jobs
from splits.simulation.run_options import RunOptions
from splits.simulation.tally import Outcome, StoppingRule, Tally
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads
from splits.simulation.tracer_interface import Tracer

MAX_ROUND_GROWTH = 8.0
"""Largest ratio of the rays of a stratum after a round and before it."""
MIN_REPORT_INTERVAL_S = 0.5


def simulate(tracer: Tracer, tally: Tally, stop: StoppingRule, run: RunOptions) -> Outcome:
    """Trace rounds of rays and merge their scores, until a stopping rule is satisfied.

    Parameters
    ----------
    tracer : Tracer
        Traces rays of a scene.
    tally : Tally
        Receives the scores.
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
    strata = tally.strata
    tracer.select_kernel(strata, run.kernel, tally.shares_kernel)
    report = ProgressReport(run.progress, stop.max_error)
    new_rays, remaining_rays = tally.plan_first_round(stop), 0.0
    with DaemonThreadPool(run.threads) as pool:
        while True:
            jobs = make_jobs(tracer, tally, new_rays, run.threads)
            costs = [sum(estimate_cost(item.stratum) * item.n_rays for item in job) for job in jobs]
            report.begin_round(int(new_rays.sum()), sum(costs), remaining_rays)
            traced = pool.map(partial(tracer.trace_job, run.seed, tally), jobs)
            for job, cost, results in zip(jobs, costs, traced, strict=True):
                for item, (scores, n_segments) in zip(job, results, strict=True):
                    # In a fixed order, so that sums do not depend on the threads.
                    for score in scores:
                        tally.merge(item.stratum, score)
                        item.stratum.n_rays += tally.rays_per_chunk
                    item.stratum.n_segments += n_segments
                report.advance(cost)
            with limit_blas_threads():
                report.error, stop_reason = tally.evaluate(stop)
                if stop_reason or tally.n_rays >= stop.max_rays:
                    break
                target_rays = tally.allocate_rays(stop)
            new_rays = limit_round(tally, target_rays, stop.max_rays)
            remaining_rays = float((target_rays - tally.stratum_rays - new_rays).clip(0).sum())
    kernels = {"scalar" if one.features is None else "vectorized" for one in strata}
    return Outcome(
        report.error, stop_reason or "max_rays", tally.n_rays, ", ".join(sorted(kernels))
    )


def limit_round(tally: Tally, target_rays: np.ndarray, max_rays: int) -> np.ndarray:
    """Return the rays of the next round by stratum: those required, within the limits.

    Parameters
    ----------
    tally : Tally
    target_rays : float, shape (strata,)
        Rays that would satisfy the stopping rule.
    max_rays : int
        Largest number of all rays.
    """
    n_rays = tally.stratum_rays
    step = np.clip(target_rays - n_rays, 0.0, (MAX_ROUND_GROWTH - 1.0) * n_rays)
    step *= min(1.0, (max_rays - n_rays.sum()) / step.sum())
    # However few rays are left, the stratum that needs most gets some.
    step[step < min(1.0, step.max())] = 0.0
    return np.ceil(step / tally.rays_per_round).astype(np.int64) * tally.rays_per_round


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
        self.target, self.error = target, 1.0
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
