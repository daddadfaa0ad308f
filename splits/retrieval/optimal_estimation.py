"""The most probable place, and what the measurement tells about it (Rodgers 2000).

Rodgers, C. D. (2000), Inverse Methods for Atmospheric Sounding, World Scientific; chapters 2 to 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.core.optional import import_optional
from splits.retrieval.forward_model import ForwardModel
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector

N_STARTS = 4
"""Descents, from the places that come nearest among those looked at first."""
MAX_COVARIANCE_UPDATES = 3
"""Descents with the model's error as it is where the last one ended."""
MIN_SEPARATION = 0.05
"""Distance of coordinates from which two ends are different."""
ALTERNATIVE_CHI2 = 9.0
"""How much larger a sum of squares may be for its place to count as another answer."""
BOUND_TOLERANCE = 2e-3
"""Distance of coordinates from an end of a range at which it may hold them."""


class MAPEstimate(NamedTuple):
    """A most probable place.

    Attributes
    ----------
    state : float, shape (parameters,)
    modelled : float, shape (n,)
        What would be measured there.
    jacobian : float, shape (n, parameters)
    error_covariance : float, shape (n, n)
        Of measurement and model.
    cost : float
        Sum of squares: of the measurement, and of the priors.
    chi2 : float
        That of the measurement alone.
    active_bounds : bool, shape (parameters,)
        Coordinates that go no further because their range ends.
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
        """Twice the negative logarithm of its probability, but for a constant.

        Where a model knows less, the sum of squares is smaller for no merit of the place.
        """
        return self.cost + float(np.linalg.slogdet(self.error_covariance)[1])


class PosteriorSummary(NamedTuple):
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


def find_map_estimate(
    model: ForwardModel,
    measurement: Measurement,
    start: np.ndarray,
    variance_inflation: float = 1.0,
) -> MAPEstimate:
    """Return the most probable place that a descent from a start ends at.

    Parameters
    ----------
    model : Model
    measurement : Measurement
    start : float, shape (parameters,)
        Coordinates.
    variance_inflation : float
        By so much all variances are enlarged.
    """
    least_squares = import_optional("scipy.optimize", "retrieval", "retrievals need").least_squares

    free = model.state_vector
    known = np.isfinite(free.prior_sd)
    pull = np.diag(1.0 / free.prior_sd)[known]
    place = np.clip(start, 1e-6, 1.0 - 1e-6)
    for _ in range(MAX_COVARIANCE_UPDATES):
        covariance = variance_inflation * (
            measurement.covariance + model.compute_error_covariance(place)
        )
        lower = np.linalg.cholesky(covariance)

        def residuals(x: np.ndarray, lower: np.ndarray = lower) -> np.ndarray:
            values, _ = model.evaluate_with_jacobian(x)
            off = np.linalg.solve(lower, values - measurement.values)
            prior = (x - free.prior_mean)[known] / free.prior_sd[known]
            return np.concatenate([off, prior])

        def slopes(x: np.ndarray, lower: np.ndarray = lower) -> np.ndarray:
            _, along = model.evaluate_with_jacobian(x)
            return np.vstack([np.linalg.solve(lower, along), pull])

        found = least_squares(residuals, place, slopes, bounds=(0.0, 1.0), xtol=1e-9, ftol=1e-9)
        moved = float(np.abs(found.x - place).max())
        place = np.clip(found.x, 1e-9, 1.0 - 1e-9)
        if moved < 1e-3:
            break
    covariance = variance_inflation * (
        measurement.covariance + model.compute_error_covariance(place)
    )
    values, along = model.evaluate_with_jacobian(place)
    off = values - measurement.values
    sharp = np.linalg.solve(covariance, off)
    chi2 = float(off @ sharp)
    pulls = (place - free.prior_mean) / free.prior_sd
    held = find_active_bounds(place, along.T @ sharp + pulls / free.prior_sd)
    return MAPEstimate(place, values, along, covariance, chi2 + float(pulls @ pulls), chi2, held)


def find_active_bounds(state: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return which coordinates an end of their range holds, as a sum of squares falls beyond it."""
    found: np.ndarray = ((state < BOUND_TOLERANCE) & (gradient > 0.0)) | (
        (state > 1.0 - BOUND_TOLERANCE) & (gradient < 0.0)
    )
    return found


def find_distinct_map_estimates(
    model: ForwardModel,
    measurement: Measurement,
    first_guesses: np.ndarray,
    modelled: np.ndarray,
    variance_inflation: float = 1.0,
) -> list[MAPEstimate]:
    """Return the different ends of several descents that explain a measurement, best first.

    Parameters
    ----------
    first_guesses : float, shape (many, parameters)
        Where descents may start, far and wide.
    modelled : float, shape (many, n)
        What would be measured there.
    variance_inflation : float
        By so much all variances are enlarged.
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
    ends = [find_map_estimate(model, measurement, start, variance_inflation) for start in starts]
    ends.sort(key=lambda end: end.minus_two_log_posterior)
    found = ends[:1]
    for end in ends[1:]:
        different = all(np.abs(end.state - one.state).max() > MIN_SEPARATION for one in found)
        if (
            different
            and end.minus_two_log_posterior < found[0].minus_two_log_posterior + ALTERNATIVE_CHI2
        ):
            found.append(end)
    return found


def summarize_posterior(estimate: MAPEstimate, state_vector: StateVector) -> PosteriorSummary:
    """Return what a measurement tells around an optimum (Rodgers 2000, Eqs 2.27, 2.78, 2.80)."""
    fisher = estimate.jacobian.T @ np.linalg.solve(estimate.error_covariance, estimate.jacobian)
    before = np.diag(1.0 / state_vector.prior_variance)
    after = np.linalg.inv(fisher + before)
    kernel = after @ fisher
    scaled = np.eye(len(fisher)) + fisher * state_vector.prior_variance[:, np.newaxis]
    bits = 0.5 * float(np.linalg.slogdet(scaled)[1]) / float(np.log(2.0))
    return PosteriorSummary(after, kernel, float(np.trace(kernel)), bits)


def compute_fit_degrees_of_freedom(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return how many values a fit has used up: the trace over coordinates that are not held."""
    loose = ~estimate.active_bounds
    slopes = estimate.jacobian[:, loose]
    fisher = slopes.T @ np.linalg.solve(estimate.error_covariance, slopes)
    before = np.diag(1.0 / state_vector.prior_variance[loose])
    return float(np.trace(np.linalg.solve(fisher + before, fisher)))
