"""Maximum-a-posteriori estimates, information content, posterior draws and solutions.

Estimates and information follow Rodgers, C. D. (2000), Inverse Methods for Atmospheric Sounding,
World Scientific; chapters 2 to 5.

Draws from the posterior are made by adaptive importance sampling.  States are drawn around the
optima from a heavy-tailed mixture and weighted by their posterior density.  The mixture is adapted
to the weighted draws until the effective sample size suffices (Bugallo et al. 2017, IEEE Signal
Processing Magazine 34, 60).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import lgamma, log, pi
from typing import NamedTuple

import numpy as np

from splits.retrieval.forward_model import ForwardModel, LinearModel, TableModel, drop_priors
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector

N_STARTS = 4
"""Number of descents, from the first guesses with the smallest misfit."""
MIN_START_SEPARATION = 0.2
"""Smallest distance between the coordinates of the starts of descents."""
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


def compute_whitening(covariance: np.ndarray) -> np.ndarray:
    """Return the matrix that makes errors with a covariance independent, with variances of 1."""
    whitening: np.ndarray = np.linalg.inv(np.linalg.cholesky(covariance))
    return whitening


class Objective(NamedTuple):
    """Cost function of a fit: measurement, error covariance and priors.

    Attributes
    ----------
    measured : float, shape (n,)
    whitening : float, shape (n, n)
        See `compute_whitening`.
    state_vector : StateVector
        State vector with its priors.
    """

    measured: np.ndarray
    whitening: np.ndarray
    state_vector: StateVector

    def compute_residuals(self, modelled: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the residuals of measurement and priors in standard deviations."""
        mean, sd = self.state_vector.prior_mean, self.state_vector.prior_sd
        has_prior = np.isfinite(sd)
        prior = (state - mean)[has_prior] / sd[has_prior]
        return np.concatenate([self.whitening @ (modelled - self.measured), prior])

    def compute_residual_jacobian(self, jacobian: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `compute_residuals` with respect to the coordinates."""
        sd = self.state_vector.prior_sd
        return np.vstack([self.whitening @ jacobian, np.diag(1.0 / sd)[np.isfinite(sd)]])


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


def make_map_estimate(
    model: ForwardModel,
    state: np.ndarray,
    jacobian: np.ndarray,
    error_covariance: np.ndarray,
    measured: np.ndarray,
) -> MAPEstimate:
    """Return the estimate at the end of a descent."""
    modelled, state_vector = model.evaluate(state[np.newaxis])[0], model.state_vector
    residual = modelled - measured
    weighted_residual = np.linalg.solve(error_covariance, residual)
    chi2 = float(residual @ weighted_residual)
    prior_residual = (state - state_vector.prior_mean) / state_vector.prior_sd
    gradient = jacobian.T @ weighted_residual + prior_residual / state_vector.prior_sd
    cost = chi2 + float(prior_residual @ prior_residual)
    active_bounds = find_active_bounds(state, gradient)
    return MAPEstimate(state, modelled, jacobian, error_covariance, cost, chi2, active_bounds)


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

    state = np.clip(start, 1e-6, 1.0 - 1e-6)
    for _ in range(MAX_COVARIANCE_UPDATES):
        covariance = measurement.covariance + model.error_covariance(state)
        whitening = compute_whitening(variance_inflation * covariance)
        objective = Objective(measurement.values, whitening, model.state_vector)
        optimum = least_squares(
            lambda x, one: one.compute_residuals(model.evaluate(x[np.newaxis])[0], x),
            state,
            lambda x, one: one.compute_residual_jacobian(model.jacobian(x)),
            bounds=(0.0, 1.0),
            xtol=TOLERANCE,
            ftol=TOLERANCE,
            args=(objective,),
        )
        step = float(np.abs(optimum.x - state).max())
        state = np.clip(optimum.x, 1e-9, 1.0 - 1e-9)
        if step < 1e-3:
            break
    covariance = variance_inflation * (measurement.covariance + model.error_covariance(state))
    return make_map_estimate(model, state, model.jacobian(state), covariance, measurement.values)


def find_active_bounds(state: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return which coordinates are at a bound outside which the sum of squares decreases."""
    return ((state < BOUND_TOLERANCE) & (gradient > 0.0)) | (
        (state > 1.0 - BOUND_TOLERANCE) & (gradient < 0.0)
    )


def select_distinct(
    costs: Sequence[float] | np.ndarray,
    states: Sequence[np.ndarray] | np.ndarray,
    max_number: int,
    min_separation: float,
    max_increase: float = np.inf,
) -> list[int]:
    """Return the positions of the best states that are separated from each other, best first.

    Parameters
    ----------
    costs : sequence of float
    states : sequence of float, shape (parameters,)
    max_number : int
    min_separation : float
        Smallest distance between their coordinates.
    max_increase : float
        Largest excess of the cost over that of the best.
    """
    selected: list[int] = []
    for i in map(int, np.argsort(costs, kind="stable")):
        is_worse = selected and costs[i] > costs[selected[0]] + max_increase
        if is_worse or len(selected) == max_number:
            break
        if all(np.abs(states[i] - states[other]).max() > min_separation for other in selected):
            selected.append(i)
    return selected


def find_distinct_map_estimates(
    model: TableModel | LinearModel, measurement: Measurement, variance_inflation: float = 1.0
) -> list[MAPEstimate]:
    """Return the distinct estimates of several descents, best first.

    Parameters
    ----------
    model : TableModel or LinearModel
        Descents start from its first guesses with the smallest misfit.
    measurement : Measurement
    variance_inflation : float
        Factor of all variances.
    """
    first_guesses, modelled = model.evaluate_first_guesses()
    spread = np.sqrt(np.diag(measurement.covariance))
    misfit = (((modelled - measurement.values) / spread) ** 2).sum(axis=1)
    state_vector = model.state_vector
    prior = (((first_guesses - state_vector.prior_mean) / state_vector.prior_sd) ** 2).sum(axis=1)
    starts = select_distinct(misfit + prior, first_guesses, N_STARTS, MIN_START_SEPARATION)
    estimates = [
        find_map_estimate(model, measurement, first_guesses[i], variance_inflation) for i in starts
    ]
    costs = [estimate.minus_two_log_posterior for estimate in estimates]
    states = [estimate.state for estimate in estimates]
    distinct = select_distinct(costs, states, N_STARTS, MIN_SEPARATION, ALTERNATIVE_CHI2)
    return [estimates[i] for i in distinct]


def compute_posterior(
    estimate: MAPEstimate, state_vector: StateVector
) -> tuple[np.ndarray, np.ndarray]:
    """Return the posterior covariance of the coordinates near an optimum, and the Fisher matrix.

    See Rodgers (2000), Eq. 2.27.
    """
    fisher = estimate.jacobian.T @ np.linalg.solve(estimate.error_covariance, estimate.jacobian)
    return np.linalg.inv(fisher + np.diag(1.0 / state_vector.prior_variance)), fisher


def compute_fit_degrees_of_freedom(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return the degrees of freedom used by a fit: the trace over coordinates not at a bound."""
    is_free = ~estimate.active_bounds
    jacobian = estimate.jacobian[:, is_free]
    fisher = jacobian.T @ np.linalg.solve(estimate.error_covariance, jacobian)
    prior_precision = np.diag(1.0 / state_vector.prior_variance[is_free])
    return float(np.trace(np.linalg.solve(fisher + prior_precision, fisher)))


N_DRAWS = 4000
STUDENT_T_DOF = 5.0
"""Degrees of freedom of Student's t, with tails heavier than those of the posterior."""
MIN_EFFECTIVE_DRAWS = 400.0
"""Effective sample size per optimum at which the adaptation stops."""
MAX_ITERATIONS = 6
DEFENSIVE_FRACTION = 0.1
"""Fraction of draws from the whole range, so that every part of it is sampled."""


def _compute_log_density(
    states: np.ndarray, components: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the logarithm of the density of every component, up to a constant common to all.

    Components of the proposal distribution are multivariate Student's t, given by their centre and
    the Cholesky factor of their covariance.
    """
    densities = []
    for centre, cholesky in components:
        standardized = np.linalg.solve(cholesky, (states - centre).T)
        tails = np.log1p((standardized**2).sum(axis=0) / STUDENT_T_DOF)
        log_scale = np.log(np.diag(cholesky)).sum()
        densities.append(-log_scale - 0.5 * (STUDENT_T_DOF + len(centre)) * tails)
    return np.array(densities)


def _factorize(covariance: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of the covariance of a component."""
    factor: np.ndarray = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
    return factor


def draw_posterior(
    model: ForwardModel, measurement: Measurement, estimates: Sequence[MAPEstimate], seed: int
) -> tuple[np.ndarray, float]:
    """Return draws from the posterior, with equal weights, and their effective number.

    Parameters
    ----------
    model : ForwardModel
    measurement : Measurement
    estimates : sequence of MAPEstimate
        Best first.  States use the error covariance of the nearest estimate.
    seed : int
    """
    random = np.random.default_rng([seed, 20])
    components = [
        (one.state, _factorize(1.5 * compute_posterior(one, model.state_vector)[0]))
        for one in estimates
    ]
    # Logarithm of the normalization of Student's t.
    n_dimensions = len(estimates[0].state)
    constant = (
        lgamma(0.5 * (STUDENT_T_DOF + n_dimensions))
        - lgamma(0.5 * STUDENT_T_DOF)
        - 0.5 * n_dimensions * log(STUDENT_T_DOF * pi)
    )
    best = (0.0, np.zeros(0), np.zeros(0), components)
    for _ in range(MAX_ITERATIONS):
        # From the whole range, and from all components.
        uniform = random.random((int(DEFENSIVE_FRACTION * N_DRAWS), n_dimensions))
        n_draws = (N_DRAWS - len(uniform)) // len(components)
        drawn = [uniform]
        for centre, cholesky in components:
            normal = random.standard_normal((n_draws, n_dimensions))
            scale = np.sqrt(STUDENT_T_DOF / random.chisquare(STUDENT_T_DOF, n_draws))
            drawn.append(centre + scale[:, np.newaxis] * (normal @ cholesky.T))
        states = np.concatenate(drawn)
        states = states[((states >= 0.0) & (states <= 1.0)).all(axis=1)]
        log_proposal = np.logaddexp.reduce(_compute_log_density(states, components), axis=0)
        log_proposal += constant - np.log(len(components)) + np.log1p(-DEFENSIVE_FRACTION)
        log_weight = _compute_log_posterior(model, measurement, states, estimates) - np.logaddexp(
            log_proposal, np.log(DEFENSIVE_FRACTION)
        )
        weights = np.exp(log_weight - log_weight.max())
        weights /= weights.sum()
        n_effective = float(1.0 / (weights**2).sum())
        if n_effective > best[0]:
            best = (n_effective, states, weights, components)
        if n_effective >= MIN_EFFECTIVE_DRAWS * len(estimates):
            break
        # Adapt to the best iteration so far.
        _, best_states, best_weights, best_components = best
        components = _update_components(best_states, best_weights, best_components)
    n_effective, states, weights, _ = best
    # Systematic resampling.
    positions = (np.arange(N_DRAWS) + random.random()) / N_DRAWS
    rows = np.searchsorted(np.cumsum(weights), positions * weights.sum())
    return states[np.minimum(rows, len(weights) - 1)], n_effective


def _compute_log_posterior(
    model: ForwardModel,
    measurement: Measurement,
    states: np.ndarray,
    estimates: Sequence[MAPEstimate],
) -> np.ndarray:
    """Return the logarithm of the posterior density, up to a constant."""
    residual = model.evaluate(states) - measurement.values
    nearest = np.argmin(
        [np.abs(states - estimate.state).max(axis=1) for estimate in estimates], axis=0
    )
    misfit = np.empty(len(states))
    for number, estimate in enumerate(estimates):
        rows = nearest == number
        cholesky = np.linalg.cholesky(estimate.error_covariance)
        squares = ((residual[rows] @ np.linalg.inv(cholesky).T) ** 2).sum(axis=1)
        misfit[rows] = squares + 2.0 * np.log(np.diag(cholesky)).sum()
    prior = ((states - model.state_vector.prior_mean) / model.state_vector.prior_sd) ** 2
    return -0.5 * (misfit + prior.sum(axis=1))


def _update_components(
    states: np.ndarray, weights: np.ndarray, components: list[tuple[np.ndarray, np.ndarray]]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return components adapted to weighted states, each assigned to its nearest component."""
    nearest = np.argmax(_compute_log_density(states, components), axis=0)
    updated = []
    for number, (_, cholesky) in enumerate(components):
        own_weights = weights * (nearest == number)
        if own_weights.sum() < 1e-6:
            continue
        own_weights /= own_weights.sum()
        centre = own_weights @ states
        deviation = states - centre
        spread = (own_weights[:, np.newaxis] * deviation).T @ deviation
        n_effective = 1.0 / (own_weights**2).sum()
        # Few effective states do not determine a covariance, so the previous one is mixed in.
        kept_fraction = 1.0 / (1.0 + n_effective / (4.0 * len(centre)))
        previous = cholesky @ cholesky.T
        adapted = (1.0 - kept_fraction) * 1.5 * spread + kept_fraction * 0.5 * previous
        updated.append((centre, _factorize(adapted)))
    return updated or components


MIN_MISFIT_PROBABILITY = 0.01
"""Probability of the misfit below which the model does not fit the measurement."""
MAX_PRIOR_TENSION = 3.0
"""Standard deviations between prior and result above which they disagree."""


class Solution(NamedTuple):
    """Solution of a retrieval.

    Attributes
    ----------
    estimates : sequence of MAPEstimate
        Best first.
    draws : float, shape (N_DRAWS, parameters)
        Coordinates from the posterior, with equal weights.
    n_effective : float
        Effective number of draws.
    covariance : float, shape (parameters, parameters)
        Posterior covariance of the coordinates at the best estimate.
    fisher : float, shape (parameters, parameters)
        Information of the measurement on the coordinates there.
    variance_inflation : float
        Factor of all variances that makes the misfit plausible.
    prior_tension : float, shape (parameters,)
        Distance of the priors from the result without them, in standard errors.
    forward_model_error : float, shape (n,)
        Standard errors of the table, or of simulations, at the best estimate.
    alternatives : tuple of float, shape (parameters,)
        Coordinates of alternative solutions.
    nonlinearity : float
        Deviation of linear or interpolated reflectances from the model, in units of noise.
    """

    estimates: Sequence[MAPEstimate]
    draws: np.ndarray
    n_effective: float
    covariance: np.ndarray
    fisher: np.ndarray
    variance_inflation: float
    prior_tension: np.ndarray
    forward_model_error: np.ndarray
    alternatives: tuple[np.ndarray, ...] = ()
    nonlinearity: float = 0.0


def solve_for_known_noise(
    model: TableModel | LinearModel, measurement: Measurement, seed: int
) -> Solution:
    """Return the solution: estimates, posterior and draws."""
    from scipy.stats import chi2

    state_vector = model.state_vector
    estimates = find_distinct_map_estimates(model, measurement)
    # A prior that contradicts the measurement must not inflate the variances.
    without_priors = estimates[0]
    if np.isfinite(state_vector.prior_sd).any():
        without_priors = find_map_estimate(drop_priors(model), measurement, estimates[0].state)
    reference = estimates[0] if estimates[0].chi2 <= without_priors.chi2 else without_priors
    n_used = compute_fit_degrees_of_freedom(reference, state_vector)
    n_dof = max(len(reference.modelled) - n_used, 1.0)
    variance_inflation = 1.0
    if chi2.sf(reference.chi2, n_dof) <= MIN_MISFIT_PROBABILITY:
        variance_inflation = reference.chi2 / n_dof
        estimates = find_distinct_map_estimates(model, measurement, variance_inflation)
    inflated = variance_inflation * without_priors.error_covariance
    spread, _ = compute_posterior(
        without_priors._replace(error_covariance=inflated), state_vector.without_priors()
    )
    tension = np.abs(without_priors.state - state_vector.prior_mean) / np.sqrt(
        state_vector.prior_sd**2 + np.diag(spread)
    )
    if estimates[0].chi2 - reference.chi2 / variance_inflation < MAX_PRIOR_TENSION**2:
        # The priors do not contradict the measurement if the misfit is as good without them.
        tension = np.zeros_like(tension)
    draws = draw_posterior(model, measurement, estimates, seed)
    model_error = np.sqrt(np.diag(model.error_covariance(estimates[0].state)))
    posterior = compute_posterior(estimates[0], state_vector)
    return Solution(estimates, *draws, *posterior, variance_inflation, tension, model_error)
