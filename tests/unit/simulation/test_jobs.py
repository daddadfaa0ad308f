"""Division of rays into jobs of equal cost."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.kernels.scene import ALL_FEATURES
from splits.simulation.engine import (
    MAX_JOB_BYTES,
    MAX_SEGMENTS_PER_JOB,
    estimate_cost,
    make_jobs,
)
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import SpectralRows
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.spectral_tally import SpectralTally
from splits.simulation.tally import RAYS_PER_CHUNK

SCENE = build_scene(splits.Snow(depth_m=0.02), 0.0, False)


def make_tally(segments_per_ray):
    """Return a tally of three strata with given mean numbers of segments."""
    absorption = np.repeat([[0.0], [9.0], [99.0]], 3, axis=1)
    index = np.ones((3, 3)) + 0j
    rows = SpectralRows(index, absorption, absorption, np.zeros((0, 3, 3)), ())
    nodes = IndexNodes(index[:1], np.ones((1, 3)), np.zeros(3))
    tally = SpectralTally(rows, nodes, SCENE)
    assert len(tally.strata) == 3
    for stratum, n_segments in zip(tally.strata, segments_per_ray, strict=True):
        stratum.n_rays, stratum.n_segments = RAYS_PER_CHUNK, RAYS_PER_CHUNK * n_segments
    return tally


def divide(tally, chunks, threads):
    """Return the jobs for given numbers of chunks of the strata."""
    return make_jobs(SCENE, tally, RAYS_PER_CHUNK * np.array(chunks), threads)


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
@pytest.mark.parametrize("chunks", [(1, 1, 1), (40, 30, 1000), (5, 30_000, 0)])
def test_jobs_contain_every_chunk_once_and_in_order(threads, chunks):
    tally = make_tally((1000, 100, 10))
    jobs = divide(tally, chunks, threads)
    for stratum, count in zip(tally.strata, chunks, strict=True):
        firsts = [
            first
            for job in jobs
            for item_stratum, rays in job
            for first in rays[::RAYS_PER_CHUNK]
            if item_stratum is stratum
        ]
        n_rays = count * RAYS_PER_CHUNK
        assert firsts == list(range(stratum.n_rays, stratum.n_rays + n_rays, RAYS_PER_CHUNK))
    assert all(rays and len(rays) % RAYS_PER_CHUNK == 0 for job in jobs for _, rays in job)
    bytes_per_chunk = 8 * (
        RAYS_PER_CHUNK * tally.count_ray_values(SCENE) + tally.count_score_values()
    )
    n_chunks = [sum(len(rays) for _, rays in job) // RAYS_PER_CHUNK for job in jobs]
    assert max(n_chunks) * bytes_per_chunk <= MAX_JOB_BYTES


def test_rays_are_rounded_up_to_whole_chunks():
    tally = make_tally((10, 10, 10))
    items = [item for job in make_jobs(SCENE, tally, np.array([1, 0, 129]), 1) for item in job]
    assert [(tally.strata.index(one), len(rays)) for one, rays in items] == [(0, 128), (2, 256)]


@pytest.mark.parametrize("features", [None, ALL_FEATURES])
def test_jobs_have_similar_cost(features):
    tally = make_tally((1000, 100, 10))
    for stratum in tally.strata:
        stratum.features = features
    jobs = divide(tally, (100, 500, 2000), 4)
    costs = [sum(len(rays) * estimate_cost(one) for one, rays in job) for job in jobs]
    max_segments = MAX_SEGMENTS_PER_JOB if features else MAX_SEGMENTS_PER_JOB / 8
    assert max(costs) <= 1.2 * np.mean(costs) and max(costs) <= 1.1 * max_segments
    assert len(jobs) % 4 == 0


def test_jobs_use_one_kernel():
    tally = make_tally((1000, 100, 10))
    tally.strata[1].features = ALL_FEATURES
    jobs = divide(tally, (100, 500, 2000), 4)
    kernels = [{stratum.features for stratum, _ in job} for job in jobs]
    assert all(len(one) == 1 for one in kernels)
    assert {ALL_FEATURES} in kernels and {None} in kernels


@pytest.mark.parametrize("threads, chunks", [(2, 3), (8, 11), (16, 38), (64, 80), (64, 95)])
def test_chunks_are_divided_evenly_over_jobs(threads, chunks):
    jobs = divide(make_tally((10, 10, 10)), (chunks, 0, 0), threads)
    sizes = [sum(len(rays) for _, rays in job) // RAYS_PER_CHUNK for job in jobs]
    assert sum(sizes) == chunks and max(sizes) <= -(-chunks // threads) + 1
