"""Ensembles of paths: batches on threads, sums of weights, means and their variances."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from splits.media.granular import GranularMedium
from splits.transport.granular import batch
from splits.transport.scene import Grains, Optics, Rules, Slab

BATCH = 128
"""Rays per batch: the grain of parallel work."""


@dataclass
class Ensemble:
    """Paths traced with one set of refractive indices.

    Attributes
    ----------
    number : int
        Names the random streams.
    optics : Optics
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients of the wavelengths served (1/m).
    analog : bool
        Whether absorption is a coin toss, so that any ray might have been absorbed.
    rays : int
        Rays traced so far.
    moments : float, shape (2, 3, wavelengths)
        Over rays, [reflected, transmitted][Σ weight, Σ weight², largest weight].
    least : float, shape (wavelengths,)
        Smallest weight with which any ray left; 0 once one was absorbed.
    """

    number: int
    optics: Optics
    absorption: np.ndarray
    analog: bool = False
    rays: int = 0
    moments: np.ndarray = field(init=False)
    least: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.least = np.full(len(self.absorption), np.inf)
        self.moments = np.zeros((2, 3, len(self.absorption)))

    def add(self, rays: int, moments: np.ndarray, least: np.ndarray) -> None:
        """Add the tally of a batch."""
        np.minimum(self.least, least, out=self.least)
        self.rays += rays
        self.moments[:, :2] += moments[:, :2]
        np.maximum(self.moments[:, 2], moments[:, 2], out=self.moments[:, 2])

    def means(self) -> np.ndarray:
        """Return the mean weight, shape (2, wavelengths): reflected, transmitted."""
        return self.moments[:, 0] / self.rays

    def variances(self) -> np.ndarray:
        """Return the variance per ray of reflected, transmitted and absorbed weight, (3, …).

        A ray leaves on one side only, so the squares of reflected + transmitted add up.  Two
        rays are added, of the largest and of the smallest weight possible by what was seen (after
        Agresti & Coull 1998): few or no arrivals then do not look like certainty.
        """
        total, square, largest = self.moments[:, 0], self.moments[:, 1], self.moments[:, 2]
        total = np.concatenate([total, total.sum(axis=0, keepdims=True)])
        square = np.concatenate([square, square.sum(axis=0, keepdims=True)])
        largest = np.concatenate([largest, largest.max(axis=0, keepdims=True)])
        largest = np.where(largest == 0.0, 1.0, largest)
        smallest = np.zeros_like(largest)
        tossed = self.analog & (self.absorption.max(axis=1) > 0.0)
        smallest[2] = np.where(tossed, 0.0, self.least)
        n = self.rays + 2
        mean = (total + largest + smallest) / n
        return np.maximum((square + largest**2 + smallest**2) / n - mean**2, 0.0)


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
    report : callable, optional
        Receives a `Progress` a few times per second at most.
    """

    def __init__(
        self,
        medium: GranularMedium,
        incidence_deg: float | str,
        seed: int,
        threads: int | None,
        analog: bool,
        report: Callable[[Progress], None] | None = None,
    ) -> None:
        diffuse = incidence_deg == "diffuse"
        cosine = 1.0 if diffuse else float(np.cos(np.radians(float(incidence_deg))))
        self.seed = seed
        self.grains: Grains = medium.grains()
        self.slab = Slab(float(medium.depth_m), float(medium.saturation), cosine, diffuse)
        self.rules: Rules = medium.readings.rules(analog)
        self.threads = threads or len(os.sched_getaffinity(0))
        self.report = report
        self.started = time.perf_counter()
        self._reported = 0.0

    def trace(
        self, work: Sequence[tuple[Ensemble, int]], stderr: float, target: float, left: float = 0.0
    ) -> None:
        """Trace so many more rays of each ensemble and add them up in a fixed order.

        Parameters
        ----------
        work : sequence of (Ensemble, int)
            Rays to add, rounded up to whole batches.
        stderr, target, left : float
            What to report as reached, wanted, and still to do after this (in rays).

        Raises
        ------
        RuntimeError
            If a ray found no grain that fits where it was.
        """
        jobs = [
            (ensemble, ensemble.rays + i * BATCH)
            for ensemble, rays in work
            for i in range(-(-rays // BATCH))
        ]
        begun = time.perf_counter()

        def run(job: tuple[Ensemble, int]) -> tuple[np.ndarray, np.ndarray, bool]:
            ensemble, first = job
            return batch(
                self.seed, ensemble.number, first, BATCH, self.grains, self.slab, self.rules,
                ensemble.optics, ensemble.absorption,
            )  # fmt: skip

        pool = ThreadPoolExecutor(self.threads)
        try:
            results = pool.map(run, jobs)
            for done, ((ensemble, _), (moments, least, lost)) in enumerate(
                zip(jobs, results, strict=True), start=1
            ):
                if lost:
                    raise RuntimeError(
                        "a ray found no grain that fits between the boundaries: the sample is "
                        "barely thicker than its grains, or the incidence too close to 90 degrees"
                    )
                ensemble.add(BATCH, moments, least)
                pace = (time.perf_counter() - begun) / done
                self._tell(done * BATCH, stderr, target, pace * (len(jobs) - done + left / BATCH))
        finally:
            pool.shutdown(cancel_futures=True)

    def _tell(self, rays: int, stderr: float, target: float, left: float) -> None:
        now = time.perf_counter()
        if self.report and now - self._reported > 0.5:
            self._reported = now
            self.report(Progress(rays, stderr, target, now - self.started, left))
