"""Forward models of a medium without a table: descents to the most probable medium.

The spectra are simulations (`splits.retrieval.simulation_model`) or solutions by discrete ordinates
(`splits.retrieval.ordinates_model`).  Near the minimum, reflectance is assumed to be linear in the
coordinates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, replace_parameters
from splits.retrieval.forward_model import MeasurementOperator
from splits.retrieval.gauss_newton import DescentStage, LocalMinimum, Objective, search_minima
from splits.retrieval.linearization import BOUND_MARGIN, Linearization, remove_jacobian_noise
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import ALTERNATIVE_CHI2, MIN_SEPARATION
from splits.retrieval.state_vector import SCALE, StateVector

N_SURVEY = 16
"""Number of states of the survey."""
DESCENT_STAGES = (DescentStage(2, 60), DescentStage(2, 60, ALTERNATIVE_CHI2, MIN_SEPARATION))
"""Stages of descents: from the best states of the survey, and with the final accuracy."""
LAST_STAGE = len(DESCENT_STAGES)
BAND_STEP_NM = 10.0
"""Step of wavelengths within bands (nm)."""


class ConvergedMinima(NamedTuple):
    """Minima of a retrieval, and independent Jacobians at the best one.

    Attributes
    ----------
    minima : list of LocalMinimum
        Separated minima, best first.
    modelled : float, shape (n,)
        Modelled measurement at the best minimum.
    model_covariance : float, shape (n, n)
        Covariance of the errors of the model.
    jacobians : list of float, shape (n, parameters)
        Independent Jacobians at the best minimum; the same one twice without noise.
    """

    minima: list[LocalMinimum]
    modelled: np.ndarray
    model_covariance: np.ndarray
    jacobians: list[np.ndarray]

    def linearize(self, measurement_covariance: np.ndarray) -> Linearization:
        """Return the linearization at the best minimum, with noise removed from its Jacobian."""
        slopes = remove_jacobian_noise(
            self.jacobians, measurement_covariance + self.model_covariance
        )
        return Linearization(self.minima[0].state, self.modelled, slopes, self.model_covariance)

    def find_alternatives(self, max_increase: float) -> tuple[np.ndarray, ...]:
        """Return the other minima whose cost exceeds the best by less than a limit."""
        best, *other_minima = self.minima
        return tuple(
            minimum.state for minimum in other_minima if minimum.cost < best.cost + max_increase
        )


class MediumForwardModel(ABC):
    """Forward model of a medium; see `splits.retrieval.gauss_newton.StagedForwardModel`.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    state_vector : StateVector
        See `splits.retrieval.media.make_medium_state_vector`.
    incidence : float or "diffuse"
    seed : int
        Of the survey, and of simulations.
    """

    solver: str
    bound_margin = BOUND_MARGIN
    descent_stages: tuple[DescentStage, ...] = DESCENT_STAGES

    def __init__(
        self, medium: Medium, measurement: Measurement, state_vector: StateVector,
        incidence: float | str, seed: int,
    ) -> None:  # fmt: skip
        self.medium, self.measurement, self.state_vector = medium, measurement, state_vector
        self.incidence, self.seed = incidence, seed
        self.wavelengths = select_simulation_wavelengths(measurement)
        self.operator = MeasurementOperator.from_measurement(measurement, self.wavelengths).matrix
        self.names = [name for name in state_vector.names if name != SCALE]
        self.rows = [state_vector.names.index(name) for name in self.names]
        self.scale_row = state_vector.names.index(SCALE) if SCALE in state_vector.names else None

    @abstractmethod
    def evaluate_with_covariance(
        self, state: np.ndarray, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and the covariance of its errors."""

    @abstractmethod
    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""

    @abstractmethod
    def compute_final_jacobians(
        self, state: np.ndarray, model_covariance: np.ndarray
    ) -> list[np.ndarray]:
        """Return at least two independent Jacobians of the last stage."""

    def select_values(self, stage: int) -> np.ndarray:
        """Return the positions of the measured values that a stage uses."""
        return np.arange(self.measurement.values.size)

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the modelled measurement, shape (n,)."""
        return self.evaluate_with_covariance(state, stage)[0]

    def evaluate_state(self, state: np.ndarray) -> np.ndarray:
        """Return the modelled measurement of the last stage, shape (n,)."""
        return self.evaluate(state, LAST_STAGE)

    def make_inputs(self, state: np.ndarray) -> tuple[Medium, float | str, float]:
        """Return the medium, the incidence and the scale of a state."""
        physical = self.state_vector.to_physical(state)
        values = {n: float(physical[row]) for row, n in zip(self.rows, self.names, strict=True)}
        incidence = values.pop(INCIDENCE_KEY, self.incidence)
        medium = replace_parameters(self.medium, values)
        scale = 1.0 if self.scale_row is None else float(physical[self.scale_row])
        return medium, incidence, scale

    def make_objective(self, state: np.ndarray, stage: int) -> Objective:
        """Return the objective near a state, with the errors of measurement and model."""
        positions = self.select_values(stage)
        measured = self.measurement.values[positions]
        if not self.measurement.noise_known:
            return Objective.least_squares(measured, self.state_vector)
        covariance = self.measurement.covariance[np.ix_(positions, positions)]
        covariance = covariance + self.evaluate_with_covariance(state, stage)[1]
        return Objective(measured, np.linalg.cholesky(covariance), self.state_vector)

    def find_minima(self) -> ConvergedMinima:
        """Return the minima of the descents, and Jacobians at the best one."""
        from scipy.stats import qmc

        state_vector = self.state_vector
        survey_states = qmc.Sobol(len(state_vector.names), seed=self.seed).random(N_SURVEY)
        has_prior = np.isfinite(state_vector.prior_sd)
        survey_states[:, has_prior] = (
            state_vector.prior_mean[has_prior]
            + (survey_states[:, has_prior] - 0.5) * state_vector.prior_sd[has_prior]
        )
        best, *other_minima = search_minima(
            self, self.make_objective, np.clip(survey_states, 0.02, 0.98), self.descent_stages
        )[-1]
        minima = [best] + [
            minimum
            for minimum in other_minima
            if np.abs(minimum.state - best.state).max() > MIN_SEPARATION
        ]
        values, covariance = self.evaluate_with_covariance(best.state, LAST_STAGE)
        jacobians = self.compute_final_jacobians(best.state, covariance)
        return ConvergedMinima(minima, values, covariance, jacobians)


def select_simulation_wavelengths(measurement: Measurement) -> np.ndarray:
    """Return the wavelengths (nm) to simulate: those measured, or a grid across all bands."""
    if not measurement.bands:
        return np.unique(measurement.wavelength_nm)
    limits = np.array([band.limits_nm for band in measurement.bands.values()])
    low, high = float(limits.min()), float(limits.max())
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / BAND_STEP_NM)))
