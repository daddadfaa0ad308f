"""Retrieval by simulation: descents with derivatives from the same paths, without a table.

For a single retrieval, a table of the medium would cost more.  Spectra with their derivatives
(`splits.simulation.derivatives`, `splits.simulation.finite_differences`) lead to the most probable
medium (`splits.retrieval.gauss_newton`).  Near the minimum, reflectance is assumed linear in the
coordinates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.core.optional import import_optional
from splits.core.progress import ProgressCallback
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, replace_parameter
from splits.retrieval.forward_model import MeasurementOperator
from splits.retrieval.gauss_newton import LocalMinimum, Objective, search_minima
from splits.retrieval.linearization import (
    BOUND_MARGIN,
    Linearization,
    is_jacobian_noisy,
    remove_jacobian_noise,
)
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import MIN_SEPARATION
from splits.retrieval.simulation_schedule import (
    DESCENT_STAGES,
    LAST_STAGE,
    MIN_JACOBIAN_STDERR,
    N_JACOBIANS_RANGE,
    N_SURVEY,
    SURVEY_STDERR,
    ProgressTracker,
    count_runs,
)
from splits.retrieval.state_vector import SCALE, StateVector

NOISE_FRACTION = 0.5
"""Ratio of the final standard error to the smallest noise of the measurement."""
MIN_STDERR, MAX_STDERR = 1e-3, 0.01
"""Limits of the final standard error."""
UNKNOWN_NOISE_MAX_STDERR = 2e-3
"""Final standard error for unknown noise."""
BAND_STEP_NM = 10.0
"""Step of wavelengths within bands (nm)."""


class ConvergedRuns(NamedTuple):
    """Minima of a retrieval, and independent Jacobians at the best one.

    Attributes
    ----------
    minima : list of LocalMinimum
        Separated minima, best first.
    modelled : float, shape (n,)
        Modelled measurement at the best minimum.
    noise_covariance : float, shape (n, n)
        Covariance of the noise of simulations.
    jacobians : list of float, shape (n, parameters)
        Independent Jacobians at the best minimum.
    """

    minima: list[LocalMinimum]
    modelled: np.ndarray
    noise_covariance: np.ndarray
    jacobians: list[np.ndarray]

    def linearize(self, measurement_covariance: np.ndarray) -> Linearization:
        """Return the linearization at the best minimum, with noise removed from its Jacobian."""
        slopes = remove_jacobian_noise(
            self.jacobians, measurement_covariance + self.noise_covariance
        )
        return Linearization(self.minima[0].state, self.modelled, slopes, self.noise_covariance)

    def find_alternatives(self, max_increase: float) -> tuple[np.ndarray, ...]:
        """Return the other minima whose cost exceeds the best by less than a limit."""
        best, *other_minima = self.minima
        return tuple(
            minimum.state for minimum in other_minima if minimum.cost < best.cost + max_increase
        )


class SimulationForwardModel:
    """Forward model by simulation; see `splits.retrieval.gauss_newton.StagedForwardModel`.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    state_vector : StateVector
        See `splits.retrieval.media.make_medium_state_vector`.
    incidence : float or "diffuse"
    max_stderr : float, optional
        Final standard error; by default `NOISE_FRACTION` of the smallest noise.
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
        min_noise = float(np.sqrt(np.diag(measurement.covariance).min()))
        default_stderr = (
            min(max(NOISE_FRACTION * min_noise, MIN_STDERR), MAX_STDERR)
            if measurement.noise_known
            else UNKNOWN_NOISE_MAX_STDERR
        )
        self.max_stderr = max_stderr or default_stderr
        self.wavelengths = select_simulation_wavelengths(measurement)
        self.operator = MeasurementOperator.from_measurement(measurement, self.wavelengths).matrix
        self.axes = [name for name in state_vector.names if name != SCALE]
        self._axis_indices = [state_vector.names.index(name) for name in self.axes]
        self._scale_index = state_vector.names.index(SCALE) if SCALE in state_vector.names else None
        self._cache: dict[tuple[bytes, int], tuple[np.ndarray, np.ndarray]] = {}
        self._progress = ProgressTracker(progress, self.max_stderr, len(state_vector.names))

    def get_stage_stderr(self, stage: int) -> float:
        """Return the standard error of the simulations of a stage."""
        return self.max_stderr if stage == LAST_STAGE else max(SURVEY_STDERR, self.max_stderr)

    def simulate(
        self, state: np.ndarray, max_stderr: float, names: list[str], seed: int
    ) -> tuple[Any, float]:
        """Return a simulation at a state with derivatives by some parameters, and the scale."""
        physical = self.state_vector.to_physical(state)
        medium, incidence = self.medium, self.incidence
        for row, name in zip(self._axis_indices, self.axes, strict=True):
            if name == INCIDENCE_KEY:
                incidence = float(physical[row])
            else:
                medium = replace_parameter(medium, name, float(physical[row]))
        spectrum = spectrophotometer(
            medium, self.wavelengths, incidence, max_stderr, seed, jacobian=names,
            progress=self._progress.track_run(max_stderr, count_runs(len(names))),
        )  # fmt: skip
        return spectrum, 1.0 if self._scale_index is None else float(physical[self._scale_index])

    def evaluate_with_covariance(
        self, state: np.ndarray, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and the covariance of simulation noise."""
        key = (state.tobytes(), stage)
        if key not in self._cache:
            spectrum, scale = self.simulate(state, self.get_stage_stderr(stage), [], self.seed)
            values = scale * (self.operator @ spectrum.reflectance.values)
            batches = scale * spectrum.reflectance_batches.values @ self.operator.T
            stderr = scale * np.abs(self.operator) @ spectrum.reflectance_stderr.values
            covariance = batches.T @ batches
            covariance += np.diag(np.maximum(stderr**2 - np.diag(covariance), 0.0))
            self._cache[key] = values, covariance
        return self._cache[key]

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the modelled measurement, shape (n,)."""
        return self.evaluate_with_covariance(state, stage)[0]

    def evaluate_last_stage(self, state: np.ndarray) -> np.ndarray:
        """Return the modelled measurement of the last stage, shape (n,)."""
        return self.evaluate(state, LAST_STAGE)

    def compute_jacobian(
        self, state: np.ndarray, stage: int, seed: int | None = None
    ) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        error = max(self.get_stage_stderr(stage), MIN_JACOBIAN_STDERR)
        spectrum, scale = self.simulate(
            state, error, self.axes, self.seed if seed is None else seed
        )
        jacobian = np.zeros((len(self.operator), len(self.state_vector.names)))
        per_unit = self._compute_coordinate_derivatives(state)
        for i, row in enumerate(self._axis_indices):
            derivative = self.operator @ spectrum.reflectance_jacobian.values[i]
            jacobian[:, row] = scale * per_unit[row] * derivative
        if self._scale_index is not None:
            values = self.operator @ spectrum.reflectance.values
            jacobian[:, self._scale_index] = (
                values * (self.state_vector.high - self.state_vector.low)[self._scale_index]
            )
        return jacobian

    def _compute_coordinate_derivatives(self, state: np.ndarray) -> np.ndarray:
        """Return the derivatives of parameters with respect to their coordinates."""
        step = 1e-6
        low, high = np.clip(state - step, 0.0, 1.0), np.clip(state + step, 0.0, 1.0)
        rate: np.ndarray = (
            self.state_vector.to_physical(high) - self.state_vector.to_physical(low)
        ) / (high - low)
        return rate

    def _make_objective(self, state: np.ndarray, stage: int) -> Objective:
        """Return the objective near a state, with noise of measurement and simulations."""
        if not self.measurement.noise_known:
            return Objective.least_squares(self.measurement.values, self.state_vector)
        covariance = self.measurement.covariance + self.evaluate_with_covariance(state, stage)[1]
        return Objective(self.measurement.values, np.linalg.cholesky(covariance), self.state_vector)

    def find_minima(self) -> ConvergedRuns:
        """Return the minima of the descents, and Jacobians at the best one."""
        qmc = import_optional("scipy.stats", "retrieval", "retrievals need").qmc

        state_vector = self.state_vector
        survey_states = qmc.Sobol(len(state_vector.names), seed=self.seed).random(N_SURVEY)
        has_prior = np.isfinite(state_vector.prior_sd)
        survey_states[:, has_prior] = (
            state_vector.prior_mean[has_prior]
            + (survey_states[:, has_prior] - 0.5) * state_vector.prior_sd[has_prior]
        )
        best, *other_minima = search_minima(
            self, self._make_objective, np.clip(survey_states, 0.02, 0.98), DESCENT_STAGES
        )[-1]
        minima = [best] + [
            minimum
            for minimum in other_minima
            if np.abs(minimum.state - best.state).max() > MIN_SEPARATION
        ]
        values, noise_covariance = self.evaluate_with_covariance(best.state, LAST_STAGE)
        min_jacobians, max_jacobians = N_JACOBIANS_RANGE
        jacobians = [
            self.compute_jacobian(best.state, LAST_STAGE, self.seed + 1 + number)
            for number in range(min_jacobians)
        ]
        while self.measurement.noise_known and len(jacobians) < max_jacobians:
            if not is_jacobian_noisy(jacobians, self.measurement.covariance + noise_covariance):
                break
            seed = self.seed + 1 + len(jacobians)
            jacobians.append(self.compute_jacobian(best.state, LAST_STAGE, seed))
        return ConvergedRuns(minima, values, noise_covariance, jacobians)


def select_simulation_wavelengths(measurement: Measurement) -> np.ndarray:
    """Return the wavelengths (nm) to simulate: those measured, or a grid across all bands."""
    if not measurement.bands:
        return np.unique(measurement.wavelength_nm)
    limits = np.array([band.limits_nm for band in measurement.bands.values()])
    low, high = float(limits.min()), float(limits.max())
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / BAND_STEP_NM)))
