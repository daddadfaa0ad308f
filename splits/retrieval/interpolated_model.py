"""Forward model that interpolates between states, for posteriors within which it is not linear.

The deviation of the model from its linearization is interpolated by radial functions (of the fifth
power, with a quadratic polynomial; Wendland 2005, Scattered Data Approximation, chapter 8) between
states from the posterior.  These are chosen in turns, each from the draws of the turn before and
far from all states so far, until the interpolation agrees with the model at all new states.  The
first turn includes alternative solutions, which draws around the best one may not reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from splits.retrieval.linearization import BOUND_MARGIN, LinearizedModel
from splits.retrieval.solution import Solution

MAX_DEVIATION = 0.5
"""Largest deviation of the model from its approximation, in units of noise."""
MAX_TURNS = 8
MIN_NEW_STATES = 16
"""Smallest number of states of a turn; there are as many as a quadratic polynomial has terms."""
MIN_SPREAD = 1e-5
"""Smallest standard deviation of coordinates."""
GRADIENT_STEP = 1e-4
"""Step of coordinates for derivatives."""


class InterpolatedModel(LinearizedModel):
    """Forward model that interpolates between states; see `splits.retrieval.forward_model`.

    Parameters
    ----------
    linear_model : LinearizedModel
    states : float, shape (states, parameters)
    values : float, shape (states, n)
        Modelled measurements.
    """

    def __init__(
        self, linear_model: LinearizedModel, states: np.ndarray, values: np.ndarray
    ) -> None:
        from scipy.interpolate import RBFInterpolator

        super().__init__(linear_model.state_vector, linear_model.linearization)
        self.states, self.values, self._whiten = states, values, _compute_whitening(states)
        deviation = values - linear_model.evaluate(states)
        self._deviation = RBFInterpolator(
            states @ self._whiten, deviation, kernel="quintic", degree=2
        )

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""
        deviation: np.ndarray = self._deviation(states @ self._whiten)
        return super().evaluate(states) + deviation

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and its Jacobian, shape (n, parameters)."""
        steps = GRADIENT_STEP * np.eye(len(state))
        values = self.evaluate(state + np.concatenate([0.0 * steps[:1], steps, -steps]))
        high, low = np.split(values[1:], 2)
        return values[0], (high - low).T / (2.0 * GRADIENT_STEP)

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states, and their modelled measurements."""
        return self.states, self.values


def refine_posterior(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    solution: Solution,
    solve: Callable[[InterpolatedModel], Solution],
    alternatives: Sequence[np.ndarray] = (),
) -> Solution:
    """Return the solution of a model that is not linear within the posterior.

    Parameters
    ----------
    evaluate : callable
        From a state to the modelled measurement, shape (n,).
    linear_model : LinearizedModel
    solution : Solution
        Of the linear model.
    solve : callable
        From a model to its solution.
    alternatives : sequence of float, shape (parameters,)
        Alternative solutions of the model.
    """
    start = linear_model.linearization
    n_parameters = len(start.state)
    n_new = max(MIN_NEW_STATES, (n_parameters + 1) * (n_parameters + 2) // 2)
    states, values = start.state[np.newaxis], start.modelled[np.newaxis]
    model = linear_model
    for turn in range(MAX_TURNS):
        draws = np.clip(solution.draws.states, BOUND_MARGIN, 1.0 - BOUND_MARGIN)
        others = list(alternatives) if turn == 0 else []
        new = np.stack([*others, *_choose_far_states(draws, np.stack([*states, *others]), n_new)])
        exact = np.array([evaluate(state) for state in new])
        noise = np.linalg.cholesky(solution.estimates[0].error_covariance)
        deviation = np.linalg.solve(noise, (exact - model.evaluate(new)).T)
        largest = float(np.linalg.norm(deviation, axis=0).max())
        solution = solution._replace(nonlinearity=largest)
        if largest < MAX_DEVIATION:
            break
        states, values = np.concatenate([states, new]), np.concatenate([values, exact])
        model = InterpolatedModel(linear_model, states, values)
        solution = solve(model)
    return solution


def _choose_far_states(draws: np.ndarray, states: np.ndarray, number: int) -> np.ndarray:
    """Return draws that are far from each other and from other states."""
    whiten = _compute_whitening(draws)
    points, chosen = draws @ whiten, []
    distance = np.full(len(draws), np.inf)
    others = list(states @ whiten)
    for _ in range(number):
        for other in others:
            distance = np.minimum(distance, ((points - other) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
        others = [points[chosen[-1]]]
    return draws[chosen]


def _compute_whitening(states: np.ndarray) -> np.ndarray:
    """Return the matrix that makes the coordinates of states independent, with variances of 1."""
    covariance = np.cov(states, rowvar=False).reshape(states.shape[1], -1)
    floor = MIN_SPREAD**2 * np.eye(len(covariance))
    whitening: np.ndarray = np.linalg.inv(np.linalg.cholesky(covariance + floor)).T
    return whitening
