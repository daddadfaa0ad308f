"""Retrieval with unknown measurement noise: least squares with errors estimated from the misfit.

The state of smallest misfit, with the covariance from the misfit, is used as a measurement of the
coordinates.  Ranges, priors and the posterior then follow as for known noise.  The residual of an
imperfect model is smooth along the spectrum, so neighbouring values are correlated and carry little
independent information.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.core.validation import invalid
from splits.retrieval.forward_model import LinearizedModel, TableForwardModel, drop_priors
from splits.retrieval.linearization import (
    average_cross_products,
    decompose_information,
    estimate_nonlinearity,
)
from splits.retrieval.measurement import Measurement
from splits.retrieval.medium_model import ConvergedMinima, MediumForwardModel
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAPEstimate,
    Solution,
    find_active_bounds,
    find_distinct_map_estimates,
    solve_for_known_noise,
)
from splits.retrieval.state_vector import StateVector

NEIGHBOUR_CORRELATIONS = np.linspace(0.0, 0.98, 50)
"""Candidate correlations between neighbouring wavelengths."""
MIN_RESIDUAL_DOF = 2
"""Smallest excess of the number of values over the number of parameters."""
_UNCONSTRAINED_VARIANCE = 100.0
"""Variance of unconstrained directions, far larger than the range of coordinates."""


def estimate_misfit_variances(misfit: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the variance of a misfit, split over `NEIGHBOUR_CORRELATIONS`.

    The misfit is modelled as a first-order autoregressive series minus its projection on the fit.
    A short spectrum does not determine the correlation, so every candidate is weighted by its
    restricted likelihood.

    Parameters
    ----------
    misfit : float, shape (wavelengths,)
        Model minus measurement, not all 0.
    jacobian : float, shape (wavelengths, columns)
        Fitted directions of the spectrum, fewer columns than wavelengths.

    References
    ----------
    Harville (1974), Biometrika 61, 383-385.
    """
    columns = np.linalg.qr(jacobian)[0]
    n_dof = len(misfit) - columns.shape[1]
    squares, likelihood = np.empty((2, len(NEIGHBOUR_CORRELATIONS)))
    for i, correlation in enumerate(NEIGHBOUR_CORRELATIONS):
        weighted = _apply_inverse_correlation(columns, correlation)
        inner, outer = columns.T @ weighted, weighted.T @ misfit
        square = misfit @ _apply_inverse_correlation(misfit, correlation) - outer @ np.linalg.solve(
            inner, outer
        )
        squares[i] = max(square, np.finfo(float).tiny)
        likelihood[i] = -np.linalg.slogdet(inner)[1] - (len(misfit) - 1) * np.log(
            1.0 - correlation**2
        )
    likelihood = 0.5 * (likelihood - n_dof * np.log(squares))
    weights = np.exp(likelihood - likelihood.max())
    return weights / weights.sum() * squares / n_dof


def _apply_inverse_correlation(series: np.ndarray, correlation: float) -> np.ndarray:
    """Return the product of the inverse autoregressive correlation matrix and a series."""
    product = (1.0 + correlation**2) * series
    product[[0, -1]] -= correlation**2 * series[[0, -1]]
    product[1:] -= correlation * series[:-1]
    product[:-1] -= correlation * series[1:]
    return product / (1.0 - correlation**2)


def make_autoregressive_covariance(variances: np.ndarray, n_wavelengths: int) -> np.ndarray:
    """Return the covariance matrix of residuals from `estimate_misfit_variances`."""
    lags = np.arange(n_wavelengths)
    autocovariance = (variances[:, np.newaxis] * NEIGHBOUR_CORRELATIONS[:, np.newaxis] ** lags).sum(
        axis=0
    )
    return autocovariance[np.abs(lags[:, np.newaxis] - lags)]


def estimate_fit_covariance(
    jacobians: Sequence[np.ndarray],
    misfit: np.ndarray,
    noise_covariance: np.ndarray,
    active_bounds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariances of the coordinates of a least-squares fit and of its residuals.

    They are estimated from the misfit.

    Noise in a Jacobian would appear as information on coordinates without effect.  Products of
    different, independent Jacobians have no such bias.  Directions whose effect is below the misfit
    of a wavelength, or below that noise, count as unconstrained.

    Parameters
    ----------
    jacobians : sequence of float, shape (wavelengths, coordinates)
        At least two independent Jacobians.
    misfit : float, shape (wavelengths,)
        Model minus measurement, see `estimate_misfit_variances`.
    noise_covariance : float, shape (wavelengths, wavelengths)
        Covariance of the noise of simulations.  All simulations of a fit share their random
        numbers, so this noise shifts the minimum.
    active_bounds : bool, shape (coordinates,)
        Coordinates at an active bound, which do not reduce the misfit.
    """
    scale, unconstrained = _split_directions(jacobians, misfit)
    scaled = [jacobian @ scale for jacobian in jacobians]
    free_jacobians = [jacobian[:, ~active_bounds] for jacobian in jacobians]
    fitted_directions = np.mean(
        [jacobian @ _split_directions(free_jacobians, misfit)[0] for jacobian in free_jacobians],
        axis=0,
    )
    variances = estimate_misfit_variances(misfit, fitted_directions)
    residual_covariance = make_autoregressive_covariance(variances, len(misfit))
    spread = average_cross_products(
        scaled, [(residual_covariance + noise_covariance) @ column_set for column_set in scaled]
    )
    # The variance is at least that of the same number of independent wavelengths.
    eigenvalues, axes = np.linalg.eigh(spread)
    spread = (axes * np.maximum(eigenvalues, variances.sum())) @ axes.T
    covariance = scale @ spread @ scale.T
    covariance = covariance + _UNCONSTRAINED_VARIANCE * unconstrained @ unconstrained.T
    return covariance, residual_covariance


def _split_directions(
    jacobians: Sequence[np.ndarray], misfit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return constrained directions, scaled to unit effect, and unconstrained ones, as columns."""
    values, vectors, noise = decompose_information(jacobians, np.eye(misfit.size))
    is_constrained = values > np.maximum(np.mean(misfit**2), len(jacobians) * noise)
    return vectors[:, is_constrained] / np.sqrt(values[is_constrained]), vectors[:, ~is_constrained]


def retrieve_without_noise(
    model: TableForwardModel | MediumForwardModel, measurement: Measurement, seed: int
) -> tuple[Solution, Measurement]:
    """Return the solution for unknown noise, and the measurement with the noise found."""
    n_values, min_values = measurement.values.size, len(model.state_vector.names) + MIN_RESIDUAL_DOF
    if n_values < min_values:
        hint = (
            f"{n_values} values are too few to estimate it from the misfit, {min_values} are needed"
        )
        raise invalid("noise", None, "given", hint)
    without_priors = drop_priors(model)
    converged = (
        without_priors.find_minima()
        if isinstance(without_priors, MediumForwardModel)
        else _find_table_minima(without_priors, measurement)
    )
    best = converged.linearize(model.state_vector, measurement.covariance)
    residual = best.modelled - measurement.values
    active_bounds = find_active_bounds(best.state, best.jacobian.T @ residual)
    state_covariance, noise = estimate_fit_covariance(
        converged.jacobians, residual, best.error_covariance, active_bounds
    )
    solution = solve_for_state(model.state_vector, best.state, state_covariance, seed)
    state, covariance = solution.estimates[0].state, noise + best.error_covariance
    estimate = MAPEstimate.from_fit(
        state,
        model.evaluate_state(state),
        best.jacobian,
        covariance,
        measurement.values,
        without_priors.state_vector,
    )
    solution = solution._replace(
        estimates=[estimate],
        forward_model_error=np.sqrt(np.diag(best.error_covariance)),
        alternatives=converged.find_alternatives(ALTERNATIVE_CHI2 * float(noise[0, 0])),
        nonlinearity=estimate_nonlinearity(
            model.evaluate_state, best, state, solution.posterior.covariance, covariance
        ),
    )
    return solution, measurement._replace(covariance=noise)


def solve_for_state(
    state_vector: StateVector, state: np.ndarray, covariance: np.ndarray, seed: int
) -> Solution:
    """Return the solution for measured coordinates and their covariance."""
    size = len(state)
    identity = LinearizedModel(state_vector, state, state, np.eye(size), np.zeros((size, size)))
    measurement = Measurement(state, np.arange(size, dtype=float), covariance, {})
    return solve_for_known_noise(identity, measurement, seed)


def _find_table_minima(model: TableForwardModel, measurement: Measurement) -> ConvergedMinima:
    """Return the minima in a table."""
    minima = sorted(
        find_distinct_map_estimates(model, measurement), key=lambda estimate: estimate.cost
    )
    best = minima[0]
    covariance = model.compute_error_covariance(best.state)
    return ConvergedMinima(minima, best.modelled, covariance, [best.jacobian] * 2)
