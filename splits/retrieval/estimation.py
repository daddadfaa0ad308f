"""The most probable place, and what the measurement tells about it (Rodgers 2000).

Rodgers, C. D. (2000), Inverse Methods for Atmospheric Sounding, World Scientific; chapters 2 to 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.extras import optional
from splits.retrieval.coordinates import Free
from splits.retrieval.forward import Model
from splits.retrieval.measurement import Measurement

STARTS = 4
"""Descents, from the places that come nearest among those looked at first."""
ROUNDS = 3
"""Descents with the model's error as it is where the last one ended."""
APART = 0.05
"""Distance of coordinates from which two ends are different."""
RIVAL = 9.0
"""How much larger a sum of squares may be for its place to count as another answer."""
HELD = 2e-3
"""Distance of coordinates from an end of a range at which it may hold them."""


class Optimum(NamedTuple):
    """A most probable place.

    Attributes
    ----------
    place : float, shape (parameters,)
    values : float, shape (n,)
        What would be measured there.
    slopes : float, shape (n, parameters)
    covariance : float, shape (n, n)
        Of measurement and model.
    cost : float
        Sum of squares: of the measurement, and of the priors.
    chi2 : float
        That of the measurement alone.
    held : bool, shape (parameters,)
        Coordinates that go no further because their range ends.
    """

    place: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    cost: float
    chi2: float
    held: np.ndarray

    @property
    def improbability(self) -> float:
        """Twice the negative logarithm of its probability, but for a constant.

        Where a model knows less, the sum of squares is smaller for no merit of the place.
        """
        return self.cost + float(np.linalg.slogdet(self.covariance)[1])


class Told(NamedTuple):
    """What a measurement tells in the neighbourhood of an optimum.

    Attributes
    ----------
    covariance : float, shape (parameters, parameters)
        Of the coordinates, after.
    averaging_kernel : float, shape (parameters, parameters)
    degrees_of_freedom : float
        Of signal, the trace of the averaging kernel.
    information_bits : float
    """

    covariance: np.ndarray
    averaging_kernel: np.ndarray
    degrees_of_freedom: float
    information_bits: float


def optimum(
    model: Model, measurement: Measurement, start: np.ndarray, excess: float = 1.0
) -> Optimum:
    """Return the most probable place that a descent from a start ends at.

    Parameters
    ----------
    model : Model
    measurement : Measurement
    start : float, shape (parameters,)
        Coordinates.
    excess : float
        By so much all variances are enlarged.
    """
    least_squares = optional("scipy.optimize", "retrieval", "retrievals need").least_squares

    free = model.free
    known = np.isfinite(free.prior_sd)
    pull = np.diag(1.0 / free.prior_sd)[known]
    place = np.clip(start, 1e-6, 1.0 - 1e-6)
    for _ in range(ROUNDS):
        covariance = excess * (measurement.covariance + model.covariance(place))
        lower = np.linalg.cholesky(covariance)

        def residuals(x: np.ndarray, lower: np.ndarray = lower) -> np.ndarray:
            values, _ = model.with_slopes(x)
            off = np.linalg.solve(lower, values - measurement.values)
            prior = (x - free.prior_mean)[known] / free.prior_sd[known]
            return np.concatenate([off, prior])

        def slopes(x: np.ndarray, lower: np.ndarray = lower) -> np.ndarray:
            _, along = model.with_slopes(x)
            return np.vstack([np.linalg.solve(lower, along), pull])

        found = least_squares(residuals, place, slopes, bounds=(0.0, 1.0), xtol=1e-9, ftol=1e-9)
        moved = float(np.abs(found.x - place).max())
        place = np.clip(found.x, 1e-9, 1.0 - 1e-9)
        if moved < 1e-3:
            break
    covariance = excess * (measurement.covariance + model.covariance(place))
    values, along = model.with_slopes(place)
    off = values - measurement.values
    sharp = np.linalg.solve(covariance, off)
    chi2 = float(off @ sharp)
    pulls = (place - free.prior_mean) / free.prior_sd
    held = held_at(place, along.T @ sharp + pulls / free.prior_sd)
    return Optimum(place, values, along, covariance, chi2 + float(pulls @ pulls), chi2, held)


def held_at(place: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return which coordinates an end of their range holds, as a sum of squares falls beyond it."""
    found: np.ndarray = ((place < HELD) & (gradient > 0.0)) | (
        (place > 1.0 - HELD) & (gradient < 0.0)
    )
    return found


def optima(
    model: Model,
    measurement: Measurement,
    places: np.ndarray,
    values: np.ndarray,
    excess: float = 1.0,
) -> list[Optimum]:
    """Return the different ends of several descents that explain a measurement, best first.

    Parameters
    ----------
    places : float, shape (many, parameters)
        Where descents may start, far and wide.
    values : float, shape (many, n)
        What would be measured there.
    excess : float
        By so much all variances are enlarged.
    """
    spread = np.sqrt(np.diag(measurement.covariance))
    misfit = (((values - measurement.values) / spread) ** 2).sum(axis=1)
    prior = (((places - model.free.prior_mean) / model.free.prior_sd) ** 2).sum(axis=1)
    starts: list[np.ndarray] = []
    for row in np.argsort(misfit + prior, kind="stable"):
        if all(np.abs(places[row] - other).max() > 0.2 for other in starts):
            starts.append(places[row])
        if len(starts) == STARTS:
            break
    ends = [optimum(model, measurement, start, excess) for start in starts]
    ends.sort(key=lambda end: end.improbability)
    found = ends[:1]
    for end in ends[1:]:
        different = all(np.abs(end.place - one.place).max() > APART for one in found)
        if different and end.improbability < found[0].improbability + RIVAL:
            found.append(end)
    return found


def told(end: Optimum, free: Free) -> Told:
    """Return what a measurement tells around an optimum (Rodgers 2000, Eqs 2.27, 2.78, 2.80)."""
    fisher = end.slopes.T @ np.linalg.solve(end.covariance, end.slopes)
    before = np.diag(1.0 / free.prior_variance)
    after = np.linalg.inv(fisher + before)
    kernel = after @ fisher
    scaled = np.eye(len(fisher)) + fisher * free.prior_variance[:, np.newaxis]
    bits = 0.5 * float(np.linalg.slogdet(scaled)[1]) / float(np.log(2.0))
    return Told(after, kernel, float(np.trace(kernel)), bits)


def fitted(end: Optimum, free: Free) -> float:
    """Return how many values a fit has used up: the trace over coordinates that are not held."""
    loose = ~end.held
    slopes = end.slopes[:, loose]
    fisher = slopes.T @ np.linalg.solve(end.covariance, slopes)
    before = np.diag(1.0 / free.prior_variance[loose])
    return float(np.trace(np.linalg.solve(fisher + before, fisher)))
