"""Ensembles of paths: batches on threads, sums of weights, means and their variances."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from splits.checks import refuse
from splits.media.granular import GranularMedium
from splits.transport import granular, lanes
from splits.transport.lanes.choice import features_for
from splits.transport.lanes.rows import Features
from splits.transport.scene import Grains, Optics, Rules, Slab
from splits.transport.tally import exit_rows, tally

BATCH = {"scalar": 128, "lanes": 512}
"""Rays whose weights are added up together, by kernel: fixed, so that sums do not depend on who
adds them.  Lanes, of which some stand idle while the last rays end, want more of them."""

JOB = 16
"""Largest number of batches that a thread traces at a time."""

KERNELS = ("auto", "lanes", "scalar")
"""What traces: lanes where they serve the scene, lanes or an error, or always the scalar kernel."""

LEVELS = (-1.0, 0.002, 0.01, 0.06)
"""Absorption over one mean distance between grains from which wavelengths have rays of their own.
Visible light needs few rays and long paths, the near infrared many rays and short paths."""

Tally = tuple[np.ndarray, np.ndarray, int]
"""What a batch yields: moments, least weight, rays."""


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
        moments, least, rays = tally
        level.rays += rays
        self.count[level.served] += rays
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
    kernel : {"auto", "lanes", "scalar"}
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
        kernel: str = "auto",
        report: Callable[[Progress], None] | None = None,
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
        jobs: list[tuple[Ensemble, Level, int, int]] = []
        for ensemble, level, rays in work:
            size = self.batch(level)
            batches = -(-rays // size)
            chunk = max(1, min(JOB, batches // (2 * self.threads)))
            for start in range(0, batches, chunk):
                count = min(chunk, batches - start)
                jobs.append((ensemble, level, level.rays + start * size, count))
        begun = time.perf_counter()
        total = sum(count * self.batch(level) for _, level, _, count in jobs)
        done = 0
        pool = ThreadPoolExecutor(self.threads)
        try:
            results = pool.map(lambda job: self.tallies(*job), jobs)
            for (ensemble, level, *_), (tallies, legs) in zip(jobs, results, strict=True):
                for tally in tallies:
                    ensemble.add(level, tally)
                    done += tally[2]
                level.legs += legs
                pace = (time.perf_counter() - begun) / done
                self._tell(done, stderr, target, pace * (total - done + left))
        finally:
            pool.shutdown(cancel_futures=True)

    def features(self, optics: Optics) -> Features | None:
        """Return the lane kernel's features for a scene, or None for the scalar kernel.

        Raises
        ------
        ValueError
            If lanes are asked for and cannot serve the scene.
        """
        if self.kernel == "scalar":
            return None
        features = features_for(self.grains, self.slab, self.rules, optics)
        if features is None and self.kernel == "lanes":
            raise refuse(
                "kernel",
                "lanes",
                "'auto' or 'scalar' for this sample",
                "lanes know no coin-toss absorption, stacked coatings, or extreme inputs",
            )
        return features

    def kernels(self, ensembles: Sequence[Ensemble]) -> str:
        """Return which kernels trace these ensembles, joined by a comma."""
        used = {
            "scalar" if self.features(level.optics) is None else "lanes"
            for ensemble in ensembles
            for level in ensemble.levels
        }
        return ", ".join(sorted(used))

    def batch(self, level: Level) -> int:
        """Return the number of rays in each of a level's batches."""
        return BATCH["scalar" if self.features(level.optics) is None else "lanes"]

    def tallies(
        self, ensemble: Ensemble, level: Level, first: int, count: int
    ) -> tuple[list[Tally], int]:
        """Trace some batches of a level, from ray `first` on; the same numbers whoever does.

        Returns
        -------
        list of Tally
            One for each batch, in order.
        legs : int
            Legs traced.

        Raises
        ------
        RuntimeError
            If a ray found no grain that fits where it was.
        """
        size = self.batch(level)
        features = self.features(level.optics)
        absorption = ensemble.absorption[level.served]
        exits = exit_rows(count * size, absorption.shape[1])
        scene = (self.grains, self.slab, self.rules, level.optics, exits)
        if features is None:
            legs, lost = granular.batch(self.seed, level.number, first, len(exits), *scene)
        else:
            legs, lost = lanes.batch(self.seed, level.number, first, len(exits), *scene, features)
        if lost:
            raise RuntimeError(
                "a ray found no grain that fits between the boundaries: the sample is "
                "barely thicker than its grains, or the incidence too close to 90 degrees"
            )
        parts = exits.reshape(count, size, -1)
        weighted = not self.rules.analog
        return [(*tally(part, absorption, weighted), size) for part in parts], legs

    def _tell(self, rays: int, stderr: float, target: float, left: float) -> None:
        now = time.perf_counter()
        if self.report and now - self._reported > 0.5:
            self._reported = now
            self.report(Progress(rays, stderr, target, now - self.started, left))
