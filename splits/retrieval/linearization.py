"""Gauss-Newton descents, the noise of Jacobians, nonlinearity, and refined posteriors.

The deviation of a model from its linearization is interpolated by radial functions (of the fifth
power, with a quadratic polynomial; Wendland 2005, Scattered Data Approximation, chapter 8) between
states from the posterior.  These are chosen in turns, each from the draws of the turn before and
far from all states so far, until the interpolation agrees with the model at all new states.  The
first turn includes alternative solutions, which draws around the best one may not reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splits.retrieval.forward_model import InterpolatedModel, LinearizedModel, compute_whitening
from splits.retrieval.optimal_estimation import Objective, Solution

MIN_RADIUS = 0.02
MIN_RELATIVE_GAIN = 0.003
"""A descent ends once its trust region or the predicted relative gain is below these limits."""
MIN_GAIN_PER_VALUE = 0.1
"""Limit of the predicted gain relative to the mean square, a third of a standard error."""
BOUND_MARGIN = 1e-3
"""Distance of coordinates from the bounds, where derivatives may be infinite."""


class LocalMinimum(NamedTuple):
    """Final state of a descent and its sum of squares."""

    cost: float
    state: np.ndarray


def minimize_gauss_newton(
    evaluate: Callable[[np.ndarray], np.ndarray],
    compute_jacobian: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    objective: Objective,
    max_evaluations: int,
    radius: float,
) -> LocalMinimum:
    """Minimize an objective with simulations as the forward model by Gauss-Newton steps.

    All simulations of a descent use the same random numbers, so the modelled spectrum is a smooth
    function of the state, with the bias of their noise.

    Every step minimizes the linear model within the unit cube and a trust region around the best
    state so far.  The Jacobian is updated after Broyden (1965) as long as it predicts the misfit,
    which saves simulations.

    Parameters
    ----------
    evaluate : callable
        From a state to the modelled measurement, shape (n,).
    compute_jacobian : callable
        From a state to the Jacobian with respect to the coordinates, shape (n, parameters).
    start : float, shape (parameters,)
    objective : Objective
    max_evaluations : int
        Approximate limit of simulations; a Jacobian counts as one per coordinate.
    radius : float
        Half the edge of the first trust region, 0 to 1.
    """
    from scipy.optimize import lsq_linear

    lower_bound, upper_bound = BOUND_MARGIN, 1.0 - BOUND_MARGIN
    state = np.clip(start, lower_bound, upper_bound)
    residuals = objective.compute_residuals(evaluate(state), state)
    cost = float(residuals @ residuals)
    n_evaluations, is_stale = 1, True
    jacobian = np.empty((len(residuals), len(state)))
    while n_evaluations < max_evaluations and radius >= MIN_RADIUS:
        is_fresh = is_stale
        if is_stale:
            jacobian = objective.compute_residual_jacobian(compute_jacobian(state))
            n_evaluations += len(state)
            is_stale = False
        low = np.maximum(lower_bound - state, -radius)
        high = np.minimum(upper_bound - state, radius)
        step = lsq_linear(jacobian, -residuals, (low - 1e-9, high + 1e-9)).x
        step = np.clip(state + step, lower_bound, upper_bound) - state
        predicted = residuals + jacobian @ step
        predicted_gain = cost - float(predicted @ predicted)
        # Both sides are 0 where the fit is exact.
        if predicted_gain <= cost * min(MIN_RELATIVE_GAIN, MIN_GAIN_PER_VALUE / len(residuals)):
            if is_fresh:
                break
            is_stale = True
            continue
        new_residuals = objective.compute_residuals(evaluate(state + step), state + step)
        n_evaluations += 1
        gain = cost - float(new_residuals @ new_residuals)
        jacobian += np.outer(new_residuals - predicted, step) / (step @ step)
        if gain < 0.25 * predicted_gain:
            radius *= 0.5
        elif gain > 0.75 * predicted_gain:
            radius = min(2.0 * radius, 0.5)
        is_stale = gain < 0.5 * predicted_gain and not (is_fresh and gain <= 0.0)
        if gain > 0.0:
            state, residuals, cost = state + step, new_residuals, cost - gain
    return LocalMinimum(cost, state)


RANGE_INFORMATION = 12.0
"""Fisher information of a coordinate equal to that of its range."""
MIN_SIGNAL_TO_NOISE, CERTAIN_SIGNAL_TO_NOISE = 6.0, 10.0
"""Ratios of information to that of noise: to be significant, and to need no further Jacobians.

The ratio plus one is that of an F test: for six Jacobians with noise in three independent parts of
the spectrum, it exceeds 7 by chance in one case of 300.
"""


def estimate_nonlinearity(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    state: np.ndarray,
    covariance: np.ndarray,
    error_covariance: np.ndarray,
) -> float:
    """Return the largest deviation from linearity one standard deviation away, in units of noise.

    Parameters
    ----------
    evaluate : callable
        From a state to the modelled measurement, shape (n,).
    linear_model : LinearizedModel
    state : float, shape (parameters,)
        Most probable state.
    covariance : float, shape (parameters, parameters)
        Posterior covariance of the coordinates, along whose principal axes steps are taken.
    error_covariance : float, shape (n, n)
        Covariance of measurement and model.
    """
    variances, axes = np.linalg.eigh(covariance)
    cholesky = np.linalg.cholesky(error_covariance)
    largest = 0.0
    for step in np.concatenate([np.sqrt(variances) * axes, -np.sqrt(variances) * axes], axis=1).T:
        shifted = np.clip(state + step, BOUND_MARGIN, 1.0 - BOUND_MARGIN)
        deviation = evaluate(shifted) - linear_model.evaluate(shifted[np.newaxis])[0]
        largest = max(largest, float(np.linalg.norm(np.linalg.solve(cholesky, deviation))))
    return largest


def remove_jacobian_noise(
    jacobians: Sequence[np.ndarray], error_covariance: np.ndarray
) -> np.ndarray:
    """Return a Jacobian without the spurious information of noise in independent Jacobians.

    The mean K of the Jacobians has the information M = Kᵀ S⁻¹ K, which noise increases.  Products
    of different Jacobians give an unbiased estimate F.  K M^(-1/2) F^(1/2) has the information F.

    Parameters
    ----------
    jacobians : sequence of float, shape (n, parameters)
        At least two.
    error_covariance : float, shape (n, n)
        Covariance S of measurement and model.
    """
    values, vectors, noise = decompose_information(jacobians, error_covariance)
    mean: np.ndarray = np.mean(jacobians, axis=0)
    root = (
        vectors * np.sqrt(np.where(values > MIN_SIGNAL_TO_NOISE * noise, values, 0.0))
    ) @ vectors.T
    eigenvalues, axes = np.linalg.eigh(mean.T @ np.linalg.solve(error_covariance, mean))
    is_positive = eigenvalues > 1e-12 * max(eigenvalues[-1], 1e-300)
    inverse = (axes[:, is_positive] / np.sqrt(eigenvalues[is_positive])) @ axes[:, is_positive].T
    return mean @ inverse @ root


def is_jacobian_noisy(jacobians: Sequence[np.ndarray], error_covariance: np.ndarray) -> bool:
    """Return whether noise of the Jacobians may decide which parameters are constrained."""
    values, _, noise = decompose_information(jacobians, error_covariance)
    return bool(
        ((values + noise > RANGE_INFORMATION) & (values < CERTAIN_SIGNAL_TO_NOISE * noise)).any()
    )


def decompose_information(
    jacobians: Sequence[np.ndarray], error_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues and eigenvectors of the information, and the noise along them."""
    cholesky = np.linalg.cholesky(error_covariance)
    whitened = [np.linalg.solve(cholesky, jacobian) for jacobian in jacobians]
    values, vectors = np.linalg.eigh(average_cross_products(whitened, whitened))
    mean_square = np.mean(
        [((jacobian @ vectors) ** 2).sum(axis=0) for jacobian in whitened], axis=0
    )
    return values, vectors, np.maximum(mean_square - values, 0.0) / len(jacobians)


def average_cross_products(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean product of a left matrix and a different, independent right matrix."""
    n_matrices = len(left)
    same_products = np.sum([a.T @ b for a, b in zip(left, right, strict=True)], axis=0)
    mean_product: np.ndarray = (np.sum(left, axis=0).T @ np.sum(right, axis=0) - same_products) / (
        n_matrices * (n_matrices - 1)
    )
    return 0.5 * (mean_product + mean_product.T)


MAX_DEVIATION = 0.5
"""Largest deviation of the model from its approximation, in units of noise."""
MAX_TURNS = 8
MIN_NEW_STATES = 16
"""Smallest number of states of a turn; there are as many as a quadratic polynomial has terms."""


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
    n_parameters = len(linear_model.state)
    n_new = max(MIN_NEW_STATES, (n_parameters + 1) * (n_parameters + 2) // 2)
    states, values = linear_model.evaluate_first_guesses()
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
    whiten = compute_whitening(draws)
    points, chosen = draws @ whiten, []
    distance = np.full(len(draws), np.inf)
    others = list(states @ whiten)
    for _ in range(number):
        for other in others:
            distance = np.minimum(distance, ((points - other) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
        others = [points[chosen[-1]]]
    return draws[chosen]
