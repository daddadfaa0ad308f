"""Distribution of rays over jobs of equal cost, and near the end of a run."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.simulation.runner import MAX_SEGMENTS_PER_JOB, RAYS_PER_CHUNK, Runner
from splits.simulation.tally import PathTally, TransportTraits

WAVELENGTHS = [500.0, 1000.0, 1500.0]
SNOW = splits.Snow(depth_m=0.02)


def make_runner(threads, segments_per_ray=None):
    """Return a runner and an ensemble of three strata with given mean numbers of segments."""
    runner = Runner(SNOW, 0.0, 1, threads, False, "scalar")
    ensemble = PathTally(
        0, np.ones(3) + 0j, np.array([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0], [99.0, 99.0, 99.0]]),
        np.ones(3, dtype=bool), TransportTraits(1e3),
    )  # fmt: skip
    assert len(ensemble.strata) == 3
    for stratum, n_segments in zip(ensemble.strata, segments_per_ray or (), strict=False):
        stratum.n_rays, stratum.n_segments = RAYS_PER_CHUNK, RAYS_PER_CHUNK * n_segments
    return runner, ensemble


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
@pytest.mark.parametrize("batches", [(1, 1, 1), (40, 30, 1000), (5, 30_000, 0)])
def test_jobs_contain_every_batch_once_and_in_order(threads, batches):
    runner, ensemble = make_runner(threads, (1000, 100, 10))
    work = [
        (ensemble, stratum, count * RAYS_PER_CHUNK)
        for stratum, count in zip(ensemble.strata, batches, strict=True)
        if count
    ]
    jobs = runner.make_jobs(work)
    for _, stratum, rays in work:
        firsts = [
            first + RAYS_PER_CHUNK * batch
            for job in jobs
            for _, job_stratum, first, count in job
            for batch in range(count)
            if job_stratum is stratum
        ]
        assert firsts == list(range(stratum.n_rays, stratum.n_rays + rays, RAYS_PER_CHUNK))
    capacity = runner.compute_job_capacity(ensemble)
    assert all(sum(count for *_, count in job) <= capacity for job in jobs)


def test_jobs_have_similar_cost():
    runner, ensemble = make_runner(4, (1000, 100, 10))
    counts = (100, 500, 2000)
    work = zip(ensemble.strata, counts, strict=True)
    jobs = runner.make_jobs(
        [(ensemble, stratum, count * RAYS_PER_CHUNK) for stratum, count in work]
    )
    costs = [
        sum(count * runner.estimate_cost(stratum) for _, stratum, _, count in job) for job in jobs
    ]
    assert max(costs) <= 1.2 * np.mean(costs) and max(costs) <= 1.1 * MAX_SEGMENTS_PER_JOB
    assert len(jobs) % 4 == 0


@pytest.mark.parametrize("threads, batches", [(2, 3), (8, 11), (16, 38), (64, 80), (64, 95)])
def test_batches_are_divided_evenly_over_jobs(threads, batches):
    runner, ensemble = make_runner(threads, (10, 10, 10))
    jobs = runner.make_jobs([(ensemble, ensemble.strata[0], batches * RAYS_PER_CHUNK)])
    sizes = [sum(count for *_, count in job) for job in jobs]
    assert sum(sizes) == batches and max(sizes) <= -(-batches // threads) + 1


@NEEDS_JIT
@pytest.mark.parametrize("extra_rays", [1, 2 * RAYS_PER_CHUNK, 11 * RAYS_PER_CHUNK])
def test_a_run_stops_at_the_maximum_of_rays(extra_rays):
    first_round = splits.spectrophotometer(SNOW, WAVELENGTHS, max_rays=1).attrs["rays"]
    max_rays = first_round + extra_rays
    run = splits.spectrophotometer(SNOW, WAVELENGTHS, max_stderr=1e-5, max_rays=max_rays)
    assert run.attrs["stop_reason"] == "max_rays"
    # Strata trace whole batches: at most one batch more than requested in each of them.
    assert max_rays <= run.attrs["rays"] < max_rays + first_round
    assert np.isfinite(run.reflectance).all()


@NEEDS_JIT
def test_rays_are_allocated_to_strata_that_need_them():
    # Close to the end, a converged stratum must not grow while another one lacks a few rays.
    rays = [
        splits.spectrophotometer(SNOW, [450.0, 1030.0, 1600.0], max_stderr=0.01, seed=seed).attrs[
            "rays"
        ]
        for seed in range(60)
    ]
    assert max(rays) < 3.0 * np.median(rays)
