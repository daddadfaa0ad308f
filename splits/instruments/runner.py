"""Tracing rays: batches, in jobs, on threads, and the same numbers whoever traces which."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from splits.checks import refuse
from splits.instruments.ensemble import Level, Paths
from splits.media.granular import GranularMedium
from splits.transport import granular, lanes
from splits.transport.lanes.choice import features_for
from splits.transport.lanes.rows import Features
from splits.transport.scene import Grains, Optics, Rules, Slab
from splits.transport.tally import exit_rows

BATCH = 128
"""Rays whose weights are added up together: fixed, so that sums do not depend on who adds them."""

MEMORY = 2**26
LEGS = 2e7
"""Largest memory (bytes) that a thread's job takes, and number of legs on lanes, for signs of life
every few seconds; of the scalar kernel's, an eighth.  Otherwise the more the
better: lanes stand idle while the last rays of a job end."""

KERNELS = ("auto", "lanes", "scalar")
"""What traces: lanes where they serve the scene, lanes or an error, or always the scalar kernel."""

Piece = tuple[Paths, Level, int, int]
"""Some batches of a level: ensemble, level, first ray, number of batches."""


@dataclass(frozen=True)
class Progress:
    """What a running simulation has reached."""

    rays: int
    stderr: float
    target: float
    seconds: float
    seconds_left: float


class Runner:
    """Traces rays of a medium on several threads, the same whatever their number.

    Parameters
    ----------
    medium : GranularMedium
    incidence_deg : float or "diffuse"
    seed : int
    threads : int or None
        None takes every CPU this process may use.
    analog : bool
        Absorption by coin toss.
    kernel : {"auto", "lanes", "scalar"}
    report : callable, optional
        Receives a `Progress` a few times per second at most.
    positions, orders : bool
        Whether exits are to tell where a ray left and how many grains it had met.
    """

    def __init__(
        self,
        medium: GranularMedium,
        incidence_deg: float | str,
        seed: int,
        threads: int | None,
        analog: bool,
        kernel: str = "auto",
        report: Callable[[Progress], None] | None = None,
        *,
        positions: bool = False,
        orders: bool = False,
    ) -> None:
        diffuse = incidence_deg == "diffuse"
        cosine = 1.0 if diffuse else float(np.cos(np.radians(float(incidence_deg))))
        self.seed = seed
        self.grains: Grains = medium.grains()
        self.slab = Slab(float(medium.depth_m), float(medium.saturation), cosine, diffuse)
        self.rules: Rules = medium.readings.rules(analog)
        self.threads = threads or len(os.sched_getaffinity(0))
        self.kernel = kernel
        self.report = report
        self.positions = positions
        self.orders = orders
        self.started = time.perf_counter()
        self._reported = 0.0
        self._features: dict[Level, Features | None] = {}

    def trace(
        self,
        work: Sequence[tuple[Paths, Level, int]],
        stderr: float,
        target: float,
        left: float = 0.0,
    ) -> None:
        """Trace so many more rays of each level and add them up in a fixed order.

        Parameters
        ----------
        work : sequence of (Ensemble, Level, int)
            Rays to add, rounded up to whole batches.
        stderr, target, left : float
            What to report as reached, wanted, and still to do after this (in rays).

        Raises
        ------
        RuntimeError
            If a ray found no grain that fits where it was.
        """
        jobs = self.jobs(work)
        begun = time.perf_counter()
        costs = [sum(self.cost(level) * count for _, level, _, count in job) for job in jobs]
        rays = BATCH * sum(count for job in jobs for *_, count in job)
        total = sum(costs) * (1.0 + left / rays)
        done = 0.0
        pool = ThreadPoolExecutor(self.threads)
        try:
            found = pool.map(self.tallies, jobs)
            for job, cost, tallied in zip(jobs, costs, found, strict=True):
                for (ensemble, level, *_), (tallies, legs) in zip(job, tallied, strict=True):
                    ensemble.add(level, tallies)
                    level.legs += legs
                done += cost
                pace = (time.perf_counter() - begun) / done
                self._tell(rays, stderr, target, pace * (total - done))
        finally:
            pool.shutdown(cancel_futures=True)

    def jobs(self, work: Sequence[tuple[Paths, Level, int]]) -> list[list[Piece]]:
        """Return what threads are to trace at a time: levels of one kernel, cut at equal costs."""
        kinds: dict[Features | None, list[Piece]] = {}
        for ensemble, level, rays in work:
            piece = ensemble, level, level.rays, -(-rays // BATCH)
            kinds.setdefault(self.features(level), []).append(piece)
        jobs = []
        for features, pieces in kinds.items():
            # Short paths last, so that few lanes wait for the last long one.
            pieces.sort(key=lambda piece: -piece[1].guess)
            batches = sum(count for *_, count in pieces)
            cost = sum(self.cost(level) * count for _, level, _, count in pieces)
            most = LEGS if features else LEGS / 8
            held = min(self.held(ensemble) for ensemble, *_ in pieces)
            # A multiple of the threads, so that all have as much to do.
            number = int(np.ceil(max(cost / most, batches / held) / self.threads)) * self.threads
            number = min(number, batches)
            jobs += self.cut(pieces, number, cost / number, held)
        return jobs

    def held(self, ensemble: Paths) -> int:
        """Return how many batches a job may hold: exits of their rays, and tallies."""
        materials = ensemble.absorption.shape[1]
        numbers = BATCH * exit_rows(1, materials).shape[1] + ensemble.size()
        return max(1, MEMORY // (8 * numbers))

    def cut(
        self, pieces: Sequence[Piece], number: int, share: float, most: int
    ) -> list[list[Piece]]:
        """Return pieces in a number of jobs that cost about a share each, in order.

        There are more of them where one would hold more than `most` batches.
        """
        jobs: list[list[Piece]] = [[]]
        room, held = share, 0
        for ensemble, level, first, count in pieces:
            cost = self.cost(level)
            while count > 0:
                if held == most or (jobs[-1] and room < 0.5 * cost and len(jobs) < number):
                    jobs.append([])
                    room, held = share + min(room, 0.5 * cost), 0
                now = min(count, most - held)
                if len(jobs) < number:
                    now = min(now, max(1, round(room / cost)))
                jobs[-1].append((ensemble, level, first, now))
                first += now * BATCH
                count -= now
                room -= now * cost
                held += now
        return jobs

    def cost(self, level: Level) -> float:
        """Return the legs to expect of a batch, and one to launch each ray; at first, a guess."""
        if level.rays == 0:
            return BATCH * (1.0 + level.guess)
        return BATCH * (1.0 + level.legs / level.rays)

    def prepare(self, ensembles: Sequence[Paths]) -> None:
        """Let all levels of these ensembles share a kernel, if that is all that parts them.

        Reflection with extinction also serves where extinction does not show, and rays of all
        levels then share the lanes.
        """
        levels = [level for ensemble in ensembles for level in ensemble.levels]
        found = [self.features(level) for level in levels]
        if any(one is not None and one.absorbing for one in found):
            for level, one in zip(levels, found, strict=True):
                if one is not None and not one.mixed:
                    self._features[level] = one._replace(absorbing=True)

    def features(self, level: Level) -> Features | None:
        """Return the lane kernel's features for a level, or None for the scalar kernel.

        Raises
        ------
        ValueError
            If lanes are asked for and cannot serve the scene.
        """
        if self.kernel == "scalar":
            return None
        if level not in self._features:
            self._features[level] = features_for(
                self.grains, self.slab, self.rules, level.optics, self.positions, self.orders
            )
        features = self._features[level]
        if features is None and self.kernel == "lanes":
            raise refuse(
                "kernel",
                "lanes",
                "'auto' or 'scalar' for this sample",
                "lanes know no coin-toss absorption, stacked coatings, or extreme inputs",
            )
        return features

    def kernels(self, ensembles: Sequence[Paths]) -> str:
        """Return which kernels trace these ensembles, joined by a comma."""
        used = {
            "scalar" if self.features(level) is None else "lanes"
            for ensemble in ensembles
            for level in ensemble.levels
        }
        return ", ".join(sorted(used))

    def tallies(self, job: Sequence[Piece]) -> list[tuple[list[Any], int]]:
        """Trace pieces that share a kernel; the same numbers whoever does, and in whatever job.

        Returns
        -------
        list of (list of tallies, int)
            For each piece: what its ensemble makes of each batch, in order, and the legs traced.

        Raises
        ------
        RuntimeError
            If a ray found no grain that fits where it was.
        """
        features = self.features(job[0][1])
        work = np.array(
            [(level.number, first, count * BATCH, level.most) for _, level, first, count in job]
        )
        scene = (self.grains, self.slab, self.rules)
        exits = exit_rows(int(work[:, 2].sum()), job[0][1].optics.n.size)
        ends = np.cumsum(work[:, 2])
        parts = np.split(exits, ends[:-1])
        if features is None:
            results = [
                granular.batch(self.seed, item, *scene, level.optics, part)
                for item, part, (_, level, _, _) in zip(work, parts, job, strict=True)
            ]
            legs, lost = np.array([one[0] for one in results]), any(one[1] for one in results)
        else:
            each = zip(*(level.optics for _, level, *_ in job), strict=True)
            optics = Optics(*map(np.stack, each))
            legs, lost = lanes.batch(self.seed, work, *scene, optics, exits, features)
        if lost:
            raise RuntimeError(
                "a ray found no grain that fits between the boundaries: the sample is "
                "barely thicker than its grains, or the incidence too close to 90 degrees"
            )
        tallied = []
        for (ensemble, level, first, count), part, cost in zip(job, parts, legs, strict=True):
            batches = part.reshape(count, BATCH, -1)
            sums = [
                ensemble.tally(level, first + number * BATCH, batch)
                for number, batch in enumerate(batches)
            ]
            tallied.append((sums, int(cost)))
        return tallied

    def _tell(self, rays: int, stderr: float, target: float, left: float) -> None:
        now = time.perf_counter()
        if self.report and now - self._reported > 0.5:
            self._reported = now
            self.report(Progress(rays, stderr, target, now - self.started, left))
