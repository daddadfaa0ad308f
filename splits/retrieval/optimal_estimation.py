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
    return ((state < BOUND_TOLERANCE) & (gradient > 0.0)) | (
        (state > 1.0 - BOUND_TOLERANCE) & (gradient < 0.0)
    )


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


N_DRAWS = 4000
STUDENT_T_DOF = 5.0
"""Degrees of freedom of Student's t, with tails heavier than those of the posterior."""
MIN_EFFECTIVE_DRAWS = 400.0
"""Effective sample size per optimum at which the adaptation stops."""
MAX_ITERATIONS = 6
DEFENSIVE_FRACTION = 0.1
"""Fraction of draws from the whole range, so that every part of it is sampled."""


class PosteriorDraws(NamedTuple):
    """Draws from a posterior.

    Attributes
    ----------
    states : float, shape (N_DRAWS, parameters)
        Coordinates, with equal weights.
    n_effective : float
        Effective sample size.
    """

    states: np.ndarray
    n_effective: float


class _MixtureComponent(NamedTuple):
    """Component of the proposal distribution: a multivariate Student's t."""

    centre: np.ndarray
    cholesky: np.ndarray

    @classmethod
    def from_covariance(cls, centre: np.ndarray, covariance: np.ndarray) -> _MixtureComponent:
        tiny = 1e-12 * np.eye(len(centre))
        return cls(centre, np.linalg.cholesky(covariance + tiny))

    def draw(self, random: np.random.Generator, n_draws: int) -> np.ndarray:
        normal = random.standard_normal((n_draws, len(self.centre)))
        scale = np.sqrt(STUDENT_T_DOF / random.chisquare(STUDENT_T_DOF, n_draws))[:, np.newaxis]
        return self.centre + scale * (normal @ self.cholesky.T)

    def compute_log_density(self, states: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density, up to a constant common to all components."""
        standardized = np.linalg.solve(self.cholesky, (states - self.centre).T)
        n_dimensions = len(self.centre)
        log_scale = np.log(np.diag(self.cholesky)).sum()
        return -log_scale - 0.5 * (STUDENT_T_DOF + n_dimensions) * np.log1p(
            (standardized**2).sum(axis=0) / STUDENT_T_DOF
        )


def draw_posterior(
    model: ForwardModel, measurement: Measurement, estimates: Sequence[MAPEstimate], seed: int
) -> PosteriorDraws:
    """Return draws from the posterior.

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
        _MixtureComponent.from_covariance(
            estimate.state, 1.5 * summarize_posterior(estimate, model.state_vector).covariance
        )
        for estimate in estimates
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
        drawn = [component.draw(random, n_draws) for component in components]
        states = np.concatenate([uniform, *drawn])
        is_inside = ((states >= 0.0) & (states <= 1.0)).all(axis=1)
        states = states[is_inside]
        log_proposal = np.logaddexp.reduce(
            [component.compute_log_density(states) for component in components], axis=0
        )
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
    return PosteriorDraws(states[np.minimum(rows, len(weights) - 1)], n_effective)


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
    states: np.ndarray, weights: np.ndarray, components: Sequence[_MixtureComponent]
) -> list[_MixtureComponent]:
    """Return components adapted to weighted states, each assigned to its nearest component."""
    nearest = np.argmax([component.compute_log_density(states) for component in components], axis=0)
    updated = []
    for number, component in enumerate(components):
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
        previous = component.cholesky @ component.cholesky.T
        updated.append(
            _MixtureComponent.from_covariance(
                centre, (1.0 - kept_fraction) * 1.5 * spread + kept_fraction * 0.5 * previous
            )
        )
    return updated or list(components)


MIN_MISFIT_PROBABILITY = 0.01
"""Probability of the misfit below which the model does not fit the measurement."""
BOUND_DISTANCE = 0.01
"""Distance of a coordinate from a bound below which a value lies at it."""
MAX_NONLINEARITY = 1.0
"""Deviation of linear or interpolated reflectances, in units of noise, which is reported."""
MAX_PRIOR_TENSION = 3.0
"""Standard deviations between prior and result above which they disagree."""


class Solution(NamedTuple):
    """Solution of a retrieval.

    Attributes
    ----------
    estimates : sequence of MAPEstimate
        Best first.
    posterior : PosteriorSummary
    draws : PosteriorDraws
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
    posterior: PosteriorSummary
    draws: PosteriorDraws
    variance_inflation: float
    prior_tension: np.ndarray
    forward_model_error: np.ndarray
    alternatives: tuple[np.ndarray, ...] = ()
    nonlinearity: float = 0.0


def compute_prior_tension(
    state_vector: StateVector, state: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """Return the distance of the priors from a result without them, in standard errors."""
    return np.abs(state - state_vector.prior_mean) / np.sqrt(state_vector.prior_sd**2 + variance)


def compute_variance_inflation(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return the factor of all variances that makes the misfit plausible."""
    from scipy.stats import chi2

    n_dof = max(
        len(estimate.modelled) - compute_fit_degrees_of_freedom(estimate, state_vector), 1.0
    )
    if chi2.sf(estimate.chi2, n_dof) > MIN_MISFIT_PROBABILITY:
        return 1.0
    return estimate.chi2 / n_dof


def list_warnings(
    state_vector: StateVector, solution: Solution, constrained: np.ndarray
) -> list[str]:
    """Return the warnings about a result."""
    estimates, _, draws, variance_inflation, tension, *_ = solution
    best, warnings = estimates[0], []
    if variance_inflation > 1.0:
        warnings.append(
            f"the model does not fit the measurement within its noise: errors are multiplied by "
            f"{np.sqrt(variance_inflation):.3g}, and may still be too small"
        )
    unconstrained = [
        name
        for name, is_constrained in zip(state_vector.names, constrained, strict=True)
        if not is_constrained
    ]
    if unconstrained:
        warnings.append(f"not constrained by the measurement: {', '.join(unconstrained)}")
    for name, tension_sigma in zip(state_vector.names, tension, strict=True):
        if tension_sigma > MAX_PRIOR_TENSION:
            warnings.append(
                f"{name}: prior and measurement are {tension_sigma:.1f} standard deviations apart"
            )
    for i, name in enumerate(state_vector.names):
        low, high = (
            float(state_vector.to_physical(np.full(len(state_vector.names), x))[i])
            for x in (0.0, 1.0)
        )
        if not (constrained[i] or best.active_bounds[i]):
            continue
        if best.state[i] < BOUND_DISTANCE and low != 0.0:
            warnings.append(f"{name} lies at the low end of its range, {low:g}")
        if best.state[i] > 1.0 - BOUND_DISTANCE:
            warnings.append(f"{name} lies at the high end of its range, {high:g}")
    warnings += _list_alternatives(state_vector, solution)
    if solution.nonlinearity > MAX_NONLINEARITY:
        warnings.append(
            "errors are approximate: they use linear or interpolated reflectances, which deviate "
            f"from those of the model by up to {solution.nonlinearity:.1f} times the noise"
        )
    if draws.n_effective < MIN_EFFECTIVE_DRAWS:
        warnings.append(f"quantiles are imprecise: {draws.n_effective:.0f} effective draws")
    return warnings


def _list_alternatives(state_vector: StateVector, solution: Solution) -> list[str]:
    """Return the warnings about distinct alternative solutions."""
    best, *others = (estimate.state for estimate in solution.estimates)
    listed, warnings = [best], []
    for alternative in [*others[:1], *solution.alternatives]:
        difference = alternative - best
        is_within_error = (
            difference @ np.linalg.solve(solution.posterior.covariance, difference)
            < ALTERNATIVE_CHI2
        )
        distances = [np.abs(alternative - state).max() for state in listed]
        if is_within_error or min(distances) < MIN_SEPARATION:
            continue
        listed.append(alternative)
        is_near = np.abs(solution.draws.states - alternative).max(axis=1) < 0.5 * distances[0]
        coverage = "" if is_near.any() else ", but draws do not cover it"
        values = [
            f"{parameter} {value:.3g}"
            for parameter, value in zip(
                state_vector.names, state_vector.to_physical(alternative), strict=True
            )
        ]
        warnings.append(
            f"an alternative solution fits nearly as well{coverage}: {', '.join(values)}"
        )
    return warnings
