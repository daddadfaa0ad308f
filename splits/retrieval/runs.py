"""Retrieval by runs of its own: descents with derivatives from the same paths, and no table.

Where a medium is looked at once, a table of it would cost more than it tells.  Spectra with their
derivatives (`splits.instruments.jacobian`, `splits.instruments.differences`) lead to the most
probable medium (`splits.retrieval.search`).  Around the end light is taken as linear in the
coordinates.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np

from splits.extras import optional
from splits.instruments.progress import Progress, Report
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.parameters import INCIDENCE, with_value
from splits.media.turbid import Medium
from splits.retrieval.coordinates import LEVEL, Free
from splits.retrieval.estimation import APART, RIVAL
from splits.retrieval.forward import Operator
from splits.retrieval.line import MARGIN, Seen, doubtful, without_noise
from splits.retrieval.measurement import Measurement
from splits.retrieval.search import Aim, End, Stage, search

SURVEY = 16
"""Media looked at first."""
STAGES = (Stage(2, 60), Stage(2, 60, RIVAL))
"""Descents: from the nearest of these, and those of runs with the last error."""
LAST = len(STAGES)
ROUGHLY = 0.01
"""Error of the runs of the survey and of the first descents."""
NOISE_SHARE = 0.5
"""Error of the last runs, as a part of the least noise of the measurement."""
FINEST, COARSEST = 1e-3, 0.01
"""Errors of these, whatever the noise."""
PLAIN = 2e-3
"""Error of these where noise is not known."""
SLOPES = 0.004
"""Least error of the runs that derivatives come from, of which there are several."""
JACOBIANS = (2, 6)
"""Independent ones behind errors: at least, and at most where their noise may decide."""
STEP_NM = 10.0
"""Between the wavelengths of a band."""


class Settled(NamedTuple):
    """Where descents have ended.

    Attributes
    ----------
    ends : list of End
        Best first, all of them apart.
    values : float, shape (n,)
        What would be measured at the best.
    own : float, shape (n, n)
        Covariance of the runs' noise.
    jacobians : list of float, shape (n, parameters)
        Independent ones there.
    """

    ends: list[End]
    values: np.ndarray
    own: np.ndarray
    jacobians: list[np.ndarray]

    def seen(self, noise: np.ndarray) -> Seen:
        """Return the best end, with slopes for measurements of some noise."""
        slopes = without_noise(self.jacobians, noise + self.own)
        return Seen(self.ends[0].place, self.values, slopes, self.own)

    def rivals(self, within: float) -> tuple[np.ndarray, ...]:
        """Return the other ends whose sums of squares are not so much larger."""
        best, *others = self.ends
        return tuple(end.place for end in others if end.cost < best.cost + within)


class OfRuns:
    """A measurement as runs have it; see `splits.retrieval.search.Runs`.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    free : Free
        See `splits.retrieval.media.free_of`.
    incidence : float or "diffuse"
    error : float, optional
        Of the last runs; by default `NOISE_SHARE` of the least noise.
    seed : int
    progress : callable, optional
    """

    margin = MARGIN

    def __init__(
        self,
        medium: Medium,
        measurement: Measurement,
        free: Free,
        incidence: float | str,
        error: float | None,
        seed: int,
        progress: Report = None,
    ) -> None:
        self.medium, self.measurement, self.free = medium, measurement, free
        self.incidence, self.seed = incidence, seed
        least = float(np.sqrt(np.diag(measurement.covariance).min()))
        usual = min(max(NOISE_SHARE * least, FINEST), COARSEST) if measurement.told else PLAIN
        self.error = error or usual
        self.wavelengths = wavelengths_of(measurement)
        self.operator = Operator.of(measurement, self.wavelengths).matrix
        self.axes = [name for name in free.names if name != LEVEL]
        self._rows = [free.names.index(name) for name in self.axes]
        self._level = free.names.index(LEVEL) if LEVEL in free.names else None
        self._known: dict[tuple[bytes, int], tuple[np.ndarray, np.ndarray]] = {}
        self._way = Way(progress, self.error, len(free.names))

    def error_of(self, stage: int) -> float:
        """Return the error of the runs of a stage, the last of which is exact."""
        return self.error if stage == LAST else max(ROUGHLY, self.error)

    def looked(
        self, place: np.ndarray, error: float, names: list[str], seed: int
    ) -> tuple[Any, float]:
        """Return a run at a place, its derivatives to some parameters, and the level there."""
        natural = self.free.at(place)
        medium, beam = self.medium, self.incidence
        for row, name in zip(self._rows, self.axes, strict=True):
            if name == INCIDENCE:
                beam = float(natural[row])
            else:
                medium = with_value(medium, name, float(natural[row]))
        found = spectrophotometer(
            medium, self.wavelengths, beam, error, seed, jacobian=names,
            progress=self._way.run(error, _runs(len(names))),
        )  # fmt: skip
        return found, 1.0 if self._level is None else float(natural[self._level])

    def noisy(self, place: np.ndarray, stage: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and the covariance of the runs' noise."""
        key = (place.tobytes(), stage)
        if key not in self._known:
            found, level = self.looked(place, self.error_of(stage), [], self.seed)
            values = level * (self.operator @ found.reflectance.values)
            groups = level * found.reflectance_groups.values @ self.operator.T
            own = level * np.abs(self.operator) @ found.reflectance_stderr.values
            covariance = groups.T @ groups
            covariance += np.diag(np.maximum(own**2 - np.diag(covariance), 0.0))
            self._known[key] = values, covariance
        return self._known[key]

    def values(self, place: np.ndarray, stage: int) -> np.ndarray:
        """Return what would be measured, shape (n,)."""
        return self.noisy(place, stage)[0]

    def last(self, place: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (n,), as exactly as runs say it."""
        return self.values(place, LAST)

    def slopes(self, place: np.ndarray, stage: int, seed: int | None = None) -> np.ndarray:
        """Return its derivatives to the coordinates, shape (n, parameters)."""
        error = max(self.error_of(stage), SLOPES)
        found, level = self.looked(place, error, self.axes, self.seed if seed is None else seed)
        slopes = np.zeros((len(self.operator), len(self.free.names)))
        per_unit = self._per_coordinate(place)
        for i, row in enumerate(self._rows):
            along = self.operator @ found.reflectance_jacobian.values[i]
            slopes[:, row] = level * per_unit[row] * along
        if self._level is not None:
            values = self.operator @ found.reflectance.values
            slopes[:, self._level] = values * (self.free.high - self.free.low)[self._level]
        return slopes

    def _per_coordinate(self, place: np.ndarray) -> np.ndarray:
        """Return how fast parameters change with their coordinates."""
        step = 1e-6
        low, high = np.clip(place - step, 0.0, 1.0), np.clip(place + step, 0.0, 1.0)
        rate: np.ndarray = (self.free.at(high) - self.free.at(low)) / (high - low)
        return rate

    def _aim(self, place: np.ndarray, stage: int) -> Aim:
        """Return what counts near a place: noise of the measurement, and of the runs."""
        if not self.measurement.told:
            return Aim.least_squares(self.measurement.values, self.free)
        covariance = self.measurement.covariance + self.noisy(place, stage)[1]
        return Aim(self.measurement.values, np.linalg.cholesky(covariance), self.free)

    def settled(self) -> Settled:
        """Return where the descents end, and Jacobians at the best."""
        qmc = optional("scipy.stats", "retrieval", "retrievals need").qmc

        free = self.free
        places = qmc.Sobol(len(free.names), seed=self.seed).random(SURVEY)
        known = np.isfinite(free.prior_sd)
        places[:, known] = free.prior_mean[known] + (places[:, known] - 0.5) * free.prior_sd[known]
        best, *others = search(self, self._aim, np.clip(places, 0.02, 0.98), STAGES)[-1]
        ends = [best] + [end for end in others if np.abs(end.place - best.place).max() > APART]
        values, own = self.noisy(best.place, LAST)
        least, most = JACOBIANS
        jacobians = [self.slopes(best.place, LAST, self.seed + 1 + n) for n in range(least)]
        while self.measurement.told and len(jacobians) < most:
            if not doubtful(jacobians, self.measurement.covariance + own):
                break
            seed = self.seed + 1 + len(jacobians)
            jacobians.append(self.slopes(best.place, LAST, seed))
        return Settled(ends, values, own, jacobians)


class Way:
    """How far a retrieval has got, as far as the runs so far tell.

    Parameters
    ----------
    report : callable, optional
    error : float
        Of the last runs.
    parameters : int
    """

    def __init__(self, report: Report, error: float, parameters: int) -> None:
        self.report, self.error = report, error
        fine, slopes = _cost(error), _runs(parameters) * _cost(max(error, SLOPES))
        # Each descent takes slopes about twice, then a few steps; last ones mostly begin at the
        # end.  Then come Jacobians, and runs that tell how far light is off a straight line.
        rough = SURVEY + STAGES[0].starts * 2 * (2 + _runs(parameters))
        last = STAGES[1].starts * (4 * fine + slopes)
        self.whole = rough + last + float(np.mean(JACOBIANS)) * slopes + 2 * parameters * fine
        self.done, self.begun = 0.0, time.perf_counter()

    def run(self, error: float, runs: int) -> Report:
        """Return what receives the progress of so many runs of an error."""
        if not callable(self.report):
            return None
        cost, before, report = runs * _cost(error), self.done, self.report
        self.done += cost

        def show(one: Progress) -> None:
            spent = time.perf_counter() - self.begun
            done = before + one.share * cost
            left = max(self.whole - done, 0.0) * spent / done if done > 0.0 else one.seconds_left
            report(Progress(one.rays, one.stderr, self.error, spent, max(left, one.seconds_left)))

        return show


def _runs(parameters: int) -> int:
    """Return how many runs a spectrum and its derivatives take, at most as a rule."""
    return 1 + 5 * parameters


def _cost(error: float) -> float:
    """Return what a run of an error costs, in rough ones."""
    return (ROUGHLY / error) ** 2


def wavelengths_of(measurement: Measurement) -> np.ndarray:
    """Return the wavelengths (nm) to run: those measured, or some across all bands."""
    if not measurement.bands:
        return np.unique(measurement.wavelength_nm)
    ends = np.array([band.ends for band in measurement.bands.values()])
    low, high = float(ends.min()), float(ends.max())
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / STEP_NM)))
