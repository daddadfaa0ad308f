"""Retrieval by runs of its own: descents with derivatives from the same paths, and no table.

Where a medium is looked at once, a table of it would cost more than it tells.  Spectra with their
derivatives (`splits.instruments.jacobian`, `splits.instruments.differences`) lead to the most
probable medium by Gauss-Newton steps; all runs share their random numbers, so that they differ by
the medium only.  Around the end light is taken as linear in the coordinates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.parameters import INCIDENCE, with_value
from splits.media.turbid import Medium
from splits.retrieval.coordinates import LEVEL, Free
from splits.retrieval.estimation import APART, RIVAL
from splits.retrieval.forward import Operator
from splits.retrieval.measurement import Measurement

SURVEY = 16
"""Media looked at first."""
STARTS = 2
"""Descents, from the nearest of these."""
STEPS = 12
"""Of a descent at most."""
ROUGHLY = 0.01
"""Error of the runs of the survey and of descents, but for the last steps."""
NOISE_SHARE = 0.5
"""Error of the last runs, as a part of the least noise of the measurement."""
FINEST, COARSEST = 1e-3, 0.01
"""Errors of these, whatever the noise."""
SLOPES = 0.004
"""Least error of the runs that derivatives come from: they cost most, and need not be as exact."""
ENOUGH = 0.1
"""Step, in standard deviations, from which on a descent has ended."""
STEP_NM = 10.0
"""Between the wavelengths of a band."""


class Seen(NamedTuple):
    """A medium that was looked at.

    Attributes
    ----------
    place : float, shape (parameters,)
        Coordinates.
    values : float, shape (n,)
        What would be measured.
    slopes : float, shape (n, parameters)
    covariance : float, shape (n, n)
        Of the runs' noise.
    """

    place: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray


class Around:
    """A measurement as a straight line through one place has it; see `splits.retrieval.forward`."""

    def __init__(self, free: Free, seen: Seen) -> None:
        self.free, self.seen = free, seen

    def values(self, places: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        found: np.ndarray = self.seen.values + (places - self.seen.place) @ self.seen.slopes.T
        return found

    def with_slopes(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        return self.values(place[np.newaxis])[0], self.seen.slopes

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """Return the covariance of the runs' noise, shape (n, n)."""
        return self.seen.covariance

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where descents begin, and what would be measured there."""
        return self.seen.place[np.newaxis], self.seen.values[np.newaxis]


class OfRuns:
    """A measurement as runs have it.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    free : Free
        See `free_of`.
    incidence : float or "diffuse"
    error : float, optional
        Of a run; by default `NOISE_SHARE` of the least noise.
    seed : int
    threads : int, optional
    """

    def __init__(
        self,
        medium: Medium,
        measurement: Measurement,
        free: Free,
        incidence: float | str,
        error: float | None,
        seed: int,
        threads: int | None = None,
    ) -> None:
        self.medium, self.measurement, self.free = medium, measurement, free
        self.incidence, self.seed, self.threads = incidence, seed, threads
        least = float(np.sqrt(np.diag(measurement.covariance).min()))
        self.error = error or min(max(NOISE_SHARE * least, FINEST), COARSEST)
        self.wavelengths = wavelengths_of(measurement)
        self.operator = Operator.of(measurement, self.wavelengths).matrix
        self.axes = [name for name in free.names if name != LEVEL]
        self._rows = [free.names.index(name) for name in self.axes]
        self._level = free.names.index(LEVEL) if LEVEL in free.names else None
        self._known: dict[tuple[bytes, float], Seen] = {}

    def looked(self, place: np.ndarray, error: float, names: list[str]) -> Any:
        """Return a run at a place, its derivatives to some parameters, and the level there."""
        natural = self.free.at(place)
        medium, beam = self.medium, self.incidence
        for row, name in zip(self._rows, self.axes, strict=True):
            if name == INCIDENCE:
                beam = float(natural[row])
            else:
                medium = with_value(medium, name, float(natural[row]))
        found = spectrophotometer(
            medium, self.wavelengths, beam, error, self.seed, jacobian=names, threads=self.threads
        )
        return found, 1.0 if self._level is None else float(natural[self._level])

    def values(self, place: np.ndarray, error: float) -> np.ndarray:
        """Return what would be measured at a place, shape (n,)."""
        found, level = self.looked(place, error, [])
        values: np.ndarray = level * (self.operator @ found.reflectance.values)
        return values

    def seen(self, place: np.ndarray, error: float) -> Seen:
        """Return what would be measured at a place, with slopes; each is run once."""
        key = (place.tobytes(), error)
        if key not in self._known:
            slope_run, level = self.looked(place, max(error, SLOPES), self.axes)
            found = slope_run if error >= SLOPES else self.looked(place, error, [])[0]
            values = self.operator @ found.reflectance.values
            slopes = np.zeros((values.size, len(self.free.names)))
            per_unit = self._per_coordinate(place)
            for i, row in enumerate(self._rows):
                along = self.operator @ slope_run.reflectance_jacobian.values[i]
                slopes[:, row] = level * per_unit[row] * along
            if self._level is not None:
                slopes[:, self._level] = values * (self.free.high - self.free.low)[self._level]
            groups = level * found.reflectance_groups.values @ self.operator.T
            own = level * np.abs(self.operator) @ found.reflectance_stderr.values
            covariance = groups.T @ groups
            covariance += np.diag(np.maximum(own**2 - np.diag(covariance), 0.0))
            self._known[key] = Seen(place, level * values, slopes, covariance)
        return self._known[key]

    def _per_coordinate(self, place: np.ndarray) -> np.ndarray:
        """Return how fast parameters change with their coordinates."""
        step = 1e-6
        low, high = np.clip(place - step, 0.0, 1.0), np.clip(place + step, 0.0, 1.0)
        rate: np.ndarray = (self.free.at(high) - self.free.at(low)) / (high - low)
        return rate

    def _downhill(self, seen: Seen) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the sum of squares at a place, the way downhill, and the curvature."""
        free = self.free
        inverse = np.linalg.inv(self.measurement.covariance + seen.covariance)
        off = self.measurement.values - seen.values
        pull = (free.prior_mean - seen.place) * free.precision
        cost = float(off @ inverse @ off + ((free.prior_mean - seen.place) * pull).sum())
        way = seen.slopes.T @ inverse @ off + pull
        bend = seen.slopes.T @ inverse @ seen.slopes + np.diag(free.precision)
        return cost, way, bend

    def descend(self, start: np.ndarray, error: float) -> tuple[float, Seen]:
        """Return the sum of squares and the place at which a descent ends (Levenberg-Marquardt)."""
        best = self.seen(np.clip(start, 1e-3, 1.0 - 1e-3), error)
        cost, way, bend = self._downhill(best)
        damping = 1e-2
        for _ in range(STEPS):
            # Along what light does not depend on, no step is larger than the range.
            scale = np.diag(damping * np.diag(bend) + 1e-3)
            inside = ~(((best.place < 2e-3) & (way < 0.0)) | ((best.place > 0.998) & (way > 0.0)))
            step = np.zeros_like(way)
            step[inside] = np.linalg.solve((bend + scale)[np.ix_(inside, inside)], way[inside])
            place = np.clip(best.place + np.clip(step, -0.4, 0.4), 1e-3, 1.0 - 1e-3)
            spread = 1.0 / np.sqrt(np.diag(bend) + 1.0 / self.free.prior_variance)
            if (np.abs(place - best.place) < ENOUGH * spread).all():
                break
            other = self.seen(place, error)
            lower, *more = self._downhill(other)
            if lower < cost:
                best, cost, (way, bend), damping = other, lower, more, 0.2 * damping
            else:
                damping *= 8.0
        return cost, best

    def settled(self) -> tuple[Around, list[Seen]]:
        """Return a straight line through the best end of several descents, and other good ends."""
        from scipy.stats import qmc

        free = self.free
        places = qmc.Sobol(len(free.names), seed=self.seed).random(SURVEY)
        known = np.isfinite(free.prior_sd)
        places[:, known] = free.prior_mean[known] + (places[:, known] - 0.5) * free.prior_sd[known]
        places = np.clip(places, 0.02, 0.98)
        rough = max(ROUGHLY, self.error)
        off = np.array([self.values(p, rough) for p in places]) - self.measurement.values
        spread = np.sqrt(np.diag(self.measurement.covariance))
        misfit = ((off / spread) ** 2).sum(axis=1)
        starts: list[np.ndarray] = []
        for row in np.argsort(misfit, kind="stable"):
            if len(starts) < STARTS and all(np.abs(places[row] - s).max() > 0.2 for s in starts):
                starts.append(places[row])
        ends = sorted((self.descend(s, rough) for s in starts), key=lambda end: end[0])
        # Ends of rough descents that are as good as the best may be one and the same in the end.
        good = [seen.place for cost, seen in ends if cost < ends[0][0] + RIVAL]
        ends = sorted((self.descend(s, self.error) for s in good), key=lambda end: end[0])
        least, last = ends[0]
        rivals = [
            seen for cost, seen in ends[1:]
            if cost < least + RIVAL and np.abs(seen.place - last.place).max() > APART
        ]  # fmt: skip
        return Around(free, last), rivals

    def bent(self, around: Around, place: np.ndarray, covariance: np.ndarray) -> float:
        """Return how far light is off a straight line, a standard deviation away, in its noise.

        Parameters
        ----------
        around : Around
        place : float, shape (parameters,)
            The most probable one.
        covariance : float, shape (parameters, parameters)
            Of coordinates, after; the widest way is looked along.
        """
        sizes, ways = np.linalg.eigh(covariance)
        noise = np.linalg.cholesky(self.measurement.covariance + around.seen.covariance)
        most = 0.0
        for sign in (-1.0, 1.0):
            there = np.clip(place + sign * np.sqrt(sizes[-1]) * ways[:, -1], 1e-3, 1.0 - 1e-3)
            off = self.values(there, self.error) - around.values(there[np.newaxis])[0]
            most = max(most, float(np.linalg.norm(np.linalg.solve(noise, off))))
        return most


def wavelengths_of(measurement: Measurement) -> np.ndarray:
    """Return the wavelengths (nm) to run: those measured, or some across all bands."""
    if not measurement.bands:
        return np.unique(measurement.wavelength_nm)
    ends = np.array([band.ends for band in measurement.bands.values()])
    low, high = float(ends.min()), float(ends.max())
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / STEP_NM)))
