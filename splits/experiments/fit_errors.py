"""How far the parameters of a fit may be off: what misfit and noise leave open in the unit cube."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.experiments.parameters import Cube, Fitted

CORRELATIONS = np.linspace(0.0, 0.98, 50)
"""Correlations between neighbouring wavelengths that a misfit may have."""

_UNKNOWN = 100.0
"""Variance of what the spectrum does not tell: far beyond the cube."""
_DRAWS = 4096
_SWEEPS = 50
"""Rounds of steps by which draws leave the best fit for where they belong."""


def misfit_variances(misfit: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Return the variance of a misfit, in parts for each of `CORRELATIONS`.

    What a model cannot follow is smooth: neighbouring wavelengths miss alike and tell the same
    thing.  The misfit is taken for a first-order autoregressive series, from which the fit has
    taken what it could.  How much alike neighbours are is not well known from a short spectrum, so
    every correlation counts by its restricted likelihood: that of what the fit leaves.

    Parameters
    ----------
    misfit : float, shape (wavelengths,)
        Model minus measurement, not all 0.
    fitted : float, shape (wavelengths, columns)
        What the fit could add to the spectrum, fewer columns than wavelengths.

    References
    ----------
    Harville (1974), Biometrika 61, 383-385.
    """
    columns = np.linalg.qr(fitted)[0]
    count = len(misfit) - columns.shape[1]
    squares, likelihood = np.empty((2, len(CORRELATIONS)))
    for i, r in enumerate(CORRELATIONS):
        sharp = _unlike(columns, r)
        inner, outer = columns.T @ sharp, sharp.T @ misfit
        square = misfit @ _unlike(misfit, r) - outer @ np.linalg.solve(inner, outer)
        squares[i] = max(square, np.finfo(float).tiny)
        likelihood[i] = -np.linalg.slogdet(inner)[1] - (len(misfit) - 1) * np.log(1.0 - r**2)
    likelihood = 0.5 * (likelihood - count * np.log(squares))
    weights = np.exp(likelihood - likelihood.max())
    return weights / weights.sum() * squares / count


def _unlike(series: np.ndarray, r: float) -> np.ndarray:
    """Return a series times the inverse of its correlations r, r², … between wavelengths."""
    found = (1.0 + r**2) * series
    found[[0, -1]] -= r**2 * series[[0, -1]]
    found[1:] -= r * series[:-1]
    found[:-1] -= r * series[1:]
    return found / (1.0 - r**2)


def _alike(series: np.ndarray, r: float) -> np.ndarray:
    """Return a series times its correlations r, r², … between wavelengths."""
    from scipy.signal import lfilter

    ahead, back = (lfilter([1.0], [1.0, -r], s, axis=0) for s in (series, series[::-1]))
    found: np.ndarray = ahead + back[::-1] - series
    return found


def _crossed(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean product of one on the left and another, independent one on the right."""
    count = len(left)
    same = np.sum([a.T @ b for a, b in zip(left, right, strict=True)], axis=0)
    found = (np.sum(left, axis=0).T @ np.sum(right, axis=0) - same) / (count * (count - 1))
    return 0.5 * (found + found.T)


def covariance_of(
    jacobians: Sequence[np.ndarray], misfit: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the covariance of the coordinates of a least-squares fit, as the spectrum leaves it.

    Noise in a Jacobian would pass for information about coordinates that do nothing, or for an
    error of them.  Products of different, independent Jacobians are free of that on average.
    Directions whose effect is below the misfit of a wavelength, or below that noise, are unknown.

    Parameters
    ----------
    jacobians : sequence of float, shape (wavelengths, coordinates)
        Independent ones, at least two.
    misfit : float, shape (wavelengths,)
        Model minus measurement, see `misfit_variances`.
    noise : float, shape (groups, wavelengths)
        Deviations of the spectra that were fitted, by group of rays: sums over groups of products
        are covariances.  Every simulation of a fit shares its random numbers, so that it ends
        where they move the whole.
    """
    values, vectors = np.linalg.eigh(_crossed(jacobians, jacobians))
    both = np.mean([((j @ vectors) ** 2).sum(axis=0) for j in jacobians], axis=0)
    known = values > np.maximum(np.mean(misfit**2), both - values)
    unknown = vectors[:, ~known]
    scale = vectors[:, known] / np.sqrt(values[known])
    moved = [j @ scale for j in jacobians]
    variances = misfit_variances(misfit, np.mean(moved, axis=0))
    groups = [noise @ m for m in moved]
    spread = _crossed(groups, groups)
    for r, variance in zip(CORRELATIONS, variances, strict=True):
        spread += variance * _crossed(moved, [_alike(m, r) for m in moved])
    # At least that of as many independent wavelengths.
    sizes, axes = np.linalg.eigh(spread)
    spread = (axes * np.maximum(sizes, variances.sum())) @ axes.T
    return scale @ spread @ scale.T + _UNKNOWN * unknown @ unknown.T


def draws_of(best: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return places around the best fit as a normal distribution has them within the cube.

    Every draw is a chain of its own from the best fit on: steps along the coordinates and the axes
    of the covariance, each drawn from the normal distribution between the cube's faces
    (hit-and-run, Smith 1984, Operations Research 32, 1296-1308).

    Returns
    -------
    float, shape (draws, coordinates)
    """
    random = np.random.default_rng(1)
    sizes, axes = np.linalg.eigh(covariance)
    precision = (axes / sizes) @ axes.T
    places = np.tile(best, (_DRAWS, 1))
    for _ in range(_SWEEPS):
        for way in (*np.eye(len(best)), *np.where(np.abs(axes.T) > 1e-9, axes.T, 0.0)):
            pull = precision @ way
            sd = 1.0 / np.sqrt(way @ pull)
            centre = (best - places) @ pull * sd**2
            at, along = places[:, way != 0.0], way[way != 0.0]
            one, other = -at / along, (1.0 - at) / along
            ends = np.stack([
                np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
            ])  # fmt: skip
            step = centre + sd * _normal(random, *((ends - centre) / sd))
            places = np.clip(places + step[:, np.newaxis] * way, 0.0, 1.0)
    return places


def _normal(random: np.random.Generator, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return standard normal numbers between limits."""
    from scipy.special import ndtr, ndtri

    # In the lower tail, where probabilities keep their digits.
    flip = np.where(low + high > 0.0, -1.0, 1.0)
    one, other = flip * low, flip * high
    low, high = np.minimum(one, other), np.maximum(one, other)
    first, last = ndtr(low), ndtr(high)
    found: np.ndarray = np.clip(ndtri(first + random.random(len(low)) * (last - first)), low, high)
    return flip * found


def parameter_errors(cube: Cube, best: np.ndarray, draws: np.ndarray) -> dict[str, Fitted]:
    """Return the parameters with errors, from draws around the best fit.

    What a parameter may be off by is also counted in ranks among sands drawn from the whole cube,
    which treat a logarithmic coordinate and a mass fraction alike.
    """
    everywhere = np.random.default_rng(1).random(draws.shape)
    around, anywhere = ([cube.natural(x) for x in places] for places in (draws, everywhere))
    found = {}
    for name, value in cube.natural(best).items():
        near = np.array([a[name] for a in around])
        order = np.sort([a[name] for a in anywhere])
        rank, ranks = np.searchsorted(order, value), np.searchsorted(order, near)
        unmeasured = _rms(np.arange(len(order)) - rank)
        found[name] = Fitted(value, _rms(near - value), bool(_rms(ranks - rank) < 0.5 * unmeasured))
    return found


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
