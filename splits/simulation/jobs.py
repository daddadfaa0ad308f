"""Division of rays into jobs for threads; results do not depend on the division."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.features import Features
from splits.simulation.tally import Stratum, Tally
from splits.simulation.tracer_interface import Tracer

MAX_JOB_BYTES = 2**27
MAX_SEGMENTS_PER_JOB = 2e7
"""Largest memory (bytes) of a thread's job, and its largest number of segments with the vectorized
kernel, so that progress is reported every few seconds; an eighth of it with the scalar kernel.
Larger jobs are more efficient, as lanes are idle while the last rays of a job end."""


class WorkItem(NamedTuple):
    """Successive rays of a stratum, a multiple of the rays of a chunk."""

    stratum: Stratum
    first_ray: int
    n_rays: int


def estimate_cost(stratum: Stratum) -> float:
    """Return the expected segments of a ray, plus one; a default at first."""
    if stratum.n_rays == 0:
        return 1.0 + stratum.expected_segments
    return 1.0 + stratum.n_segments / stratum.n_rays


def make_jobs(
    tracer: Tracer, tally: Tally, new_rays: np.ndarray, threads: int
) -> list[list[WorkItem]]:
    """Return jobs for threads: strata of one kernel, divided at equal costs.

    Parameters
    ----------
    tracer : Tracer
    tally : Tally
    new_rays : int, shape (strata,)
        Rays to add to each stratum, rounded up to whole chunks.
    threads : int
    """
    size = tally.rays_per_chunk
    by_kernel: dict[Features | None, list[WorkItem]] = {}
    for stratum, n_rays in zip(tally.strata, new_rays.tolist(), strict=True):
        if n_rays > 0:
            item = WorkItem(stratum, stratum.n_rays, -(-n_rays // size) * size)
            by_kernel.setdefault(stratum.features, []).append(item)
    values_per_chunk = size * tracer.n_exit_columns + tally.count_score_values()
    max_rays = max(1, MAX_JOB_BYTES // (8 * values_per_chunk)) * size
    jobs = []
    for features, items in by_kernel.items():
        # Short paths last, so that few lanes are idle while the last long path ends.
        items.sort(key=lambda item: -item.stratum.expected_segments)
        n_rays = sum(item.n_rays for item in items)
        cost = sum(estimate_cost(item.stratum) * item.n_rays for item in items)
        max_segments = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
        # A multiple of the threads, so that all have the same load.
        n_jobs = int(np.ceil(max(cost / max_segments, n_rays / max_rays) / threads)) * threads
        n_jobs = min(n_jobs, n_rays // size)
        jobs += split_jobs(items, n_jobs, cost / n_jobs, max_rays, size)
    return jobs


def split_jobs(
    items: Sequence[WorkItem], n_jobs: int, cost_per_job: float, max_rays: int, chunk_size: int
) -> list[list[WorkItem]]:
    """Return the items divided among a number of jobs of about equal cost, in order.

    There are more jobs where one would hold more than `max_rays` rays.
    """
    jobs: list[list[WorkItem]] = [[]]
    remaining_cost, n_rays = cost_per_job, 0
    for stratum, first, count in items:
        cost = estimate_cost(stratum) * chunk_size
        while count > 0:
            if n_rays == max_rays or (
                jobs[-1] and remaining_cost < 0.5 * cost and len(jobs) < n_jobs
            ):
                jobs.append([])
                remaining_cost, n_rays = cost_per_job + min(remaining_cost, 0.5 * cost), 0
            n_added = min(count, max_rays - n_rays)
            if len(jobs) < n_jobs:
                n_added = min(n_added, max(1, round(remaining_cost / cost)) * chunk_size)
            jobs[-1].append(WorkItem(stratum, first, n_added))
            first += n_added
            count -= n_added
            remaining_cost -= n_added / chunk_size * cost
            n_rays += n_added
    return jobs
