"""Retrieval where noise is not known: least squares, whose misfit says how far they may be off.

The place of the least misfit, with the covariance that `splits.retrieval.residual_covariance`
finds, is then taken for a measurement of the coordinates themselves.  Ranges, priors, and what is
told follow as they do where noise is known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.retrieval.forward_model import TableForwardModel
from splits.retrieval.linearization import Linearization, LinearizedModel, estimate_nonlinearity
from splits.retrieval.measurement import Measurement
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
from splits.retrieval.result import Solution, compute_prior_tension
from splits.retrieval.simulation_model import SimulationForwardModel
from splits.retrieval.state_vector import StateVector


class PosteriorEstimate(NamedTuple):
    """What an estimate tells, within ranges and with priors.

    Attributes
    ----------
    state : float, shape (parameters,)
        The most probable one.
    posterior : Told
    draws : PosteriorDraws
    prior_tension : float, shape (parameters,)
        See `splits.retrieval.result.Found`.
    """

    state: np.ndarray
    posterior: PosteriorSummary
    draws: PosteriorDraws
    prior_tension: np.ndarray


def apply_priors(
    state_vector: StateVector, state: np.ndarray, covariance: np.ndarray, seed: int
) -> PosteriorEstimate:
    """Return what an estimate of the coordinates tells.

    Parameters
    ----------
    state_vector : StateVector
    state : float, shape (parameters,)
    covariance : float, shape (parameters, parameters)
        See `splits.retrieval.residual_covariance.estimate_fit_covariance`.
    seed : int
        Of the draws.
    """
    many = len(state)
    measurement = Measurement(state, np.arange(many, dtype=float), covariance, {})
    itself = LinearizedModel(
        state_vector, Linearization(state, state, np.eye(many), np.zeros((many, many)))
    )
    ends = find_distinct_map_estimates(itself, measurement, *itself.evaluate_first_guesses())
    draws = draw_posterior(itself, measurement, ends, seed)
    tension = compute_prior_tension(state_vector, state, np.diag(covariance))
    return PosteriorEstimate(
        ends[0].state, summarize_posterior(ends[0], state_vector), draws, tension
    )


def retrieve_from_table(
    model: TableForwardModel, measurement: Measurement, seed: int
) -> tuple[Solution, Measurement]:
    """Return what a measurement of unknown noise tells in a table, and the noise found."""
    check_enough_values(len(model.state_vector.names), measurement)
    free = model.state_vector
    model.state_vector = free.drop_priors()
    best, *others = sorted(
        find_distinct_map_estimates(model, measurement, *model.evaluate_first_guesses()),
        key=lambda end: end.cost,
    )
    own = model.compute_error_covariance(best.state)
    model.state_vector = free
    left = estimate_fit_covariance(
        [best.jacobian] * 2, best.modelled - measurement.values, own, best.active_bounds
    )
    around = LinearizedModel(free, Linearization(best.state, best.modelled, best.jacobian, own))
    within = ALTERNATIVE_CHI2 * float(left.residual[0, 0])
    rivals = tuple(end.state for end in others if end.cost < best.cost + within)
    return _make_solution(
        lambda x: model.evaluate_with_jacobian(x)[0], around, measurement, left, rivals, seed
    )


def retrieve_by_simulation(
    model: SimulationForwardModel, measurement: Measurement, seed: int
) -> tuple[Solution, Measurement]:
    """Return what a measurement of unknown noise tells by runs, and the noise found."""
    check_enough_values(len(model.state_vector.names), measurement)
    free = model.state_vector
    model.state_vector = free.drop_priors()
    settled = model.find_minima()
    model.state_vector = free
    best = settled.linearize(measurement.covariance)
    off = best.modelled - measurement.values
    held = find_active_bounds(best.state, best.jacobian.T @ off)
    left = estimate_fit_covariance(settled.jacobians, off, best.error_covariance, held)
    rivals = settled.find_alternatives(ALTERNATIVE_CHI2 * float(left.residual[0, 0]))
    return _make_solution(
        model.evaluate_last_stage, LinearizedModel(free, best), measurement, left, rivals, seed
    )


def check_enough_values(n_parameters: int, measurement: Measurement) -> None:
    """Reject a measurement of unknown noise with too few values for so many free parameters."""
    least, count = n_parameters + MIN_RESIDUAL_DOF, measurement.values.size
    if not measurement.noise_known and count < least:
        hint = f"{count} values are too few to find it from the misfit, {least} are needed"
        raise invalid("noise", None, "given", hint)


def _make_solution(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    measurement: Measurement,
    fit_covariance: FitCovariance,
    alternatives: tuple[np.ndarray, ...],
    seed: int,
) -> tuple[Solution, Measurement]:
    """Return what was found as where noise is known, and the measurement with the noise found."""
    best = linear_model.linearization
    found = apply_priors(linear_model.state_vector, best.state, fit_covariance.state, seed)
    there = evaluate(found.state)
    whole = fit_covariance.residual + best.error_covariance
    off = there - measurement.values
    chi2 = float(off @ np.linalg.solve(whole, off))
    held = find_active_bounds(found.state, best.jacobian.T @ np.linalg.solve(whole, off))
    end = MAPEstimate(found.state, there, best.jacobian, whole, chi2, chi2, held)
    own = np.sqrt(np.diag(best.error_covariance))
    curved = estimate_nonlinearity(
        evaluate, linear_model, found.state, found.posterior.covariance, whole
    )
    plain = Solution(
        [end], found.posterior, found.draws, 1.0, found.prior_tension, own, alternatives, curved
    )
    return plain, measurement._replace(covariance=fit_covariance.residual)
