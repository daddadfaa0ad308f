"""Draws from the posterior distribution by adaptive importance sampling.

States are drawn around the optima from a heavy-tailed mixture and weighted by their posterior
density.  The mixture is adapted to the weighted draws until the effective sample size suffices
(Bugallo et al. 2017, IEEE Signal Processing Magazine 34, 60).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.retrieval.forward_model import ForwardModel
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import MAPEstimate, summarize_posterior

N_DRAWS = 4000
STUDENT_T_DOF = 5.0
"""Degrees of freedom of Student's t, with tails heavier than those of the posterior."""
MIN_EFFECTIVE_DRAWS = 400.0
"""Effective sample size per optimum at which the adaptation stops."""
MAX_ITERATIONS = 6
DEFENSIVE_FRACTION = 0.1
"""Fraction of draws from the whole range, so that every part of it is sampled."""


class PosteriorDraws(NamedTuple):
    """Draws from a posterior.

    Attributes
    ----------
    states : float, shape (N_DRAWS, parameters)
        Coordinates, with equal weights.
    n_effective : float
        Effective sample size.
    """

    states: np.ndarray
    n_effective: float


class _MixtureComponent(NamedTuple):
    """Component of the proposal distribution: a multivariate Student's t."""

    centre: np.ndarray
    cholesky: np.ndarray

    @classmethod
    def from_covariance(cls, centre: np.ndarray, covariance: np.ndarray) -> _MixtureComponent:
        tiny = 1e-12 * np.eye(len(centre))
        return cls(centre, np.linalg.cholesky(covariance + tiny))

    def draw(self, random: np.random.Generator, n_draws: int) -> np.ndarray:
        normal = random.standard_normal((n_draws, len(self.centre)))
        scale = np.sqrt(STUDENT_T_DOF / random.chisquare(STUDENT_T_DOF, n_draws))[:, np.newaxis]
        states: np.ndarray = self.centre + scale * (normal @ self.cholesky.T)
        return states

    def compute_log_density(self, states: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density, up to a constant common to all components."""
        standardized = np.linalg.solve(self.cholesky, (states - self.centre).T)
        n_dimensions = len(self.centre)
        log_scale = np.log(np.diag(self.cholesky)).sum()
        log_density: np.ndarray = -log_scale - 0.5 * (STUDENT_T_DOF + n_dimensions) * np.log1p(
            (standardized**2).sum(axis=0) / STUDENT_T_DOF
        )
        return log_density


def draw_posterior(
    model: ForwardModel, measurement: Measurement, estimates: Sequence[MAPEstimate], seed: int
) -> PosteriorDraws:
    """Return draws from the posterior.

    Parameters
    ----------
    model : ForwardModel
    measurement : Measurement
    estimates : sequence of MAPEstimate
        Best first.  States use the error covariance of the nearest estimate.
    seed : int
    """
    random = np.random.default_rng([seed, 20])
    components = [
        _MixtureComponent.from_covariance(
            estimate.state, 1.5 * summarize_posterior(estimate, model.state_vector).covariance
        )
        for estimate in estimates
    ]
    constant = _compute_log_normalization(len(estimates[0].state))
    best = (0.0, np.zeros(0), np.zeros(0), components)
    for _ in range(MAX_ITERATIONS):
        states = _draw_mixture(components, random)
        is_inside = ((states >= 0.0) & (states <= 1.0)).all(axis=1)
        states = states[is_inside]
        log_proposal = np.logaddexp.reduce(
            [component.compute_log_density(states) for component in components], axis=0
        )
        log_proposal += constant - np.log(len(components)) + np.log1p(-DEFENSIVE_FRACTION)
        log_weight = _compute_log_posterior(model, measurement, states, estimates) - np.logaddexp(
            log_proposal, np.log(DEFENSIVE_FRACTION)
        )
        weights = np.exp(log_weight - log_weight.max())
        weights /= weights.sum()
        n_effective = float(1.0 / (weights**2).sum())
        if n_effective > best[0]:
            best = (n_effective, states, weights, components)
        if n_effective >= MIN_EFFECTIVE_DRAWS * len(estimates):
            break
        # Adapt to the best iteration so far.
        _, best_states, best_weights, best_components = best
        components = _update_components(best_states, best_weights, best_components)
    n_effective, states, weights, _ = best
    return PosteriorDraws(states[_resample_systematically(weights, random)], n_effective)


def _draw_mixture(
    components: Sequence[_MixtureComponent], random: np.random.Generator
) -> np.ndarray:
    """Return draws from all components, and some from the whole range."""
    uniform = random.random((int(DEFENSIVE_FRACTION * N_DRAWS), len(components[0].centre)))
    n_draws = (N_DRAWS - len(uniform)) // len(components)
    return np.concatenate([uniform, *(component.draw(random, n_draws) for component in components)])


def _compute_log_normalization(n_dimensions: int) -> float:
    """Return the logarithm of the normalization of Student's t."""
    from math import lgamma, log, pi

    return (
        lgamma(0.5 * (STUDENT_T_DOF + n_dimensions))
        - lgamma(0.5 * STUDENT_T_DOF)
        - 0.5 * n_dimensions * log(STUDENT_T_DOF * pi)
    )


def _compute_log_posterior(
    model: ForwardModel,
    measurement: Measurement,
    states: np.ndarray,
    estimates: Sequence[MAPEstimate],
) -> np.ndarray:
    """Return the logarithm of the posterior density, up to a constant."""
    residual = model.evaluate(states) - measurement.values
    nearest = np.argmin(
        [np.abs(states - estimate.state).max(axis=1) for estimate in estimates], axis=0
    )
    misfit = np.empty(len(states))
    for number, estimate in enumerate(estimates):
        rows = nearest == number
        cholesky = np.linalg.cholesky(estimate.error_covariance)
        squares = ((residual[rows] @ np.linalg.inv(cholesky).T) ** 2).sum(axis=1)
        misfit[rows] = squares + 2.0 * np.log(np.diag(cholesky)).sum()
    prior = ((states - model.state_vector.prior_mean) / model.state_vector.prior_sd) ** 2
    log_posterior: np.ndarray = -0.5 * (misfit + prior.sum(axis=1))
    return log_posterior


def _update_components(
    states: np.ndarray, weights: np.ndarray, components: Sequence[_MixtureComponent]
) -> list[_MixtureComponent]:
    """Return components adapted to weighted states, each assigned to its nearest component."""
    nearest = np.argmax([component.compute_log_density(states) for component in components], axis=0)
    updated = []
    for number, component in enumerate(components):
        own_weights = weights * (nearest == number)
        if own_weights.sum() < 1e-6:
            continue
        own_weights /= own_weights.sum()
        centre = own_weights @ states
        deviation = states - centre
        spread = (own_weights[:, np.newaxis] * deviation).T @ deviation
        n_effective = 1.0 / (own_weights**2).sum()
        # Few effective states do not determine a covariance, so the previous one is mixed in.
        kept_fraction = 1.0 / (1.0 + n_effective / (4.0 * len(centre)))
        previous = component.cholesky @ component.cholesky.T
        updated.append(
            _MixtureComponent.from_covariance(
                centre, (1.0 - kept_fraction) * 1.5 * spread + kept_fraction * 0.5 * previous
            )
        )
    return updated or list(components)


def _resample_systematically(weights: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return the rows drawn by systematic resampling."""
    positions = (np.arange(N_DRAWS) + random.random()) / N_DRAWS
    rows: np.ndarray = np.searchsorted(np.cumsum(weights), positions * weights.sum())
    return np.minimum(rows, len(weights) - 1)
