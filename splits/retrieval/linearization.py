"""A measurement as a straight line through one place has it: its slopes, how far light is off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splits.retrieval.residual_covariance import average_cross_products
from splits.retrieval.state_vector import StateVector

RANGE_INFORMATION = 12.0
"""Information that says as much as the range does."""
MIN_SIGNAL_TO_NOISE, CERTAIN_SIGNAL_TO_NOISE = 6.0, 10.0
"""How many times what noise feigns it must be to count, and to need no more Jacobians.

One more than this is the ratio of an F test: of six Jacobians with noise in three parts of the
spectrum, one in 300 that tell nothing exceeds 7.
"""
BOUND_MARGIN = 1e-3
"""At the very ends of ranges slopes may be infinite."""


class Linearization(NamedTuple):
    """A medium that was looked at.

    Attributes
    ----------
    state : float, shape (parameters,)
        Coordinates.
    modelled : float, shape (n,)
        What would be measured.
    jacobian : float, shape (n, parameters)
    error_covariance : float, shape (n, n)
        Of what the model itself is off by.
    """

    state: np.ndarray
    modelled: np.ndarray
    jacobian: np.ndarray
    error_covariance: np.ndarray


class LinearizedModel:
    """Forward model linearized about one state; see `splits.retrieval.forward_model`."""

    def __init__(self, state_vector: StateVector, linearization: Linearization) -> None:
        self.state_vector, self.linearization = state_vector, linearization

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        found: np.ndarray = (
            self.linearization.modelled
            + (states - self.linearization.state) @ self.linearization.jacobian.T
        )
        return found

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        return self.evaluate(state[np.newaxis])[0], self.linearization.jacobian

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of what the model is off by, shape (n, n)."""
        return self.linearization.error_covariance

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where descents begin, and what would be measured there."""
        return self.linearization.state[np.newaxis], self.linearization.modelled[np.newaxis]


def estimate_nonlinearity(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    state: np.ndarray,
    covariance: np.ndarray,
    error_covariance: np.ndarray,
) -> float:
    """Return how far light is off a straight line, a standard deviation away, in its noise.

    Parameters
    ----------
    evaluate : callable
        What would be measured at a place, shape (n,).
    linear_model : LinearizedModel
    state : float, shape (parameters,)
        The most probable one.
    covariance : float, shape (parameters, parameters)
        Of coordinates, after; all of its axes are looked along.
    error_covariance : float, shape (n, n)
        Covariance of measurement and model.
    """
    sizes, ways = np.linalg.eigh(covariance)
    lower = np.linalg.cholesky(error_covariance)
    most = 0.0
    for step in np.concatenate([np.sqrt(sizes) * ways, -np.sqrt(sizes) * ways], axis=1).T:
        there = np.clip(state + step, BOUND_MARGIN, 1.0 - BOUND_MARGIN)
        off = evaluate(there) - linear_model.evaluate(there[np.newaxis])[0]
        most = max(most, float(np.linalg.norm(np.linalg.solve(lower, off))))
    return most


def remove_jacobian_noise(
    jacobians: Sequence[np.ndarray], error_covariance: np.ndarray
) -> np.ndarray:
    """Return slopes that tell as much as independent Jacobians do, less what their noise feigns.

    The mean of the Jacobians is K, with the information M = Kᵀ S⁻¹ K in it.  Products of different
    ones give F, which noise does not enlarge on average.  K M^(-1/2) F^(1/2) has this information.

    Parameters
    ----------
    jacobians : sequence of float, shape (n, parameters)
        Two at least.
    error_covariance : float, shape (n, n)
        Covariance S of measurement and model.
    """
    values, vectors, feigned = _decompose_information(jacobians, error_covariance)
    mean: np.ndarray = np.mean(jacobians, axis=0)
    root = (
        vectors * np.sqrt(np.where(values > MIN_SIGNAL_TO_NOISE * feigned, values, 0.0))
    ) @ vectors.T
    sizes, axes = np.linalg.eigh(mean.T @ np.linalg.solve(error_covariance, mean))
    some = sizes > 1e-12 * max(sizes[-1], 1e-300)
    inverse = (axes[:, some] / np.sqrt(sizes[some])) @ axes[:, some].T
    found: np.ndarray = mean @ inverse @ root
    return found


def is_jacobian_noisy(jacobians: Sequence[np.ndarray], error_covariance: np.ndarray) -> bool:
    """Return whether noise of the Jacobians may decide what counts as told."""
    values, _, feigned = _decompose_information(jacobians, error_covariance)
    return bool(
        (
            (values + feigned > RANGE_INFORMATION) & (values < CERTAIN_SIGNAL_TO_NOISE * feigned)
        ).any()
    )


def _decompose_information(
    jacobians: Sequence[np.ndarray], error_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return information along its axes, these axes, and what noise feigns along them in a mean."""
    lower = np.linalg.cholesky(error_covariance)
    white = [np.linalg.solve(lower, one) for one in jacobians]
    values, vectors = np.linalg.eigh(average_cross_products(white, white))
    both = np.mean([((one @ vectors) ** 2).sum(axis=0) for one in white], axis=0)
    return values, vectors, np.maximum(both - values, 0.0) / len(jacobians)
