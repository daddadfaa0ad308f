"""Ensembles of paths: batches on threads, sums of weights, means and their variances."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from splits.media.granular import GranularMedium
from splits.transport.granular import batch
from splits.transport.scene import Grains, Optics, Rules, Slab

BATCH = 128
"""Rays per batch: the grain of parallel work."""

LEVELS = (-1.0, 0.002, 0.01, 0.06)
"""Absorption over one mean distance between grains from which wavelengths have rays of their own.
Visible light needs few rays and long paths, the near infrared many rays and short paths."""

Tally = tuple[np.ndarray, np.ndarray, int, bool]
"""What a batch returns: moments, least weight, legs, whether a ray was lost."""


@dataclass
class Level:
    """Rays of an ensemble that serve the wavelengths of at least some absorption.

    The first level serves all and must follow every path to its end; the others may end paths
    early, by roulette, because the wavelengths that need long paths do not listen.

    Attributes
    ----------
    number : int
        Names the random streams.
    optics : Optics
    served : bool, shape (wavelengths,)
    rays, legs : int
        Traced so far.
    """

    number: int
    optics: Optics
    served: np.ndarray
    rays: int = 0
    legs: int = 0


class Ensemble:
    """Paths traced with one set of refractive indices.

    Parameters
    ----------
    number : int
        Names the random streams.
    index : complex, shape (materials,)
    absorption : float, shape (wavelengths, materials)
        Absorption coefficients of all wavelengths (1/m).
    served : bool, shape (wavelengths,)
        Wavelengths that draw on this ensemble.
    attenuation : float
        Grains met per metre.
    analog : bool
        Whether absorption is a coin toss, so that any ray might have been absorbed.
    levels : sequence of float
        Absorption from which wavelengths have rays of their own, at most as many as `LEVELS`; an
        analog ensemble has one level only.

    Attributes
    ----------
    levels : list of Level
    count : float, shape (wavelengths,)
        Rays that each wavelength listens to.
    moments : float, shape (2, 3, wavelengths)
        Over those, [reflected, transmitted][Σ weight, Σ weight², largest weight].
    least : float, shape (wavelengths,)
        Smallest weight with which any of them left; 0 once one was absorbed.
    """

    def __init__(
        self,
        number: int,
        index: np.ndarray,
        absorption: np.ndarray,
        served: np.ndarray,
        attenuation: float,
        analog: bool = False,
        levels: Sequence[float] = LEVELS,
    ) -> None:
        self.absorption = absorption
        self.analog = analog
        self.count = np.zeros(len(absorption))
        self.moments = np.zeros((2, 3, len(absorption)))
        self.least = np.full(len(absorption), np.inf)
        self.levels: list[Level] = []
        strength = absorption.max(axis=1) / attenuation
        for step, threshold in enumerate(levels[:1] if analog else levels):
            part = served & (strength >= threshold)
            if not part.any() or (self.levels and part.sum() == self.levels[-1].served.sum()):
                continue
            # Roulette may only use what holds for every wavelength that listens.
            optics = Optics(index.real.copy(), index.imag.copy(), absorption[part].min(axis=0))
            self.levels.append(Level(number * len(LEVELS) + step, optics, part))

    def add(self, level: Level, tally: Tally) -> None:
        """Add the tally of a batch."""
        moments, least, legs, _ = tally
        level.rays += BATCH
        level.legs += legs
        self.count[level.served] += BATCH
        self.moments[:, :2, level.served] += moments[:, :2]
        self.moments[:, 2, level.served] = np.maximum(
            self.moments[:, 2, level.served], moments[:, 2]
        )
        self.least[level.served] = np.minimum(self.least[level.served], least)

    def means(self) -> np.ndarray:
        """Return the mean weight, shape (2, wavelengths): reflected, transmitted."""
        return self.moments[:, 0] / np.maximum(self.count, 1.0)

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
        smallest[2] = np.where(tossed | (self.count == 0.0), 0.0, self.least)
        n = self.count + 2.0
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
        self,
        work: Sequence[tuple[Ensemble, Level, int]],
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
        jobs = [
            (ensemble, level, level.rays + i * BATCH)
            for ensemble, level, rays in work
            for i in range(-(-rays // BATCH))
        ]
        begun = time.perf_counter()

        def run(job: tuple[Ensemble, Level, int]) -> Tally:
            ensemble, level, first = job
            return batch(
                self.seed, level.number, first, BATCH, self.grains, self.slab, self.rules,
                level.optics, ensemble.absorption[level.served],
            )  # fmt: skip

        pool = ThreadPoolExecutor(self.threads)
        try:
            results = pool.map(run, jobs)
            for done, ((ensemble, level, _), tally) in enumerate(
                zip(jobs, results, strict=True), start=1
            ):
                if tally[3]:
                    raise RuntimeError(
                        "a ray found no grain that fits between the boundaries: the sample is "
                        "barely thicker than its grains, or the incidence too close to 90 degrees"
                    )
                ensemble.add(level, tally)
                pace = (time.perf_counter() - begun) / done
                self._tell(done * BATCH, stderr, target, pace * (len(jobs) - done + left / BATCH))
        finally:
            pool.shutdown(cancel_futures=True)

    def _tell(self, rays: int, stderr: float, target: float, left: float) -> None:
        now = time.perf_counter()
        if self.report and now - self._reported > 0.5:
            self._reported = now
            self.report(Progress(rays, stderr, target, now - self.started, left))
