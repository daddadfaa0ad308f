"""Forward model of retrievals by simulation, with derivatives from the same paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from splits.core.progress import ProgressCallback
from splits.instruments.solver import MONTE_CARLO
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.medium import Medium
from splits.retrieval.linearization import is_jacobian_noisy
from splits.retrieval.measurement import Measurement
from splits.retrieval.medium_model import LAST_STAGE, MediumForwardModel
from splits.retrieval.simulation_schedule import (
    MIN_JACOBIAN_STDERR,
    N_JACOBIANS_RANGE,
    SURVEY_STDERR,
    ProgressTracker,
    count_runs,
)
from splits.retrieval.state_vector import StateVector

NOISE_FRACTION = 0.5
"""Ratio of the final standard error to the smallest noise of the measurement."""
MIN_STDERR, MAX_STDERR = 1e-3, 0.01
"""Limits of the final standard error."""
UNKNOWN_NOISE_MAX_STDERR = 2e-3
"""Final standard error for unknown noise."""


class SimulationForwardModel(MediumForwardModel):
    """Forward model by simulation.

    Parameters
    ----------
    medium, measurement, state_vector, incidence, seed
        See `splits.retrieval.medium_model.MediumForwardModel`.
    max_stderr : float, optional
        Final standard error; by default `NOISE_FRACTION` of the smallest noise.
    progress : callable, optional
    """

    solver = MONTE_CARLO

    def __init__(
        self, medium: Medium, measurement: Measurement, state_vector: StateVector,
        incidence: float | str, seed: int, max_stderr: float | None, progress: ProgressCallback,
    ) -> None:  # fmt: skip
        super().__init__(medium, measurement, state_vector, incidence, seed)
        min_noise = float(np.sqrt(np.diag(measurement.covariance).min()))
        default_stderr = (
            min(max(NOISE_FRACTION * min_noise, MIN_STDERR), MAX_STDERR)
            if measurement.noise_known
            else UNKNOWN_NOISE_MAX_STDERR
        )
        self.max_stderr = max_stderr or default_stderr
        self._cache: dict[tuple[bytes, int], tuple[np.ndarray, np.ndarray]] = {}
        self._progress = ProgressTracker(progress, self.max_stderr, len(state_vector.names))

    def get_stage_stderr(self, stage: int) -> float:
        """Return the standard error of the simulations of a stage."""
        return self.max_stderr if stage == LAST_STAGE else max(SURVEY_STDERR, self.max_stderr)

    def simulate(
        self, state: np.ndarray, max_stderr: float, names: list[str], seed: int
    ) -> tuple[Any, float]:
        """Return a simulation at a state with derivatives by some parameters, and the scale."""
        medium, incidence, scale = self.make_inputs(state)
        spectrum = spectrophotometer(
            medium, self.wavelengths, incidence, max_stderr, seed, solver=MONTE_CARLO,
            jacobian=names, progress=self._progress.track_run(max_stderr, count_runs(len(names))),
        )  # fmt: skip
        return spectrum, scale

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

    def compute_jacobian(
        self, state: np.ndarray, stage: int, seed: int | None = None
    ) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        error = max(self.get_stage_stderr(stage), MIN_JACOBIAN_STDERR)
        spectrum, scale = self.simulate(
            state, error, self.names, self.seed if seed is None else seed
        )
        step = 1e-6
        low, high = np.clip(state - step, 0.0, 1.0), np.clip(state + step, 0.0, 1.0)
        to_physical = self.state_vector.to_physical
        rates = (to_physical(high) - to_physical(low)) / (high - low)
        jacobian = np.empty((len(self.operator), len(state)))
        jacobian[:, self.rows] = scale * (self.operator @ spectrum.reflectance_jacobian.values.T)
        if self.scale_row is not None:
            jacobian[:, self.scale_row] = self.operator @ spectrum.reflectance.values
        return jacobian * rates

    def compute_final_jacobians(
        self, state: np.ndarray, model_covariance: np.ndarray
    ) -> list[np.ndarray]:
        """Return Jacobians with independent random numbers, as many as their noise requires."""
        jacobians: list[np.ndarray] = []
        min_jacobians, max_jacobians = N_JACOBIANS_RANGE
        covariance = self.measurement.covariance + model_covariance
        while len(jacobians) < min_jacobians or (
            self.measurement.noise_known
            and len(jacobians) < max_jacobians
            and is_jacobian_noisy(jacobians, covariance)
        ):
            seed = self.seed + 1 + len(jacobians)
            jacobians.append(self.compute_jacobian(state, LAST_STAGE, seed))
        return jacobians
