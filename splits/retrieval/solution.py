"""Solution of a retrieval: estimates, posterior and draws, and the warnings about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MIN_SEPARATION,
    MAPEstimate,
    PosteriorSummary,
    compute_fit_degrees_of_freedom,
)
from splits.retrieval.posterior import MIN_EFFECTIVE_DRAWS, PosteriorDraws
from splits.retrieval.state_vector import StateVector

MIN_MISFIT_PROBABILITY = 0.01
"""Probability of the misfit below which the model does not fit the measurement."""
BOUND_DISTANCE = 0.01
"""Distance of a coordinate from a bound below which a value lies at it."""
MAX_NONLINEARITY = 1.0
"""Deviation of linear or interpolated reflectances, in units of noise, which is reported."""
MAX_PRIOR_TENSION = 3.0
"""Standard deviations between prior and result above which they disagree."""


class Solution(NamedTuple):
    """Solution of a retrieval.

    Attributes
    ----------
    estimates : sequence of MAPEstimate
        Best first.
    posterior : PosteriorSummary
    draws : PosteriorDraws
    variance_inflation : float
        Factor of all variances that makes the misfit plausible.
    prior_tension : float, shape (parameters,)
        Distance of the priors from the result without them, in standard errors.
    forward_model_error : float, shape (n,)
        Standard errors of the table, or of simulations, at the best estimate.
    alternatives : tuple of float, shape (parameters,)
        Coordinates of alternative solutions.
    nonlinearity : float
        Deviation of linear or interpolated reflectances from the model, in units of noise.
    """

    estimates: Sequence[MAPEstimate]
    posterior: PosteriorSummary
    draws: PosteriorDraws
    variance_inflation: float
    prior_tension: np.ndarray
    forward_model_error: np.ndarray
    alternatives: tuple[np.ndarray, ...] = ()
    nonlinearity: float = 0.0


def compute_prior_tension(
    state_vector: StateVector, state: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """Return the distance of the priors from a result without them, in standard errors."""
    tension: np.ndarray = np.abs(state - state_vector.prior_mean) / np.sqrt(
        state_vector.prior_sd**2 + variance
    )
    return tension


def compute_variance_inflation(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return the factor of all variances that makes the misfit plausible."""
    from scipy.stats import chi2

    n_dof = max(
        len(estimate.modelled) - compute_fit_degrees_of_freedom(estimate, state_vector), 1.0
    )
    if chi2.sf(estimate.chi2, n_dof) > MIN_MISFIT_PROBABILITY:
        return 1.0
    return estimate.chi2 / n_dof


def list_warnings(
    state_vector: StateVector, solution: Solution, constrained: np.ndarray
) -> list[str]:
    """Return the warnings about a result."""
    estimates, _, draws, variance_inflation, tension, *_ = solution
    best, warnings = estimates[0], []
    if variance_inflation > 1.0:
        warnings.append(
            f"the model does not fit the measurement within its noise: errors are multiplied by "
            f"{np.sqrt(variance_inflation):.3g}, and may still be too small"
        )
    unconstrained = [
        name
        for name, is_constrained in zip(state_vector.names, constrained, strict=True)
        if not is_constrained
    ]
    if unconstrained:
        warnings.append(f"not constrained by the measurement: {', '.join(unconstrained)}")
    for name, tension_sigma in zip(state_vector.names, tension, strict=True):
        if tension_sigma > MAX_PRIOR_TENSION:
            warnings.append(
                f"{name}: prior and measurement are {tension_sigma:.1f} standard deviations apart"
            )
    for i, name in enumerate(state_vector.names):
        low, high = (
            float(state_vector.to_physical(np.full(len(state_vector.names), x))[i])
            for x in (0.0, 1.0)
        )
        if not (constrained[i] or best.active_bounds[i]):
            continue
        if best.state[i] < BOUND_DISTANCE and low != 0.0:
            warnings.append(f"{name} lies at the low end of its range, {low:g}")
        if best.state[i] > 1.0 - BOUND_DISTANCE:
            warnings.append(f"{name} lies at the high end of its range, {high:g}")
    warnings += _list_alternatives(state_vector, solution)
    if solution.nonlinearity > MAX_NONLINEARITY:
        warnings.append(
            "errors are approximate: they use linear or interpolated reflectances, which deviate "
            f"from those of the model by up to {solution.nonlinearity:.1f} times the noise"
        )
    if draws.n_effective < MIN_EFFECTIVE_DRAWS:
        warnings.append(f"quantiles are imprecise: {draws.n_effective:.0f} effective draws")
    return warnings


def _list_alternatives(state_vector: StateVector, solution: Solution) -> list[str]:
    """Return the warnings about distinct alternative solutions."""
    best, *others = (estimate.state for estimate in solution.estimates)
    listed, warnings = [best], []
    for alternative in [*others[:1], *solution.alternatives]:
        difference = alternative - best
        is_within_error = (
            difference @ np.linalg.solve(solution.posterior.covariance, difference)
            < ALTERNATIVE_CHI2
        )
        distances = [np.abs(alternative - state).max() for state in listed]
        if is_within_error or min(distances) < MIN_SEPARATION:
            continue
        listed.append(alternative)
        is_near = np.abs(solution.draws.states - alternative).max(axis=1) < 0.5 * distances[0]
        coverage = "" if is_near.any() else ", but draws do not cover it"
        values = [
            f"{parameter} {value:.3g}"
            for parameter, value in zip(
                state_vector.names, state_vector.to_physical(alternative), strict=True
            )
        ]
        warnings.append(
            f"an alternative solution fits nearly as well{coverage}: {', '.join(values)}"
        )
    return warnings
