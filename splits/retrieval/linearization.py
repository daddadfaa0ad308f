"""Linearized forward model: noise of its Jacobians, and its nonlinearity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from splits.retrieval.residual_covariance import average_cross_products
from splits.retrieval.state_vector import StateVector

RANGE_INFORMATION = 12.0
"""Fisher information of a coordinate equal to that of its range."""
MIN_SIGNAL_TO_NOISE, CERTAIN_SIGNAL_TO_NOISE = 6.0, 10.0
"""Ratios of information to that of noise: to be significant, and to need no further Jacobians.

The ratio plus one is that of an F test: for six Jacobians with noise in three independent parts of
the spectrum, it exceeds 7 by chance in one case of 300.
"""
BOUND_MARGIN = 1e-3
"""Distance of coordinates from the bounds, where derivatives may be infinite."""


class Linearization(NamedTuple):
    """Value and Jacobian of a forward model at one state.

    Attributes
    ----------
    state : float, shape (parameters,)
        Coordinates.
    modelled : float, shape (n,)
        Modelled measurement.
    jacobian : float, shape (n, parameters)
    error_covariance : float, shape (n, n)
        Covariance of the forward-model error.
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
        """Return modelled measurements, shape (states, n)."""
        modelled: np.ndarray = (
            self.linearization.modelled
            + (states - self.linearization.state) @ self.linearization.jacobian.T
        )
        return modelled

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and its Jacobian, shape (n, parameters)."""
        return self.evaluate(state[np.newaxis])[0], self.linearization.jacobian

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the forward-model error, shape (n, n)."""
        return self.linearization.error_covariance

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of the linearization, and its modelled measurement."""
        return self.linearization.state[np.newaxis], self.linearization.modelled[np.newaxis]


def estimate_nonlinearity(
    evaluate: Callable[[np.ndarray], np.ndarray],
    linear_model: LinearizedModel,
    state: np.ndarray,
    covariance: np.ndarray,
    error_covariance: np.ndarray,
) -> float:
    """Return the largest deviation from linearity one standard deviation away, in units of noise.

    Parameters
    ----------
    evaluate : callable
        From a state to the modelled measurement, shape (n,).
    linear_model : LinearizedModel
    state : float, shape (parameters,)
        Most probable state.
    covariance : float, shape (parameters, parameters)
        Posterior covariance of the coordinates, along whose principal axes steps are taken.
    error_covariance : float, shape (n, n)
        Covariance of measurement and model.
    """
    variances, axes = np.linalg.eigh(covariance)
    cholesky = np.linalg.cholesky(error_covariance)
    largest = 0.0
    for step in np.concatenate([np.sqrt(variances) * axes, -np.sqrt(variances) * axes], axis=1).T:
        shifted = np.clip(state + step, BOUND_MARGIN, 1.0 - BOUND_MARGIN)
        deviation = evaluate(shifted) - linear_model.evaluate(shifted[np.newaxis])[0]
        largest = max(largest, float(np.linalg.norm(np.linalg.solve(cholesky, deviation))))
    return largest


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
    values, vectors, noise = _decompose_information(jacobians, error_covariance)
    mean: np.ndarray = np.mean(jacobians, axis=0)
    root = (
        vectors * np.sqrt(np.where(values > MIN_SIGNAL_TO_NOISE * noise, values, 0.0))
    ) @ vectors.T
    eigenvalues, axes = np.linalg.eigh(mean.T @ np.linalg.solve(error_covariance, mean))
    is_positive = eigenvalues > 1e-12 * max(eigenvalues[-1], 1e-300)
    inverse = (axes[:, is_positive] / np.sqrt(eigenvalues[is_positive])) @ axes[:, is_positive].T
    jacobian: np.ndarray = mean @ inverse @ root
    return jacobian


def is_jacobian_noisy(jacobians: Sequence[np.ndarray], error_covariance: np.ndarray) -> bool:
    """Return whether noise of the Jacobians may decide which parameters are constrained."""
    values, _, noise = _decompose_information(jacobians, error_covariance)
    return bool(
        ((values + noise > RANGE_INFORMATION) & (values < CERTAIN_SIGNAL_TO_NOISE * noise)).any()
    )


def _decompose_information(
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
