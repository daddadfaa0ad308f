"""The distribution of what is free, given a measurement: draws, whatever shape it has.

Importance sampling: places drawn around the optima by a wide distribution count by how probable
they are in truth, and the distribution is drawn anew from what was found, until enough of them
count (adaptive importance sampling; Bugallo et al. 2017, IEEE Signal Processing Magazine 34, 60).
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
"""Degrees of freedom of Student's t: tails heavier than any that is to be found."""
MIN_EFFECTIVE_DRAWS = 400.0
"""Effective number of draws."""
MAX_ITERATIONS = 6
DEFENSIVE_FRACTION = 0.1
"""Share of draws from the whole range, so that no part of it is overlooked for good."""


class PosteriorDraws(NamedTuple):
    """Draws from a posterior.

    Attributes
    ----------
    states : float, shape (DRAWS, parameters)
        Coordinates, equally probable.
    n_effective : float
        Number of independent draws that they are worth.
    """

    states: np.ndarray
    n_effective: float


class _MixtureComponent(NamedTuple):
    """A part of the distribution that is drawn from."""

    centre: np.ndarray
    cholesky: np.ndarray

    @classmethod
    def from_covariance(cls, centre: np.ndarray, covariance: np.ndarray) -> _MixtureComponent:
        tiny = 1e-12 * np.eye(len(centre))
        return cls(centre, np.linalg.cholesky(covariance + tiny))

    def draw(self, random: np.random.Generator, n_draws: int) -> np.ndarray:
        normal = random.standard_normal((n_draws, len(self.centre)))
        wide = np.sqrt(STUDENT_T_DOF / random.chisquare(STUDENT_T_DOF, n_draws))[:, np.newaxis]
        places: np.ndarray = self.centre + wide * (normal @ self.cholesky.T)
        return places

    def compute_log_density(self, states: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density, but for a constant that all parts share."""
        off = np.linalg.solve(self.cholesky, (states - self.centre).T)
        many = len(self.centre)
        scale = np.log(np.diag(self.cholesky)).sum()
        found: np.ndarray = -scale - 0.5 * (STUDENT_T_DOF + many) * np.log1p(
            (off**2).sum(axis=0) / STUDENT_T_DOF
        )
        return found


def draw_posterior(
    model: ForwardModel, measurement: Measurement, estimates: Sequence[MAPEstimate], seed: int
) -> PosteriorDraws:
    """Return draws from the posterior.

    Parameters
    ----------
    model : Model
    measurement : Measurement
    estimates : sequence of MAPEstimate
        Best first; the covariance of errors at a place is that at the nearest of them.
    seed : int
    """
    random = np.random.default_rng([seed, 20])
    parts = [
        _MixtureComponent.from_covariance(
            end.state, 1.5 * summarize_posterior(end, model.state_vector).covariance
        )
        for end in estimates
    ]
    constant = _compute_log_normalization(len(estimates[0].state))
    best = (0.0, np.zeros(0), np.zeros(0), parts)
    for _ in range(MAX_ITERATIONS):
        places = _draw_mixture(parts, random)
        inside = ((places >= 0.0) & (places <= 1.0)).all(axis=1)
        places = places[inside]
        height = np.logaddexp.reduce([part.compute_log_density(places) for part in parts], axis=0)
        height += constant - np.log(len(parts)) + np.log1p(-DEFENSIVE_FRACTION)
        log = _compute_log_posterior(model, measurement, places, estimates) - np.logaddexp(
            height, np.log(DEFENSIVE_FRACTION)
        )
        weight = np.exp(log - log.max())
        weight /= weight.sum()
        effective = float(1.0 / (weight**2).sum())
        if effective > best[0]:
            best = (effective, places, weight, parts)
        if effective >= MIN_EFFECTIVE_DRAWS:
            break
        # A round that was worse than one before tells less where to draw.
        _, known, weights, drawn = best
        parts = _update_components(known, weights, drawn)
    effective, places, weight, _ = best
    return PosteriorDraws(places[_resample_systematically(weight, random)], effective)


def _draw_mixture(
    components: Sequence[_MixtureComponent], random: np.random.Generator
) -> np.ndarray:
    """Return draws from all parts, and some from everywhere."""
    everywhere = random.random((int(DEFENSIVE_FRACTION * N_DRAWS), len(components[0].centre)))
    share = (N_DRAWS - len(everywhere)) // len(components)
    return np.concatenate([everywhere, *(part.draw(random, share) for part in components)])


def _compute_log_normalization(n_dimensions: int) -> float:
    """Return the logarithm of the constant of Student's t in so many dimensions."""
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
    """Return the logarithm of the posterior, but for a constant."""
    off = model.evaluate(states) - measurement.values
    nearest = np.argmin([np.abs(states - end.state).max(axis=1) for end in estimates], axis=0)
    misfit = np.empty(len(states))
    for number, end in enumerate(estimates):
        rows = nearest == number
        lower = np.linalg.cholesky(end.error_covariance)
        squares = (np.linalg.solve(lower, off[rows].T) ** 2).sum(axis=0)
        misfit[rows] = squares + 2.0 * np.log(np.diag(lower)).sum()
    prior = ((states - model.state_vector.prior_mean) / model.state_vector.prior_sd) ** 2
    found: np.ndarray = -0.5 * (misfit + prior.sum(axis=1))
    return found


def _update_components(
    states: np.ndarray, weights: np.ndarray, components: Sequence[_MixtureComponent]
) -> list[_MixtureComponent]:
    """Return parts around what was found, each place with the part that it is nearest to."""
    nearest = np.argmax([part.compute_log_density(states) for part in components], axis=0)
    found = []
    for number, part in enumerate(components):
        own = weights * (nearest == number)
        if own.sum() < 1e-6:
            continue
        own /= own.sum()
        centre = own @ states
        off = states - centre
        spread = (own[:, np.newaxis] * off).T @ off
        few = 1.0 / (own**2).sum()
        # A handful of places does not tell a covariance.
        keep = 1.0 / (1.0 + few / (4.0 * len(centre)))
        before = part.cholesky @ part.cholesky.T
        found.append(
            _MixtureComponent.from_covariance(
                centre, (1.0 - keep) * 1.5 * spread + keep * 0.5 * before
            )
        )
    return found or list(components)


def _resample_systematically(weights: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return rows as often as they weigh, with as little chance as can be."""
    at = (np.arange(N_DRAWS) + random.random()) / N_DRAWS
    rows: np.ndarray = np.searchsorted(np.cumsum(weights), at * weights.sum())
    return np.minimum(rows, len(weights) - 1)
