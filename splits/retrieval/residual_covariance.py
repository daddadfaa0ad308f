"""Error covariance of least squares for unknown noise, estimated from the misfit.

The residual of an imperfect model is smooth along the spectrum, so neighbouring values are
correlated and carry little independent information.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEIGHBOUR_CORRELATIONS = np.linspace(0.0, 0.98, 50)
"""Candidate correlations between neighbouring wavelengths."""
MIN_RESIDUAL_DOF = 2
"""Smallest excess of the number of values over the number of parameters."""
_UNCONSTRAINED_VARIANCE = 100.0
"""Variance of unconstrained directions, far larger than the range of coordinates."""


class FitCovariance(NamedTuple):
    """Covariance of a fit.

    Attributes
    ----------
    state : float, shape (coordinates, coordinates)
        Covariance of the coordinates.
    residual : float, shape (wavelengths, wavelengths)
        Covariance of the residuals.
    """

    state: np.ndarray
    residual: np.ndarray


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
    covariance: np.ndarray = autocovariance[np.abs(lags[:, np.newaxis] - lags)]
    return covariance


def estimate_fit_covariance(
    jacobians: Sequence[np.ndarray],
    misfit: np.ndarray,
    noise_covariance: np.ndarray,
    active_bounds: np.ndarray,
) -> FitCovariance:
    """Return the covariance of a least-squares fit, estimated from its misfit.

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
    return FitCovariance(
        scale @ spread @ scale.T + _UNCONSTRAINED_VARIANCE * unconstrained @ unconstrained.T,
        residual_covariance,
    )


def _split_directions(
    jacobians: Sequence[np.ndarray], misfit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return constrained directions, scaled to unit effect, and unconstrained ones, as columns."""
    values, vectors = np.linalg.eigh(average_cross_products(jacobians, jacobians))
    mean_square = np.mean(
        [((jacobian @ vectors) ** 2).sum(axis=0) for jacobian in jacobians], axis=0
    )
    is_constrained = values > np.maximum(np.mean(misfit**2), mean_square - values)
    return vectors[:, is_constrained] / np.sqrt(values[is_constrained]), vectors[:, ~is_constrained]


def average_cross_products(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean product of a left matrix and a different, independent right matrix."""
    n_matrices = len(left)
    same_products = np.sum([a.T @ b for a, b in zip(left, right, strict=True)], axis=0)
    mean_product: np.ndarray = (np.sum(left, axis=0).T @ np.sum(right, axis=0) - same_products) / (
        n_matrices * (n_matrices - 1)
    )
    return 0.5 * (mean_product + mean_product.T)
