"""Maximum-a-posteriori estimates, and the information content of a measurement (Rodgers 2000).

Rodgers, C. D. (2000), Inverse Methods for Atmospheric Sounding, World Scientific; chapters 2 to 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.retrieval.forward_model import ForwardModel
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector

N_STARTS = 4
"""Number of descents, from the first guesses with the smallest misfit."""
MAX_COVARIANCE_UPDATES = 3
"""Largest number of descents with an updated covariance of the forward-model error."""
TOLERANCE = 1e-6
"""Relative change of coordinates, or of the sum of squares, at which a descent ends."""
MIN_SEPARATION = 0.05
"""Smallest distance between the coordinates of distinct estimates."""
ALTERNATIVE_CHI2 = 9.0
"""Largest excess of the sum of squares of an alternative solution."""
BOUND_TOLERANCE = 2e-3
"""Distance of coordinates from a bound within which it may be active."""


class MAPEstimate(NamedTuple):
    """Maximum-a-posteriori estimate.

    Attributes
    ----------
    state : float, shape (parameters,)
    modelled : float, shape (n,)
        Modelled measurement at the state.
    jacobian : float, shape (n, parameters)
    error_covariance : float, shape (n, n)
        Covariance of measurement and model errors.
    cost : float
        Sum of squares of measurement and priors.
    chi2 : float
        Sum of squares of the measurement only.
    active_bounds : bool, shape (parameters,)
        Coordinates held at a bound of their range.
    """

    state: np.ndarray
    modelled: np.ndarray
    jacobian: np.ndarray
    error_covariance: np.ndarray
    cost: float
    chi2: float
    active_bounds: np.ndarray

    @property
    def minus_two_log_posterior(self) -> float:
        """Twice the negative logarithm of the posterior density, up to a constant.

        It includes the determinant of the covariance, which depends on the state.
        """
        return self.cost + float(np.linalg.slogdet(self.error_covariance)[1])


class PosteriorSummary(NamedTuple):
    """Information content of a measurement near an optimum.

    Attributes
    ----------
    covariance : float, shape (parameters, parameters)
        Posterior covariance of the coordinates.
    averaging_kernel : float, shape (parameters, parameters)
    degrees_of_freedom : float
        Degrees of freedom for signal, the trace of the averaging kernel.
    information_bits : float
    """

    covariance: np.ndarray
    averaging_kernel: np.ndarray
    degrees_of_freedom: float
    information_bits: float


def find_map_estimate(
    model: ForwardModel,
    measurement: Measurement,
    start: np.ndarray,
    variance_inflation: float = 1.0,
) -> MAPEstimate:
    """Return the maximum-a-posteriori estimate found by a descent from a start.

    Parameters
    ----------
    model : ForwardModel
    measurement : Measurement
    start : float, shape (parameters,)
        Coordinates.
    variance_inflation : float
        Factor of all variances.
    """
    from scipy.optimize import least_squares

    state_vector = model.state_vector
    has_prior = np.isfinite(state_vector.prior_sd)
    prior_jacobian = np.diag(1.0 / state_vector.prior_sd)[has_prior]
    state = np.clip(start, 1e-6, 1.0 - 1e-6)
    for _ in range(MAX_COVARIANCE_UPDATES):
        covariance = variance_inflation * (
            measurement.covariance + model.compute_error_covariance(state)
        )
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))

        def residuals(coordinates: np.ndarray, whiten: np.ndarray = whiten) -> np.ndarray:
            values, _ = model.evaluate_with_jacobian(coordinates)
            residual = whiten @ (values - measurement.values)
            prior = (coordinates - state_vector.prior_mean)[has_prior] / state_vector.prior_sd[
                has_prior
            ]
            return np.concatenate([residual, prior])

        def compute_jacobian(coordinates: np.ndarray, whiten: np.ndarray = whiten) -> np.ndarray:
            _, jacobian = model.evaluate_with_jacobian(coordinates)
            return np.vstack([whiten @ jacobian, prior_jacobian])

        optimum = least_squares(
            residuals, state, compute_jacobian, bounds=(0.0, 1.0), xtol=TOLERANCE, ftol=TOLERANCE
        )
        step = float(np.abs(optimum.x - state).max())
        state = np.clip(optimum.x, 1e-9, 1.0 - 1e-9)
        if step < 1e-3:
            break
    covariance = variance_inflation * (
        measurement.covariance + model.compute_error_covariance(state)
    )
    values, jacobian = model.evaluate_with_jacobian(state)
    residual = values - measurement.values
    weighted_residual = np.linalg.solve(covariance, residual)
    chi2 = float(residual @ weighted_residual)
    prior_residual = (state - state_vector.prior_mean) / state_vector.prior_sd
    active_bounds = find_active_bounds(
        state, jacobian.T @ weighted_residual + prior_residual / state_vector.prior_sd
    )
    return MAPEstimate(
        state,
        values,
        jacobian,
        covariance,
        chi2 + float(prior_residual @ prior_residual),
        chi2,
        active_bounds,
    )


def find_active_bounds(state: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return which coordinates are at a bound outside which the sum of squares decreases."""
    is_active: np.ndarray = ((state < BOUND_TOLERANCE) & (gradient > 0.0)) | (
        (state > 1.0 - BOUND_TOLERANCE) & (gradient < 0.0)
    )
    return is_active


def find_distinct_map_estimates(
    model: ForwardModel,
    measurement: Measurement,
    first_guesses: np.ndarray,
    modelled: np.ndarray,
    variance_inflation: float = 1.0,
) -> list[MAPEstimate]:
    """Return the distinct estimates of several descents, best first.

    Parameters
    ----------
    first_guesses : float, shape (guesses, parameters)
        Candidate starts, from the whole range.
    modelled : float, shape (guesses, n)
        Their modelled measurements.
    variance_inflation : float
        Factor of all variances.
    """
    spread = np.sqrt(np.diag(measurement.covariance))
    misfit = (((modelled - measurement.values) / spread) ** 2).sum(axis=1)
    prior = (
        ((first_guesses - model.state_vector.prior_mean) / model.state_vector.prior_sd) ** 2
    ).sum(axis=1)
    starts: list[np.ndarray] = []
    for row in np.argsort(misfit + prior, kind="stable"):
        if all(np.abs(first_guesses[row] - other).max() > 0.2 for other in starts):
            starts.append(first_guesses[row])
        if len(starts) == N_STARTS:
            break
    estimates = [
        find_map_estimate(model, measurement, start, variance_inflation) for start in starts
    ]
    estimates.sort(key=lambda estimate: estimate.minus_two_log_posterior)
    distinct = estimates[:1]
    for estimate in estimates[1:]:
        is_separated = all(
            np.abs(estimate.state - accepted.state).max() > MIN_SEPARATION for accepted in distinct
        )
        if (
            is_separated
            and estimate.minus_two_log_posterior
            < distinct[0].minus_two_log_posterior + ALTERNATIVE_CHI2
        ):
            distinct.append(estimate)
    return distinct


def summarize_posterior(estimate: MAPEstimate, state_vector: StateVector) -> PosteriorSummary:
    """Return the information content near an optimum (Rodgers 2000, Eqs 2.27, 2.78, 2.80)."""
    fisher = estimate.jacobian.T @ np.linalg.solve(estimate.error_covariance, estimate.jacobian)
    prior_precision = np.diag(1.0 / state_vector.prior_variance)
    posterior_covariance = np.linalg.inv(fisher + prior_precision)
    kernel = posterior_covariance @ fisher
    scaled = np.eye(len(fisher)) + fisher * state_vector.prior_variance[:, np.newaxis]
    information_bits = 0.5 * float(np.linalg.slogdet(scaled)[1]) / float(np.log(2.0))
    return PosteriorSummary(posterior_covariance, kernel, float(np.trace(kernel)), information_bits)


def compute_fit_degrees_of_freedom(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return the degrees of freedom used by a fit: the trace over coordinates not at a bound."""
    is_free = ~estimate.active_bounds
    jacobian = estimate.jacobian[:, is_free]
    fisher = jacobian.T @ np.linalg.solve(estimate.error_covariance, jacobian)
    prior_precision = np.diag(1.0 / state_vector.prior_variance[is_free])
    return float(np.trace(np.linalg.solve(fisher + prior_precision, fisher)))
