"""Solutions of models that are linear near a minimum: descents, errors, and refined posteriors.

The deviation of a model from its linearization is interpolated by radial functions (of the fifth
power, with a quadratic polynomial; Wendland 2005, Scattered Data Approximation, chapter 8) between
states from the posterior.  These are chosen in turns, each from the draws of the turn before and
far from all states so far, until the interpolation agrees with the model at all new states.  The
first turn includes alternative solutions, which draws around the best one may not reach.

For unknown noise, the state of smallest misfit, with the covariance from the misfit, is used as a
measurement of the coordinates.  Ranges, priors and the posterior then follow as for known noise.
The residual of an imperfect model is smooth along the spectrum, so neighbouring values are
correlated and carry little independent information.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from splits.retrieval.forward_model import (
    ForwardModel,
    LinearModel,
    TableModel,
    drop_priors,
    standardize,
)
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    Objective,
    Solution,
    find_active_bounds,
    find_distinct_map_estimates,
    make_map_estimate,
    solve_for_known_noise,
)
from splits.retrieval.state_vector import StateVector

MIN_RADIUS = 0.02
MIN_RELATIVE_GAIN = 0.003
"""A descent ends once its trust region or the predicted relative gain is below these limits."""
MIN_GAIN_PER_VALUE = 0.1
"""Limit of the predicted gain relative to the mean square, a third of a standard error."""
Minima = Sequence[tuple[float, np.ndarray]]
"""Costs and states of separated minima, best first."""
BOUND_MARGIN = 1e-3
"""Distance of coordinates from the bounds, where derivatives may be infinite."""


def minimize_gauss_newton(
    evaluate: Callable[[np.ndarray], np.ndarray],
    compute_jacobian: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    objective: Objective,
    max_evaluations: int,
    radius: float,
) -> tuple[float, np.ndarray]:
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

    Returns
    -------
    float, float of shape (parameters,)
        The sum of squares, and the final state.
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
    return cost, state


RANGE_INFORMATION = 12.0
"""Fisher information of a coordinate equal to that of its range."""
MIN_SIGNAL_TO_NOISE, CERTAIN_SIGNAL_TO_NOISE = 6.0, 10.0
"""Ratios of information to that of noise: to be significant, and to need no further Jacobians.

The ratio plus one is that of an F test: for six Jacobians with noise in three independent parts of
the spectrum, it exceeds 7 by chance in one case of 300.
"""


def estimate_nonlinearity(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearModel,
    state: np.ndarray,
    covariance: np.ndarray,
    error_covariance: np.ndarray,
) -> float:
    """Return the largest deviation from linearity one standard deviation away, in units of noise.

    Parameters
    ----------
    evaluate : callable
        From states to modelled measurements, shape (states, n).
    linear_model : LinearModel
    state : float, shape (parameters,)
        Most probable state.
    covariance : float, shape (parameters, parameters)
        Posterior covariance of the coordinates, along whose principal axes steps are taken.
    error_covariance : float, shape (n, n)
        Covariance of measurement and model.
    """
    variances, axes = np.linalg.eigh(covariance)
    steps = (np.sqrt(variances) * axes).T
    shifted = np.clip(state + np.concatenate([steps, -steps]), BOUND_MARGIN, 1.0 - BOUND_MARGIN)
    deviation = evaluate(shifted) - linear_model.evaluate(shifted)
    return _measure_deviation(deviation, error_covariance)


def _measure_deviation(deviations: np.ndarray, error_covariance: np.ndarray) -> float:
    """Return the largest of some deviations, shape (states, n), in units of noise."""
    cholesky = np.linalg.cholesky(error_covariance)
    return float(np.linalg.norm(np.linalg.solve(cholesky, deviations.T), axis=0).max())


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


def linearize(
    model: ForwardModel,
    state: np.ndarray,
    jacobians: Sequence[np.ndarray],
    measurement_covariance: np.ndarray,
) -> LinearModel:
    """Return the linear model at a state, from at least two independent Jacobians there."""
    modelled, covariance = model.evaluate(state[np.newaxis])[0], model.error_covariance(state)
    slopes = remove_jacobian_noise(jacobians, measurement_covariance + covariance)
    return LinearModel(model.state_vector, state, modelled, slopes, covariance)


def select_alternatives(minima: Minima, max_increase: float) -> tuple[np.ndarray, ...]:
    """Return the states of the other minima whose cost exceeds the best by less than a limit."""
    (lowest, _), *others = minima
    return tuple(state for cost, state in others if cost < lowest + max_increase)


def solve_near_minima(
    model: ForwardModel,
    minima: Minima,
    jacobians: Sequence[np.ndarray],
    measurement: Measurement,
    seed: int,
    is_exact: bool,
) -> Solution:
    """Return the solution for known noise of a model of which few states can be evaluated.

    Parameters
    ----------
    model : ForwardModel
    minima : sequence of (float, float of shape (parameters,))
        Costs and states of separated minima, best first.
    jacobians : sequence of float, shape (n, parameters)
        At least two independent Jacobians at the best minimum.
    measurement : Measurement
    seed : int
    is_exact : bool
        Whether the model has no noise, so that its posterior can be refined.
    """
    linear_model = linearize(model, minima[0][1], jacobians, measurement.covariance)
    solution = solve_for_known_noise(linear_model, measurement, seed)
    noise = solution.variance_inflation * (measurement.covariance + linear_model.covariance)
    nonlinearity = estimate_nonlinearity(
        model.evaluate, linear_model, solution.estimates[0].state, solution.covariance, noise
    )
    alternatives = select_alternatives(minima, ALTERNATIVE_CHI2)
    solution = solution._replace(nonlinearity=nonlinearity)
    if is_exact and (nonlinearity > MAX_DEVIATION or alternatives):
        solution = _refine_posterior(model, linear_model, solution, alternatives, measurement, seed)
    return solution._replace(alternatives=alternatives)


def _refine_posterior(
    model: ForwardModel,
    linear_model: LinearModel,
    solution: Solution,
    alternatives: Sequence[np.ndarray],
    measurement: Measurement,
    seed: int,
) -> Solution:
    """Return the solution of a model that is not linear within the posterior."""
    n_parameters = len(linear_model.state)
    n_new = max(MIN_NEW_STATES, (n_parameters + 1) * (n_parameters + 2) // 2)
    states, values = linear_model.evaluate_first_guesses()
    approximation, others = linear_model, list(alternatives)
    for _ in range(MAX_TURNS):
        draws = np.clip(solution.draws, BOUND_MARGIN, 1.0 - BOUND_MARGIN)
        new = np.stack([*others, *_choose_far_states(draws, np.stack([*states, *others]), n_new)])
        exact, others = model.evaluate(new), []
        deviation = exact - approximation.evaluate(new)
        largest = _measure_deviation(deviation, solution.estimates[0].error_covariance)
        solution = solution._replace(nonlinearity=largest)
        if largest < MAX_DEVIATION:
            break
        states, values = np.concatenate([states, new]), np.concatenate([values, exact])
        approximation = linear_model.with_deviation(states, values)
        solution = solve_for_known_noise(approximation, measurement, seed)
        # Not known after the last turn, where it is at most what it was before.
        solution = solution._replace(nonlinearity=largest)
    return solution


def _choose_far_states(draws: np.ndarray, states: np.ndarray, number: int) -> np.ndarray:
    """Return draws that are far from each other and from other states."""
    whiten = standardize(draws)
    points, chosen = draws @ whiten, []
    distance = np.full(len(draws), np.inf)
    others = list(states @ whiten)
    for _ in range(number):
        for other in others:
            distance = np.minimum(distance, ((points - other) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
        others = [points[chosen[-1]]]
    return draws[chosen]


NEIGHBOUR_CORRELATIONS = np.linspace(0.0, 0.98, 50)
"""Candidate correlations between neighbouring wavelengths."""
MIN_RESIDUAL_DOF = 2
"""Smallest excess of the number of values over the number of parameters."""
_UNCONSTRAINED_VARIANCE = 100.0
"""Variance of unconstrained directions, far larger than the range of coordinates."""


def estimate_misfit_variances(misfit: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the variance of a misfit, split over `NEIGHBOUR_CORRELATIONS`.

    The misfit is modelled as a first-order autoregressive series minus its projection on the fit.
    A short spectrum does not determine the correlation, so every candidate is weighted by its
    restricted likelihood.

    Parameters
    ----------
    misfit : float, shape (wavelengths,)
        Model minus measurement, not all 0.
    jacobian : float, shape (wavelengths, columns)
        Fitted directions of the spectrum, fewer columns than wavelengths.

    References
    ----------
    Harville (1974), Biometrika 61, 383-385.
    """
    columns = np.linalg.qr(jacobian)[0]
    n_dof = len(misfit) - columns.shape[1]
    squares, likelihood = np.empty((2, len(NEIGHBOUR_CORRELATIONS)))
    for i, correlation in enumerate(NEIGHBOUR_CORRELATIONS):
        weighted = _apply_inverse_correlation(columns, correlation)
        inner, outer = columns.T @ weighted, weighted.T @ misfit
        square = misfit @ _apply_inverse_correlation(misfit, correlation) - outer @ np.linalg.solve(
            inner, outer
        )
        squares[i] = max(square, np.finfo(float).tiny)
        likelihood[i] = -np.linalg.slogdet(inner)[1] - (len(misfit) - 1) * np.log(
            1.0 - correlation**2
        )
    likelihood = 0.5 * (likelihood - n_dof * np.log(squares))
    weights = np.exp(likelihood - likelihood.max())
    return weights / weights.sum() * squares / n_dof


def _apply_inverse_correlation(series: np.ndarray, correlation: float) -> np.ndarray:
    """Return the product of the inverse autoregressive correlation matrix and a series."""
    product = (1.0 + correlation**2) * series
    product[[0, -1]] -= correlation**2 * series[[0, -1]]
    product[1:] -= correlation * series[:-1]
    product[:-1] -= correlation * series[1:]
    return product / (1.0 - correlation**2)


def make_autoregressive_covariance(variances: np.ndarray, n_wavelengths: int) -> np.ndarray:
    """Return the covariance matrix of residuals from `estimate_misfit_variances`."""
    lags = np.arange(n_wavelengths)
    autocovariance = (variances[:, np.newaxis] * NEIGHBOUR_CORRELATIONS[:, np.newaxis] ** lags).sum(
        axis=0
    )
    return autocovariance[np.abs(lags[:, np.newaxis] - lags)]


def estimate_fit_covariance(
    jacobians: Sequence[np.ndarray],
    misfit: np.ndarray,
    noise_covariance: np.ndarray,
    active_bounds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariances of the coordinates of a least-squares fit and of its residuals.

    They are estimated from the misfit.

    Noise in a Jacobian would appear as information on coordinates without effect.  Products of
    different, independent Jacobians have no such bias.  Directions whose effect is below the misfit
    of a wavelength, or below that noise, count as unconstrained.

    Parameters
    ----------
    jacobians : sequence of float, shape (wavelengths, coordinates)
        At least two independent Jacobians.
    misfit : float, shape (wavelengths,)
        Model minus measurement, see `estimate_misfit_variances`.
    noise_covariance : float, shape (wavelengths, wavelengths)
        Covariance of the noise of simulations.  All simulations of a fit share their random
        numbers, so this noise shifts the minimum.
    active_bounds : bool, shape (coordinates,)
        Coordinates at an active bound, which do not reduce the misfit.
    """
    scale, unconstrained = _split_directions(jacobians, misfit)
    scaled = [jacobian @ scale for jacobian in jacobians]
    free_jacobians = [jacobian[:, ~active_bounds] for jacobian in jacobians]
    fitted_directions = np.mean(
        [jacobian @ _split_directions(free_jacobians, misfit)[0] for jacobian in free_jacobians],
        axis=0,
    )
    variances = estimate_misfit_variances(misfit, fitted_directions)
    residual_covariance = make_autoregressive_covariance(variances, len(misfit))
    spread = average_cross_products(
        scaled, [(residual_covariance + noise_covariance) @ column_set for column_set in scaled]
    )
    # The variance is at least that of the same number of independent wavelengths.
    eigenvalues, axes = np.linalg.eigh(spread)
    spread = (axes * np.maximum(eigenvalues, variances.sum())) @ axes.T
    covariance = scale @ spread @ scale.T
    covariance = covariance + _UNCONSTRAINED_VARIANCE * unconstrained @ unconstrained.T
    return covariance, residual_covariance


def _split_directions(
    jacobians: Sequence[np.ndarray], misfit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return constrained directions, scaled to unit effect, and unconstrained ones, as columns."""
    values, vectors, noise = decompose_information(jacobians, np.eye(misfit.size))
    is_constrained = values > np.maximum(np.mean(misfit**2), len(jacobians) * noise)
    return vectors[:, is_constrained] / np.sqrt(values[is_constrained]), vectors[:, ~is_constrained]


def solve_for_unknown_noise(
    model: ForwardModel,
    minima: Minima,
    jacobians: Sequence[np.ndarray],
    measurement: Measurement,
    seed: int,
) -> tuple[Solution, Measurement]:
    """Return the solution for unknown noise, and the measurement with the noise found.

    Parameters
    ----------
    model : ForwardModel
    minima, jacobians
        As for `solve_near_minima`, without priors.
    measurement : Measurement
    seed : int
    """
    best = linearize(model, minima[0][1], jacobians, measurement.covariance)
    residual = best.modelled - measurement.values
    active_bounds = find_active_bounds(best.state, best.slopes.T @ residual)
    state_covariance, noise = estimate_fit_covariance(
        jacobians, residual, best.covariance, active_bounds
    )
    solution = solve_for_state(model.state_vector, best.state, state_covariance, seed)
    state, covariance = solution.estimates[0].state, noise + best.covariance
    estimate = make_map_estimate(
        drop_priors(model), state, best.slopes, covariance, measurement.values
    )
    solution = solution._replace(
        estimates=[estimate],
        forward_model_error=np.sqrt(np.diag(best.covariance)),
        alternatives=select_alternatives(minima, ALTERNATIVE_CHI2 * float(noise[0, 0])),
        nonlinearity=estimate_nonlinearity(
            model.evaluate, best, state, solution.covariance, covariance
        ),
    )
    return solution, measurement._replace(covariance=noise)


def solve_for_state(
    state_vector: StateVector, state: np.ndarray, covariance: np.ndarray, seed: int
) -> Solution:
    """Return the solution for measured coordinates and their covariance."""
    size = len(state)
    identity = LinearModel(state_vector, state, state, np.eye(size), np.zeros((size, size)))
    measurement = Measurement(state, np.arange(size, dtype=float), covariance, {})
    return solve_for_known_noise(identity, measurement, seed)


def find_table_minima(
    model: TableModel, measurement: Measurement
) -> tuple[Minima, list[np.ndarray]]:
    """Return the minima in a table, and its Jacobian at the best, twice as it has no noise."""
    estimates = sorted(find_distinct_map_estimates(model, measurement), key=lambda one: one.cost)
    return [(one.cost, one.state) for one in estimates], [estimates[0].jacobian] * 2
