"""The place that comes nearest to a measurement, by runs: a survey, then descents by stages.

All runs of a stage share their random numbers, so that what they say is a smooth function of the
place, bent a little towards the noise of that stage.  Later stages take more rays, and where the
runs say so other numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from splits.core.optional import import_optional
from splits.retrieval.state_vector import StateVector

INITIAL_RADIUS = 0.3
"""Half the edge of the first trust region."""
MIN_RADIUS = 0.02
MIN_RELATIVE_GAIN = 0.003
"""A descent ends once its trust region, or the relative gain foretold, falls below these."""
MIN_GAIN_PER_VALUE = 0.1
"""Nor may the gain be more than this part of the mean square: a third of a standard error."""
MIN_START_SEPARATION = 0.2
"""Distance of coordinates from which starts are different."""


class StagedForwardModel(Protocol):
    """Runs of a medium at places of the unit cube.

    Attributes
    ----------
    state_vector : StateVector
    bound_margin : float
        Places stay so far away from the ends.
    """

    state_vector: StateVector
    bound_margin: float

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return what would be measured, shape (n,), with the random numbers of a stage."""
        ...

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return its derivatives to the coordinates, shape (n, parameters)."""
        ...


class DescentStage(NamedTuple):
    """A stage of descents.

    Attributes
    ----------
    n_starts : int
        Descents at most, from the best places of the stage before.
    max_evaluations : int
        Runs that each may take, about; derivatives count as one for each coordinate.
    max_cost_increase : float
        By how much more than the best a sum of squares may be for a place to be one of these.
    """

    n_starts: int
    max_evaluations: int
    max_cost_increase: float = np.inf


class Objective(NamedTuple):
    """What runs are held against.

    Attributes
    ----------
    measured : float, shape (n,)
    cholesky : float, shape (n, n)
        Lower triangle of the covariance of errors.
    state_vector : StateVector
        With the priors that count.
    """

    measured: np.ndarray
    cholesky: np.ndarray
    state_vector: StateVector

    @classmethod
    def least_squares(cls, measured: np.ndarray, state_vector: StateVector) -> Objective:
        """Return the aim of a misfit as small as can be, where nothing is known of noise."""
        return cls(measured, np.eye(len(measured)), state_vector)

    def compute_residuals(self, modelled: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return how far values and the place are off, in standard deviations."""
        free = self.state_vector
        known = np.isfinite(free.prior_sd)
        prior = (state - free.prior_mean)[known] / free.prior_sd[known]
        return np.concatenate([np.linalg.solve(self.cholesky, modelled - self.measured), prior])

    def compute_residual_jacobian(self, jacobian: np.ndarray) -> np.ndarray:
        """Return the derivatives of `compute_residuals` to the coordinates."""
        pull = np.diag(1.0 / self.state_vector.prior_sd)[np.isfinite(self.state_vector.prior_sd)]
        return np.vstack([np.linalg.solve(self.cholesky, jacobian), pull])


class LocalMinimum(NamedTuple):
    """Where a descent ended, and the sum of squares there."""

    cost: float
    state: np.ndarray


def search_minima(
    model: StagedForwardModel,
    make_objective: Callable[[np.ndarray, int], Objective],
    survey_states: np.ndarray,
    stages: Sequence[DescentStage],
    log: Callable[[int, float], None] = lambda stage, cost: None,
) -> list[list[LocalMinimum]]:
    """Return where the descents of every stage ended, best first.

    Parameters
    ----------
    model : StagedForwardModel
    make_objective : callable
        What counts near a place, at a stage.
    survey_states : float, shape (many, parameters)
        Of the survey, which is stage 0.
    stages : sequence of DescentStage
    log : callable
        Receives the number of every stage that begins, from 1 on, and the least sum of squares.
    """
    survey_states = np.clip(survey_states, model.bound_margin, 1.0 - model.bound_margin)
    first = make_objective(survey_states[0], 0)
    found = [
        LocalMinimum(_sum_squares(first.compute_residuals(model.evaluate(x, 0), x)), x)
        for x in survey_states
    ]
    ends: list[list[LocalMinimum]] = []
    for number, stage in enumerate(stages, 1):
        found = _select_distinct(found, stage, MIN_START_SEPARATION if number == 1 else 0.0)
        log(number, found[0].cost)
        # A later stage begins near its goal: it may trust its linear model less far.
        radius = INITIAL_RADIUS / 2 ** (number - 1)
        near = make_objective(found[0].state, number)
        found = [
            minimize_gauss_newton(model, number, end.state, near, stage.max_evaluations, radius)
            for end in found
        ]
        found.sort(key=lambda end: end.cost)
        ends.append(found)
    return ends


def _select_distinct(
    minima: Sequence[LocalMinimum], stage: DescentStage, min_separation: float
) -> list[LocalMinimum]:
    """Return the best of so many ends that are apart."""
    kept: list[LocalMinimum] = []
    for end in sorted(minima, key=lambda end: end.cost):
        if len(kept) == stage.n_starts or (
            kept and end.cost > kept[0].cost + stage.max_cost_increase
        ):
            break
        if all(np.abs(end.state - one.state).max() > min_separation for one in kept):
            kept.append(end)
    return kept


def minimize_gauss_newton(
    model: StagedForwardModel,
    stage: int,
    start: np.ndarray,
    objective: Objective,
    max_evaluations: int,
    radius: float,
) -> LocalMinimum:
    """Return the nearest place found, by Gauss-Newton steps in a box.

    Every step minimises the linear model within the unit cube and a trust region around the best
    place so far.  Derivatives are updated after Broyden (1965) as long as they foretell the
    misfit, because runs cost the same as what they save.

    Parameters
    ----------
    model : StagedForwardModel
    stage : int
    start : float, shape (parameters,)
    objective : Aim
    max_evaluations : int
    radius : float
        Half the edge of the first trust region, 0 to 1.
    """
    lsq_linear = import_optional("scipy.optimize", "retrieval", "retrievals need").lsq_linear

    least, most = model.bound_margin, 1.0 - model.bound_margin
    x = np.clip(start, least, most)
    off = objective.compute_residuals(model.evaluate(x, stage), x)
    best = _sum_squares(off)
    used, stale = 1, True
    slopes = np.empty((len(off), len(x)))
    while used < max_evaluations and radius >= MIN_RADIUS:
        fresh = stale
        if stale:
            slopes = objective.compute_residual_jacobian(model.compute_jacobian(x, stage))
            used += len(x)
            stale = False
        low, high = np.maximum(least - x, -radius), np.minimum(most - x, radius)
        step = lsq_linear(slopes, -off, (low - 1e-9, high + 1e-9)).x
        step = np.clip(x + step, least, most) - x
        foretold = best - _sum_squares(off + slopes @ step)
        if foretold < best * min(MIN_RELATIVE_GAIN, MIN_GAIN_PER_VALUE / len(off)):
            if fresh:
                break
            stale = True
            continue
        there = objective.compute_residuals(model.evaluate(x + step, stage), x + step)
        used += 1
        gained = best - _sum_squares(there)
        slopes += np.outer(there - off - slopes @ step, step) / (step @ step)
        if gained < 0.25 * foretold:
            radius *= 0.5
        elif gained > 0.75 * foretold:
            radius = min(2.0 * radius, 0.5)
        stale = gained < 0.5 * foretold and not (fresh and gained <= 0.0)
        if gained > 0.0:
            x, off, best = x + step, there, best - gained
    return LocalMinimum(best, x)


def _sum_squares(residuals: np.ndarray) -> float:
    return float(residuals @ residuals)
