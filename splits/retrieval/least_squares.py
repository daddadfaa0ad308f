"""Retrieval with unknown measurement noise: least squares with errors estimated from the misfit.

The state of smallest misfit, with the covariance from `splits.retrieval.residual_covariance`, is
used as a measurement of the coordinates.  Ranges, priors and the posterior then follow as for known
noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.retrieval.forward_model import TableForwardModel
from splits.retrieval.gauss_newton import LocalMinimum
from splits.retrieval.linearization import Linearization, LinearizedModel, estimate_nonlinearity
from splits.retrieval.measurement import Measurement
from splits.retrieval.medium_model import ConvergedMinima, MediumForwardModel
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAPEstimate,
    PosteriorSummary,
    find_active_bounds,
    find_distinct_map_estimates,
    summarize_posterior,
)
from splits.retrieval.posterior import PosteriorDraws, draw_posterior
from splits.retrieval.residual_covariance import (
    MIN_RESIDUAL_DOF,
    FitCovariance,
    estimate_fit_covariance,
)
from splits.retrieval.solution import Solution, compute_prior_tension
from splits.retrieval.state_vector import StateVector


class PosteriorEstimate(NamedTuple):
    """Posterior of a least-squares estimate within its ranges and priors.

    Attributes
    ----------
    state : float, shape (parameters,)
        Most probable state.
    posterior : PosteriorSummary
    draws : PosteriorDraws
    prior_tension : float, shape (parameters,)
        See `splits.retrieval.solution.Solution`.
    """

    state: np.ndarray
    posterior: PosteriorSummary
    draws: PosteriorDraws
    prior_tension: np.ndarray


def apply_priors(
    state_vector: StateVector, state: np.ndarray, covariance: np.ndarray, seed: int
) -> PosteriorEstimate:
    """Return the posterior of an estimate of the coordinates.

    Parameters
    ----------
    state_vector : StateVector
    state : float, shape (parameters,)
    covariance : float, shape (parameters, parameters)
        See `splits.retrieval.residual_covariance.estimate_fit_covariance`.
    seed : int
        Seed of the draws.
    """
    n_parameters = len(state)
    measurement = Measurement(state, np.arange(n_parameters, dtype=float), covariance, {})
    linear_model = LinearizedModel(
        state_vector,
        Linearization(state, state, np.eye(n_parameters), np.zeros((n_parameters, n_parameters))),
    )
    estimates = find_distinct_map_estimates(
        linear_model, measurement, *linear_model.evaluate_first_guesses()
    )
    draws = draw_posterior(linear_model, measurement, estimates, seed)
    prior_tension = compute_prior_tension(state_vector, state, np.diag(covariance))
    return PosteriorEstimate(
        estimates[0].state, summarize_posterior(estimates[0], state_vector), draws, prior_tension
    )


def retrieve_without_noise(
    model: TableForwardModel | MediumForwardModel, measurement: Measurement, seed: int
) -> tuple[Solution, Measurement]:
    """Return the solution for unknown noise, and the measurement with the noise found."""
    check_enough_values(len(model.state_vector.names), measurement)
    state_vector = model.state_vector
    model.state_vector = state_vector.drop_priors()
    converged = (
        model.find_minima()
        if isinstance(model, MediumForwardModel)
        else _find_table_minima(model, measurement)
    )
    model.state_vector = state_vector
    best = converged.linearize(measurement.covariance)
    residual = best.modelled - measurement.values
    active_bounds = find_active_bounds(best.state, best.jacobian.T @ residual)
    fit_covariance = estimate_fit_covariance(
        converged.jacobians, residual, best.error_covariance, active_bounds
    )
    alternatives = converged.find_alternatives(
        ALTERNATIVE_CHI2 * float(fit_covariance.residual[0, 0])
    )
    linear_model = LinearizedModel(state_vector, best)
    return _make_solution(
        model.evaluate_state, linear_model, measurement, fit_covariance, alternatives, seed
    )


def _find_table_minima(model: TableForwardModel, measurement: Measurement) -> ConvergedMinima:
    """Return the minima in a table."""
    estimates = find_distinct_map_estimates(model, measurement, *model.evaluate_first_guesses())
    best, *others = sorted(estimates, key=lambda estimate: estimate.cost)
    minima = [LocalMinimum(estimate.cost, estimate.state) for estimate in (best, *others)]
    covariance = model.compute_error_covariance(best.state)
    return ConvergedMinima(minima, best.modelled, covariance, [best.jacobian] * 2)


def check_enough_values(n_parameters: int, measurement: Measurement) -> None:
    """Reject a measurement of unknown noise with too few values for its free parameters."""
    min_values, n_values = n_parameters + MIN_RESIDUAL_DOF, measurement.values.size
    if not measurement.noise_known and n_values < min_values:
        hint = (
            f"{n_values} values are too few to estimate it from the misfit, {min_values} are needed"
        )
        raise invalid("noise", None, "given", hint)


def _make_solution(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    measurement: Measurement,
    fit_covariance: FitCovariance,
    alternatives: tuple[np.ndarray, ...],
    seed: int,
) -> tuple[Solution, Measurement]:
    """Return the solution, and the measurement with the estimated noise."""
    best = linear_model.linearization
    posterior = apply_priors(linear_model.state_vector, best.state, fit_covariance.state, seed)
    modelled = evaluate(posterior.state)
    total_covariance = fit_covariance.residual + best.error_covariance
    residual = modelled - measurement.values
    chi2 = float(residual @ np.linalg.solve(total_covariance, residual))
    active_bounds = find_active_bounds(
        posterior.state, best.jacobian.T @ np.linalg.solve(total_covariance, residual)
    )
    estimate = MAPEstimate(
        posterior.state, modelled, best.jacobian, total_covariance, chi2, chi2, active_bounds
    )
    model_stderr = np.sqrt(np.diag(best.error_covariance))
    nonlinearity = estimate_nonlinearity(
        evaluate, linear_model, posterior.state, posterior.posterior.covariance, total_covariance
    )
    solution = Solution(
        [estimate],
        posterior.posterior,
        posterior.draws,
        1.0,
        posterior.prior_tension,
        model_stderr,
        alternatives,
        nonlinearity,
    )
    return solution, measurement._replace(covariance=fit_covariance.residual)
