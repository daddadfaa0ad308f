"""How far least squares may be off where noise is not known: what the misfit itself says.

What a model cannot follow is smooth: neighbouring values, however far apart their wavelengths are,
miss alike and tell the same thing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEIGHBOUR_CORRELATIONS = np.linspace(0.0, 0.98, 50)
"""Correlations between neighbouring wavelengths that a misfit may have."""
MIN_RESIDUAL_DOF = 2
"""Values at least beyond the number of parameters."""
_UNCONSTRAINED_VARIANCE = 100.0
"""Variance of what the spectrum does not tell: far beyond the cube."""


class FitCovariance(NamedTuple):
    """What a fit leaves open.

    Attributes
    ----------
    state : float, shape (coordinates, coordinates)
        Covariance of the coordinates.
    residual : float, shape (wavelengths, wavelengths)
        Covariance of what the misfit was drawn from.
    """

    state: np.ndarray
    residual: np.ndarray


def estimate_misfit_variances(misfit: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the variance of a misfit, in parts for each of `NEIGHBOUR_CORRELATIONS`.

    The misfit is taken for a first-order autoregressive series, from which the fit has taken what
    it could.  How much alike neighbours are is not well known from a short spectrum, so every
    correlation counts by its restricted likelihood: that of what the fit leaves.

    Parameters
    ----------
    misfit : float, shape (wavelengths,)
        Model minus measurement, not all 0.
    jacobian : float, shape (wavelengths, columns)
        What the fit could add to the spectrum, fewer columns than wavelengths.

    References
    ----------
    Harville (1974), Biometrika 61, 383-385.
    """
    columns = np.linalg.qr(jacobian)[0]
    count = len(misfit) - columns.shape[1]
    squares, likelihood = np.empty((2, len(NEIGHBOUR_CORRELATIONS)))
    for i, r in enumerate(NEIGHBOUR_CORRELATIONS):
        sharp = _apply_inverse_correlation(columns, r)
        inner, outer = columns.T @ sharp, sharp.T @ misfit
        square = misfit @ _apply_inverse_correlation(misfit, r) - outer @ np.linalg.solve(
            inner, outer
        )
        squares[i] = max(square, np.finfo(float).tiny)
        likelihood[i] = -np.linalg.slogdet(inner)[1] - (len(misfit) - 1) * np.log(1.0 - r**2)
    likelihood = 0.5 * (likelihood - count * np.log(squares))
    weights = np.exp(likelihood - likelihood.max())
    return weights / weights.sum() * squares / count


def _apply_inverse_correlation(series: np.ndarray, correlation: float) -> np.ndarray:
    """Return a series times the inverse of its correlations r, r², … between wavelengths."""
    found = (1.0 + correlation**2) * series
    found[[0, -1]] -= correlation**2 * series[[0, -1]]
    found[1:] -= correlation * series[:-1]
    found[:-1] -= correlation * series[1:]
    return found / (1.0 - correlation**2)


def make_autoregressive_covariance(variances: np.ndarray, n_wavelengths: int) -> np.ndarray:
    """Return the covariance matrix of residuals from `estimate_misfit_variances`."""
    apart = np.arange(n_wavelengths)
    of_lag = (variances[:, np.newaxis] * NEIGHBOUR_CORRELATIONS[:, np.newaxis] ** apart).sum(axis=0)
    found: np.ndarray = of_lag[np.abs(apart[:, np.newaxis] - apart)]
    return found


def estimate_fit_covariance(
    jacobians: Sequence[np.ndarray],
    misfit: np.ndarray,
    noise_covariance: np.ndarray,
    active_bounds: np.ndarray,
) -> FitCovariance:
    """Return what a least-squares fit leaves open, as the misfit says.

    Noise in a Jacobian would pass for information about coordinates that do nothing, or for an
    error of them.  Products of different, independent Jacobians are free of that on average.
    Directions whose effect is below the misfit of a wavelength, or below that noise, are unknown.

    Parameters
    ----------
    jacobians : sequence of float, shape (wavelengths, coordinates)
        Independent ones, at least two.
    misfit : float, shape (wavelengths,)
        Model minus measurement, see `estimate_misfit_variances`.
    noise_covariance : float, shape (wavelengths, wavelengths)
        Covariance of the runs' own noise.  Every run of a fit shares its random numbers, so that
        it ends where they move the whole.
    active_bounds : bool, shape (coordinates,)
        Those that an end of their range holds: a fit has taken nothing from the misfit by these.
    """
    scale, unknown = _split_directions(jacobians, misfit)
    moved = [j @ scale for j in jacobians]
    loose = [j[:, ~active_bounds] for j in jacobians]
    taken = np.mean([j @ _split_directions(loose, misfit)[0] for j in loose], axis=0)
    variances = estimate_misfit_variances(misfit, taken)
    errors = make_autoregressive_covariance(variances, len(misfit))
    spread = average_cross_products(moved, [(errors + noise_covariance) @ m for m in moved])
    # At least that of as many independent wavelengths.
    sizes, axes = np.linalg.eigh(spread)
    spread = (axes * np.maximum(sizes, variances.sum())) @ axes.T
    return FitCovariance(
        scale @ spread @ scale.T + _UNCONSTRAINED_VARIANCE * unknown @ unknown.T, errors
    )


def _split_directions(
    jacobians: Sequence[np.ndarray], misfit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return known directions, so long that each moves light by 1, and unknown ones, as columns."""
    values, vectors = np.linalg.eigh(average_cross_products(jacobians, jacobians))
    both = np.mean([((j @ vectors) ** 2).sum(axis=0) for j in jacobians], axis=0)
    known = values > np.maximum(np.mean(misfit**2), both - values)
    return vectors[:, known] / np.sqrt(values[known]), vectors[:, ~known]


def average_cross_products(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean product of one on the left and another, independent one on the right."""
    count = len(left)
    same = np.sum([a.T @ b for a, b in zip(left, right, strict=True)], axis=0)
    found: np.ndarray = (np.sum(left, axis=0).T @ np.sum(right, axis=0) - same) / (
        count * (count - 1)
    )
    return 0.5 * (found + found.T)
