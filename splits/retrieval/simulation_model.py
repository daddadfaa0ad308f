"""Retrieval by runs of its own: descents with derivatives from the same paths, and no table.

Where a medium is looked at once, a table of it would cost more than it tells.  Spectra with their
derivatives (`splits.simulation.derivatives`, `splits.simulation.finite_differences`) lead to the
most probable medium (`splits.retrieval.gauss_newton`).  Around the end light is taken as linear in
the coordinates.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np

from splits.core.optional import import_optional
from splits.core.progress import Progress, ProgressCallback
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, replace_parameter
from splits.retrieval.forward_model import MeasurementOperator
from splits.retrieval.gauss_newton import DescentStage, LocalMinimum, Objective, search_minima
from splits.retrieval.linearization import (
    BOUND_MARGIN,
    Linearization,
    is_jacobian_noisy,
    remove_jacobian_noise,
)
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import ALTERNATIVE_CHI2, MIN_SEPARATION
from splits.retrieval.state_vector import SCALE, StateVector

N_SURVEY = 16
"""Media looked at first."""
DESCENT_STAGES = (DescentStage(2, 60), DescentStage(2, 60, ALTERNATIVE_CHI2))
"""Descents: from the nearest of these, and those of runs with the last error."""
LAST_STAGE = len(DESCENT_STAGES)
SURVEY_STDERR = 0.01
"""Error of the runs of the survey and of the first descents."""
NOISE_FRACTION = 0.5
"""Error of the last runs, as a part of the least noise of the measurement."""
MIN_STDERR, MAX_STDERR = 1e-3, 0.01
"""Errors of these, whatever the noise."""
UNKNOWN_NOISE_MAX_STDERR = 2e-3
"""Error of these where noise is not known."""
MIN_JACOBIAN_STDERR = 0.004
"""Least error of the runs that derivatives come from, of which there are several."""
N_JACOBIANS_RANGE = (2, 6)
"""Independent ones behind errors: at least, and at most where their noise may decide."""
BAND_STEP_NM = 10.0
"""Between the wavelengths of a band."""


class ConvergedRuns(NamedTuple):
    """Where descents have ended.

    Attributes
    ----------
    minima : list of End
        Best first, all of them apart.
    modelled : float, shape (n,)
        What would be measured at the best.
    noise_covariance : float, shape (n, n)
        Covariance of the runs' noise.
    jacobians : list of float, shape (n, parameters)
        Independent ones there.
    """

    minima: list[LocalMinimum]
    modelled: np.ndarray
    noise_covariance: np.ndarray
    jacobians: list[np.ndarray]

    def linearize(self, measurement_covariance: np.ndarray) -> Linearization:
        """Return the best end, with slopes for measurements of some noise."""
        slopes = remove_jacobian_noise(
            self.jacobians, measurement_covariance + self.noise_covariance
        )
        return Linearization(self.minima[0].state, self.modelled, slopes, self.noise_covariance)

    def find_alternatives(self, max_increase: float) -> tuple[np.ndarray, ...]:
        """Return the other ends whose sums of squares are not so much larger."""
        best, *others = self.minima
        return tuple(end.state for end in others if end.cost < best.cost + max_increase)


class SimulationForwardModel:
    """A measurement as runs have it; see `splits.retrieval.gauss_newton.StagedForwardModel`.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    state_vector : StateVector
        See `splits.retrieval.media.free_of`.
    incidence : float or "diffuse"
    max_stderr : float, optional
        Of the last runs; by default `NOISE_FRACTION` of the least noise.
    seed : int
    progress : callable, optional
    """

    bound_margin = BOUND_MARGIN

    def __init__(
        self,
        medium: Medium,
        measurement: Measurement,
        state_vector: StateVector,
        incidence: float | str,
        max_stderr: float | None,
        seed: int,
        progress: ProgressCallback = None,
    ) -> None:
        self.medium, self.measurement, self.state_vector = medium, measurement, state_vector
        self.incidence, self.seed = incidence, seed
        least = float(np.sqrt(np.diag(measurement.covariance).min()))
        usual = (
            min(max(NOISE_FRACTION * least, MIN_STDERR), MAX_STDERR)
            if measurement.noise_known
            else UNKNOWN_NOISE_MAX_STDERR
        )
        self.max_stderr = max_stderr or usual
        self.wavelengths = select_simulation_wavelengths(measurement)
        self.operator = MeasurementOperator.from_measurement(measurement, self.wavelengths).matrix
        self.axes = [name for name in state_vector.names if name != SCALE]
        self._axis_indices = [state_vector.names.index(name) for name in self.axes]
        self._scale_index = state_vector.names.index(SCALE) if SCALE in state_vector.names else None
        self._cache: dict[tuple[bytes, int], tuple[np.ndarray, np.ndarray]] = {}
        self._progress = ProgressTracker(progress, self.max_stderr, len(state_vector.names))

    def get_stage_stderr(self, stage: int) -> float:
        """Return the error of the runs of a stage, the last of which is exact."""
        return self.max_stderr if stage == LAST_STAGE else max(SURVEY_STDERR, self.max_stderr)

    def simulate(
        self, state: np.ndarray, max_stderr: float, names: list[str], seed: int
    ) -> tuple[Any, float]:
        """Return a run at a place, its derivatives to some parameters, and the level there."""
        natural = self.state_vector.to_physical(state)
        medium, beam = self.medium, self.incidence
        for row, name in zip(self._axis_indices, self.axes, strict=True):
            if name == INCIDENCE_KEY:
                beam = float(natural[row])
            else:
                medium = replace_parameter(medium, name, float(natural[row]))
        found = spectrophotometer(
            medium, self.wavelengths, beam, max_stderr, seed, jacobian=names,
            progress=self._progress.track_run(max_stderr, _count_runs(len(names))),
        )  # fmt: skip
        return found, 1.0 if self._scale_index is None else float(natural[self._scale_index])

    def evaluate_with_covariance(
        self, state: np.ndarray, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and the covariance of the runs' noise."""
        key = (state.tobytes(), stage)
        if key not in self._cache:
            found, level = self.simulate(state, self.get_stage_stderr(stage), [], self.seed)
            values = level * (self.operator @ found.reflectance.values)
            groups = level * found.reflectance_batches.values @ self.operator.T
            own = level * np.abs(self.operator) @ found.reflectance_stderr.values
            covariance = groups.T @ groups
            covariance += np.diag(np.maximum(own**2 - np.diag(covariance), 0.0))
            self._cache[key] = values, covariance
        return self._cache[key]

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return what would be measured, shape (n,)."""
        return self.evaluate_with_covariance(state, stage)[0]

    def evaluate_last_stage(self, state: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (n,), as exactly as runs say it."""
        return self.evaluate(state, LAST_STAGE)

    def compute_jacobian(
        self, state: np.ndarray, stage: int, seed: int | None = None
    ) -> np.ndarray:
        """Return its derivatives to the coordinates, shape (n, parameters)."""
        error = max(self.get_stage_stderr(stage), MIN_JACOBIAN_STDERR)
        found, level = self.simulate(state, error, self.axes, self.seed if seed is None else seed)
        slopes = np.zeros((len(self.operator), len(self.state_vector.names)))
        per_unit = self._compute_coordinate_derivatives(state)
        for i, row in enumerate(self._axis_indices):
            along = self.operator @ found.reflectance_jacobian.values[i]
            slopes[:, row] = level * per_unit[row] * along
        if self._scale_index is not None:
            values = self.operator @ found.reflectance.values
            slopes[:, self._scale_index] = (
                values * (self.state_vector.high - self.state_vector.low)[self._scale_index]
            )
        return slopes

    def _compute_coordinate_derivatives(self, state: np.ndarray) -> np.ndarray:
        """Return how fast parameters change with their coordinates."""
        step = 1e-6
        low, high = np.clip(state - step, 0.0, 1.0), np.clip(state + step, 0.0, 1.0)
        rate: np.ndarray = (
            self.state_vector.to_physical(high) - self.state_vector.to_physical(low)
        ) / (high - low)
        return rate

    def _make_objective(self, state: np.ndarray, stage: int) -> Objective:
        """Return what counts near a place: noise of the measurement, and of the runs."""
        if not self.measurement.noise_known:
            return Objective.least_squares(self.measurement.values, self.state_vector)
        covariance = self.measurement.covariance + self.evaluate_with_covariance(state, stage)[1]
        return Objective(self.measurement.values, np.linalg.cholesky(covariance), self.state_vector)

    def find_minima(self) -> ConvergedRuns:
        """Return where the descents end, and Jacobians at the best."""
        qmc = import_optional("scipy.stats", "retrieval", "retrievals need").qmc

        free = self.state_vector
        places = qmc.Sobol(len(free.names), seed=self.seed).random(N_SURVEY)
        known = np.isfinite(free.prior_sd)
        places[:, known] = free.prior_mean[known] + (places[:, known] - 0.5) * free.prior_sd[known]
        best, *others = search_minima(
            self, self._make_objective, np.clip(places, 0.02, 0.98), DESCENT_STAGES
        )[-1]
        ends = [best] + [
            end for end in others if np.abs(end.state - best.state).max() > MIN_SEPARATION
        ]
        values, own = self.evaluate_with_covariance(best.state, LAST_STAGE)
        least, most = N_JACOBIANS_RANGE
        jacobians = [
            self.compute_jacobian(best.state, LAST_STAGE, self.seed + 1 + n) for n in range(least)
        ]
        while self.measurement.noise_known and len(jacobians) < most:
            if not is_jacobian_noisy(jacobians, self.measurement.covariance + own):
                break
            seed = self.seed + 1 + len(jacobians)
            jacobians.append(self.compute_jacobian(best.state, LAST_STAGE, seed))
        return ConvergedRuns(ends, values, own, jacobians)


class ProgressTracker:
    """How far a retrieval has got, as far as the runs so far tell.

    Parameters
    ----------
    report : callable, optional
    max_stderr : float
        Of the last runs.
    parameters : int
    """

    def __init__(self, report: ProgressCallback, max_stderr: float, n_parameters: int) -> None:
        self.report, self.max_stderr = report, max_stderr
        fine, slopes = (
            _estimate_cost(max_stderr),
            _count_runs(n_parameters) * _estimate_cost(max(max_stderr, MIN_JACOBIAN_STDERR)),
        )
        # Each descent takes slopes about twice, then a few steps; last ones mostly begin at the
        # end.  Then come Jacobians, and runs that tell how far light is off a straight line.
        rough = N_SURVEY + DESCENT_STAGES[0].n_starts * 2 * (2 + _count_runs(n_parameters))
        last = DESCENT_STAGES[1].n_starts * (4 * fine + slopes)
        self.total_cost = (
            rough + last + float(np.mean(N_JACOBIANS_RANGE)) * slopes + 2 * n_parameters * fine
        )
        self.spent_cost, self.start_time = 0.0, time.perf_counter()

    def track_run(self, max_stderr: float, n_runs: int) -> ProgressCallback:
        """Return what receives the progress of so many runs of an error."""
        if not callable(self.report):
            return None
        cost, before, report = n_runs * _estimate_cost(max_stderr), self.spent_cost, self.report
        self.spent_cost += cost

        def show(one: Progress) -> None:
            spent = time.perf_counter() - self.start_time
            done = before + one.fraction_done * cost
            left = (
                max(self.total_cost - done, 0.0) * spent / done if done > 0.0 else one.seconds_left
            )
            report(
                Progress(one.rays, one.stderr, self.max_stderr, spent, max(left, one.seconds_left))
            )

        return show


def _count_runs(n_parameters: int) -> int:
    """Return how many runs a spectrum and its derivatives take, at most as a rule."""
    return 1 + 5 * n_parameters


def _estimate_cost(max_stderr: float) -> float:
    """Return what a run of an error costs, in rough ones."""
    return (SURVEY_STDERR / max_stderr) ** 2


def select_simulation_wavelengths(measurement: Measurement) -> np.ndarray:
    """Return the wavelengths (nm) to run: those measured, or some across all bands."""
    if not measurement.bands:
        return np.unique(measurement.wavelength_nm)
    ends = np.array([band.limits_nm for band in measurement.bands.values()])
    low, high = float(ends.min()), float(ends.max())
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / BAND_STEP_NM)))
