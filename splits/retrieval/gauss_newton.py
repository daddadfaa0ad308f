"""Gauss-Newton minimization with simulations as the forward model.

All simulations of a descent use the same random numbers, so the modelled spectrum is a smooth
function of the state, with the bias of their noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.retrieval.optimal_estimation import Objective

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
    """Minimize an objective by Gauss-Newton steps in a trust region.

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
