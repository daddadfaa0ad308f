"""Gauss-Newton minimization with simulations as the forward model: a survey, then staged descents.

All simulations of a stage use the same random numbers, so the modelled spectrum is a smooth
function of the state, with the bias of that stage's noise.  Later stages use more rays and may use
other random numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from splits.retrieval.state_vector import StateVector

INITIAL_RADIUS = 0.3
"""Half the edge of the first trust region."""
MIN_RADIUS = 0.02
MIN_RELATIVE_GAIN = 0.003
"""A descent ends once its trust region or the predicted relative gain is below these limits."""
MIN_GAIN_PER_VALUE = 0.1
"""Limit of the predicted gain relative to the mean square, a third of a standard error."""
MIN_START_SEPARATION = 0.2
"""Smallest distance between the coordinates of two starts of the first stage."""


class StagedForwardModel(Protocol):
    """Protocol of a forward model by simulation, with stages of increasing accuracy.

    Attributes
    ----------
    state_vector : StateVector
    bound_margin : float
        Smallest distance of coordinates from the bounds.
    """

    state_vector: StateVector
    bound_margin: float

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the modelled measurement, shape (n,), with the random numbers of a stage."""
        ...

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        ...


class DescentStage(NamedTuple):
    """Settings of a stage of descents.

    Attributes
    ----------
    n_starts : int
        Largest number of descents, from the best states of the previous stage.
    max_evaluations : int
        Approximate limit of simulations per descent; a Jacobian counts as one per coordinate.
    max_cost_increase : float
        Largest excess of the cost of a start over that of the best one.
    min_separation : float
        Smallest distance between the coordinates of two starts after the first stage.
    """

    n_starts: int
    max_evaluations: int
    max_cost_increase: float = np.inf
    min_separation: float = 0.0


class Objective(NamedTuple):
    """Cost function of a fit: measurement, error covariance and priors.

    Attributes
    ----------
    measured : float, shape (n,)
    cholesky : float, shape (n, n)
        Lower Cholesky factor of the error covariance.
    state_vector : StateVector
        State vector with its priors.
    """

    measured: np.ndarray
    cholesky: np.ndarray
    state_vector: StateVector

    @classmethod
    def least_squares(cls, measured: np.ndarray, state_vector: StateVector) -> Objective:
        """Return the objective of unweighted least squares, for unknown noise."""
        return cls(measured, np.eye(len(measured)), state_vector)

    def compute_residuals(self, modelled: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the residuals of measurement and priors in standard deviations."""
        state_vector = self.state_vector
        has_prior = np.isfinite(state_vector.prior_sd)
        prior = (state - state_vector.prior_mean)[has_prior] / state_vector.prior_sd[has_prior]
        return np.concatenate([np.linalg.solve(self.cholesky, modelled - self.measured), prior])

    def compute_residual_jacobian(self, jacobian: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `compute_residuals` with respect to the coordinates."""
        prior_jacobian = np.diag(1.0 / self.state_vector.prior_sd)[
            np.isfinite(self.state_vector.prior_sd)
        ]
        return np.vstack([np.linalg.solve(self.cholesky, jacobian), prior_jacobian])


class LocalMinimum(NamedTuple):
    """Final state of a descent and its sum of squares."""

    cost: float
    state: np.ndarray


def search_minima(
    model: StagedForwardModel,
    make_objective: Callable[[np.ndarray, int], Objective],
    survey_states: np.ndarray,
    stages: Sequence[DescentStage],
) -> list[LocalMinimum]:
    """Return the minima found by the descents of the last stage, best first.

    Parameters
    ----------
    model : StagedForwardModel
    make_objective : callable
        From a state and a stage to the objective near that state.
    survey_states : float, shape (states, parameters)
        States of the survey, which is stage 0.
    stages : sequence of DescentStage
    """
    survey_states = np.clip(survey_states, model.bound_margin, 1.0 - model.bound_margin)
    survey_objective = make_objective(survey_states[0], 0)
    minima = [
        LocalMinimum(
            _sum_squares(survey_objective.compute_residuals(model.evaluate(state, 0), state)), state
        )
        for state in survey_states
    ]
    for number, stage in enumerate(stages, 1):
        separation = MIN_START_SEPARATION if number == 1 else stage.min_separation
        minima = _select_distinct(minima, stage._replace(min_separation=separation))
        # Later stages start near the minimum, so their trust region is smaller.
        radius = INITIAL_RADIUS / 2 ** (number - 1)
        objective = make_objective(minima[0].state, number)
        minima = [
            minimize_gauss_newton(
                model, number, minimum.state, objective, stage.max_evaluations, radius
            )
            for minimum in minima
        ]
        minima.sort(key=lambda minimum: minimum.cost)
    return minima


def _select_distinct(minima: Sequence[LocalMinimum], stage: DescentStage) -> list[LocalMinimum]:
    """Return the best minima that are separated from each other."""
    selected: list[LocalMinimum] = []
    for minimum in sorted(minima, key=lambda minimum: minimum.cost):
        if len(selected) == stage.n_starts or (
            selected and minimum.cost > selected[0].cost + stage.max_cost_increase
        ):
            break
        distances = [np.abs(minimum.state - other.state).max() for other in selected]
        if all(distance > stage.min_separation for distance in distances):
            selected.append(minimum)
    return selected


def minimize_gauss_newton(
    model: StagedForwardModel,
    stage: int,
    start: np.ndarray,
    objective: Objective,
    max_evaluations: int,
    radius: float,
) -> LocalMinimum:
    """Minimize an objective by Gauss-Newton steps in a trust region.

    Every step minimizes the linear model within the unit cube and a trust region around the best
    state so far.  The Jacobian is updated after Broyden (1965) as long as it predicts the misfit,
    which saves simulations.

    Parameters
    ----------
    model : StagedForwardModel
    stage : int
    start : float, shape (parameters,)
    objective : Objective
    max_evaluations : int
    radius : float
        Half the edge of the first trust region, 0 to 1.
    """
    from scipy.optimize import lsq_linear

    lower_bound, upper_bound = model.bound_margin, 1.0 - model.bound_margin
    state = np.clip(start, lower_bound, upper_bound)
    residuals = objective.compute_residuals(model.evaluate(state, stage), state)
    cost = _sum_squares(residuals)
    n_evaluations, is_stale = 1, True
    jacobian = np.empty((len(residuals), len(state)))
    while n_evaluations < max_evaluations and radius >= MIN_RADIUS:
        is_fresh = is_stale
        if is_stale:
            jacobian = objective.compute_residual_jacobian(model.compute_jacobian(state, stage))
            n_evaluations += len(state)
            is_stale = False
        low, high = (
            np.maximum(lower_bound - state, -radius),
            np.minimum(upper_bound - state, radius),
        )
        step = lsq_linear(jacobian, -residuals, (low - 1e-9, high + 1e-9)).x
        step = np.clip(state + step, lower_bound, upper_bound) - state
        predicted_gain = cost - _sum_squares(residuals + jacobian @ step)
        # Both sides are 0 where the fit is exact.
        if predicted_gain <= cost * min(MIN_RELATIVE_GAIN, MIN_GAIN_PER_VALUE / len(residuals)):
            if is_fresh:
                break
            is_stale = True
            continue
        new_residuals = objective.compute_residuals(
            model.evaluate(state + step, stage), state + step
        )
        n_evaluations += 1
        gain = cost - _sum_squares(new_residuals)
        jacobian += np.outer(new_residuals - residuals - jacobian @ step, step) / (step @ step)
        if gain < 0.25 * predicted_gain:
            radius *= 0.5
        elif gain > 0.75 * predicted_gain:
            radius = min(2.0 * radius, 0.5)
        is_stale = gain < 0.5 * predicted_gain and not (is_fresh and gain <= 0.0)
        if gain > 0.0:
            state, residuals, cost = state + step, new_residuals, cost - gain
    return LocalMinimum(cost, state)


def _sum_squares(residuals: np.ndarray) -> float:
    return float(residuals @ residuals)
