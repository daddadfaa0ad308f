"""A tally of given variances that traces without a kernel, for tests of the adaptive loop."""

import time

import numpy as np

from splits.simulation.spectral_nodes import make_separate_nodes
from splits.simulation.strata import Evaluation, Stratum
from splits.simulation.tally import RAYS_PER_CHUNK, Tally

SEGMENTS = (100, 10, 1)
"""Segments of a ray by stratum."""


class StubTally(Tally):
    """Tally of independent rows, one of each stratum, with given variances per ray.

    Scores of chunks are random, and a ray has a given number of segments by stratum.

    Parameters
    ----------
    variances : sequence of float
    rays_per_round : int
    lost_ray : int, optional
        Ray of the first stratum that is lost.
    delay_s : float
        Time of a job (s) is 0, 1 or 2 times this, so that jobs end in another order.

    Attributes
    ----------
    sums : float, shape (strata,)
    rounds : list of int, shape (strata,)
        Rays of each stratum after each round.
    """

    def __init__(self, variances, rays_per_round=RAYS_PER_CHUNK, lost_ray=None, delay_s=0.0):
        self.lost_ray, self.delay_s = lost_ray, delay_s
        self.variances, self.rays_per_round = np.array(variances), rays_per_round
        self.pilot_rays = rays_per_round
        n_rows = len(variances)
        super().__init__(make_separate_nodes(np.ones((n_rows, 1)) + 0j), np.zeros((n_rows, 1)))
        self.strata = [
            Stratum(row, None, self.select_node(row), np.zeros((1, 1))) for row in range(n_rows)
        ]
        self.sums, self.rounds = np.zeros(n_rows), []

    def trace_job(self, seed, scene, job):
        (_, rays), *_ = job
        time.sleep(self.delay_s * (2 - rays.start // self.rays_per_chunk % 3))
        return super().trace_job(seed, scene, job)

    def trace_chunk(self, seed, scene, stratum, first_ray):
        if stratum.stream == 0 and self.lost_ray in range(first_ray, first_ray + RAYS_PER_CHUNK):
            raise RuntimeError("a ray was lost")
        score = first_ray, np.random.default_rng((seed, stratum.stream, first_ray)).random()
        return score, self.rays_per_chunk * SEGMENTS[stratum.stream]

    def merge(self, stratum, score):
        first, value = score
        assert first == stratum.n_rays
        self.sums[stratum.node_rows] += value

    def evaluate(self, stop):
        self.rounds.append(self.stratum_rays)
        error = float(np.sqrt((self.variances / self.stratum_rays).max()))
        return Evaluation(error, self.sums.tolist())

    def allocate_rays(self, stop, evaluation):
        return self.variances / stop.max_error**2
