"""Retrieval where noise is not known: least squares, whose misfit says how far they may be off.

The place of the least misfit, with the covariance that `splits.retrieval.misfit` finds, is then
taken for a measurement of the coordinates themselves.  Ranges, priors, and what is told follow as
they do where noise is known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.checks import refuse
from splits.retrieval.coordinates import Free
from splits.retrieval.estimation import RIVAL, Optimum, Told, held_at, optima, told
from splits.retrieval.forward import OfTable
from splits.retrieval.line import Around, Seen, bent
from splits.retrieval.measurement import Measurement
from splits.retrieval.misfit import SPARE, Left, left_open
from splits.retrieval.posterior import Draws, draws_of
from splits.retrieval.result import Found, tension_of
from splits.retrieval.runs import OfRuns


class Estimated(NamedTuple):
    """What an estimate tells, within ranges and with priors.

    Attributes
    ----------
    place : float, shape (parameters,)
        The most probable one.
    told : Told
    draws : Draws
    tension : float, shape (parameters,)
        See `splits.retrieval.result.Found`.
    """

    state: np.ndarray
    posterior: Told
    draws: Draws
    prior_tension: np.ndarray


def estimated(state_vector: Free, state: np.ndarray, covariance: np.ndarray, seed: int) -> Estimated:
    """Return what an estimate of the coordinates tells.

    Parameters
    ----------
    free : Free
    place : float, shape (parameters,)
    covariance : float, shape (parameters, parameters)
        See `splits.retrieval.misfit.left_open`.
    seed : int
        Of the draws.
    """
    many = len(state)
    measurement = Measurement(state, np.arange(many, dtype=float), covariance, {})
    itself = Around(state_vector, Seen(state, state, np.eye(many), np.zeros((many, many))))
    ends = optima(itself, measurement, *itself.evaluate_first_guesses())
    draws = draws_of(itself, measurement, ends, seed)
    tension = tension_of(state_vector, state, np.diag(covariance))
    return Estimated(ends[0].state, told(ends[0], state_vector), draws, tension)


def in_table(model: OfTable, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells in a table, and the noise found."""
    check_enough(len(model.state_vector.names), measurement)
    free = model.state_vector
    model.state_vector = free.drop_priors()
    best, *others = sorted(optima(model, measurement, *model.evaluate_first_guesses()), key=lambda end: end.cost)
    own = model.compute_error_covariance(best.state)
    model.state_vector = free
    left = left_open([best.jacobian] * 2, best.modelled - measurement.values, own, best.active_bounds)
    around = Around(free, Seen(best.state, best.modelled, best.jacobian, own))
    within = RIVAL * float(left.residual[0, 0])
    rivals = tuple(end.state for end in others if end.cost < best.cost + within)
    return _found(lambda x: model.evaluate_with_jacobian(x)[0], around, measurement, left, rivals, seed)


def by_runs(model: OfRuns, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells by runs, and the noise found."""
    check_enough(len(model.state_vector.names), measurement)
    free = model.state_vector
    model.state_vector = free.drop_priors()
    settled = model.find_minima()
    model.state_vector = free
    best = settled.linearize(measurement.covariance)
    off = best.modelled - measurement.values
    held = held_at(best.state, best.jacobian.T @ off)
    left = left_open(settled.jacobians, off, best.error_covariance, held)
    rivals = settled.find_alternatives(RIVAL * float(left.residual[0, 0]))
    return _found(model.evaluate_last_stage, Around(free, best), measurement, left, rivals, seed)


def check_enough(n_parameters: int, measurement: Measurement) -> None:
    """Refuse a measurement of unknown noise with too few values for so many free parameters."""
    least, count = n_parameters + SPARE, measurement.values.size
    if not measurement.noise_known and count < least:
        hint = f"{count} values are too few to find it from the misfit, {least} are needed"
        raise refuse("noise", None, "given", hint)


def _found(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: Around,
    measurement: Measurement,
    fit_covariance: Left,
    alternatives: tuple[np.ndarray, ...],
    seed: int,
) -> tuple[Found, Measurement]:
    """Return what was found as where noise is known, and the measurement with the noise found."""
    best = linear_model.linearization
    found = estimated(linear_model.state_vector, best.state, fit_covariance.state, seed)
    there = evaluate(found.state)
    whole = fit_covariance.residual + best.error_covariance
    off = there - measurement.values
    chi2 = float(off @ np.linalg.solve(whole, off))
    held = held_at(found.state, best.jacobian.T @ np.linalg.solve(whole, off))
    end = Optimum(found.state, there, best.jacobian, whole, chi2, chi2, held)
    own = np.sqrt(np.diag(best.error_covariance))
    curved = bent(evaluate, linear_model, found.state, found.posterior.covariance, whole)
    plain = Found([end], found.posterior, found.draws, 1.0, found.prior_tension, own, alternatives, curved)
    return plain, measurement._replace(covariance=fit_covariance.residual)
