"""Forward models of a medium without a table: descents to the most probable medium.

The spectra are simulations, with derivatives from the same paths, or solutions by discrete
ordinates, without noise.  Near the minimum, reflectance is assumed to be linear in the coordinates.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.declarations import check_alternatives
from splits.core.inputs import check_incidence
from splits.core.progress import Progress, ProgressCallback
from splits.core.validation import (
    InvalidValue,
    invalid,
    key_prefix,
    unknown_key,
)
from splits.discrete_ordinates.applicability import (
    find_parameter_obstacle,
    make_granular_stack,
)
from splits.discrete_ordinates.granular_stack import (
    choose_trial_wavelengths,
    compute_optics_error,
    solve_snowpacks,
    solve_spectrum,
)
from splits.illumination.bands import choose_band_wavelengths
from splits.instruments.solver import DISCRETE_ORDINATES, MONTE_CARLO, choose_solver
from splits.instruments.spectrophotometer import spectrophotometer
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.media.parameters import (
    ALTERNATIVES,
    INCIDENCE_KEY,
    check_single_parts,
    get_parameter,
    replace_parameter,
    replace_parameters,
)
from splits.retrieval.forward_model import (
    ERROR_CORRELATION_NM,
    SCALE_RANGE,
    make_measurement_operator,
)
from splits.retrieval.linearization import (
    BOUND_MARGIN,
    Minima,
    is_jacobian_noisy,
    minimize_gauss_newton,
)
from splits.retrieval.measurement import Measurement, correlate_errors
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MIN_SEPARATION,
    MIN_START_SEPARATION,
    Objective,
    compute_whitening,
    select_distinct,
)
from splits.retrieval.state_vector import SCALE, ParameterRange, StateVector
from splits.simulation.threads import limit_blas_threads
from splits.tables.axes import check_axis_values
from splits.tables.interpolation import transform_axis

SURVEY_RANGE = (16, 128)
"""Smallest and largest number of states of the survey."""
MAX_EVALUATIONS = 60
"""Approximate limit of simulations per descent."""


# Of each stage: half the edge of the first trust region, the smallest distance between the
# coordinates of two starts, and the largest excess of the cost of a start over that of the best.
DESCENT_STAGES = (
    (0.3, MIN_START_SEPARATION, np.inf),
    (0.15, MIN_SEPARATION, ALTERNATIVE_CHI2),
)
"""Stages of descents: from the best states of the survey, which is stage 0, and with the final
accuracy near the minimum.  Each stage has its own random numbers and more rays."""
LAST_STAGE = len(DESCENT_STAGES)


def count_survey(n_parameters: int) -> int:
    """Return the number of states of the survey, on average two along each coordinate."""
    return int(np.clip(2**n_parameters, *SURVEY_RANGE))


MAX_ERROR = 1e-3
"""Error that determines the number of streams, by default."""
DIFFERENCE_STEP = 1e-4
"""Step of coordinates for differences, whose relative error is about half of this."""
N_STARTS = {MONTE_CARLO: 2, DISCRETE_ORDINATES: 4}
"""Largest number of descents of a stage by solver; ordinates take little time, so that more of them
look for alternative solutions."""
SURVEY_STDERR = 0.01
"""Standard error of simulations of the survey and of the first descents."""
MIN_JACOBIAN_STDERR = 0.004
"""Smallest standard error of simulations for Jacobians, of which several are averaged."""
N_JACOBIANS_RANGE = (2, 6)
"""Smallest and largest number of independent Jacobians for the errors."""
NOISE_FRACTION = 0.5
"""Ratio of the final standard error to the smallest noise of the measurement."""
MIN_STDERR, MAX_STDERR = 1e-3, 0.01
"""Limits of the final standard error."""
UNKNOWN_NOISE_MAX_STDERR = 2e-3
"""Final standard error for unknown noise."""


class ProgressTracker:
    """Progress of a retrieval over all of its simulations.

    Parameters
    ----------
    report : callable, optional
    max_stderr : float
        Final standard error.
    n_parameters : int
    """

    def __init__(self, report: ProgressCallback, max_stderr: float, n_parameters: int) -> None:
        self.report, self.max_stderr = report, max_stderr
        final_cost, jacobian_cost = (
            _estimate_cost(max_stderr),
            count_runs(n_parameters) * _estimate_cost(max(max_stderr, MIN_JACOBIAN_STDERR)),
        )
        # Each descent needs about two Jacobians and a few steps; descents of the last stage mostly
        # start at the minimum.  Jacobians for errors and the test of linearity follow.
        descent_cost = N_STARTS[MONTE_CARLO] * 2 * (2 + count_runs(n_parameters))
        survey_cost = count_survey(n_parameters) + descent_cost
        last_stage_cost = N_STARTS[MONTE_CARLO] * (4 * final_cost + jacobian_cost)
        self.total_cost = (
            survey_cost
            + last_stage_cost
            + float(np.mean(N_JACOBIANS_RANGE)) * jacobian_cost
            + 2 * n_parameters * final_cost
        )
        self.spent_cost, self.start_time = 0.0, time.perf_counter()

    def track_run(self, max_stderr: float, n_runs: int) -> ProgressCallback:
        """Return the callback for the progress of several simulations with an error."""
        if not callable(self.report):
            return None
        cost, report = n_runs * _estimate_cost(max_stderr), self.report
        previous_cost = self.spent_cost
        self.spent_cost += cost

        def show(progress: Progress) -> None:
            elapsed = time.perf_counter() - self.start_time
            done = previous_cost + progress.fraction_done * cost
            seconds_left = (
                max(self.total_cost - done, 0.0) * elapsed / done
                if done > 0.0
                else progress.seconds_left
            )
            report(
                Progress(
                    progress.rays,
                    progress.stderr,
                    self.max_stderr,
                    elapsed,
                    max(seconds_left, progress.seconds_left),
                )
            )

        return show


def count_runs(n_parameters: int) -> int:
    """Return the typical number of simulations for a spectrum and its derivatives."""
    return 1 + 5 * n_parameters


def _estimate_cost(max_stderr: float) -> float:
    """Return the cost of a simulation with an error, in units of those of the survey."""
    return (SURVEY_STDERR / max_stderr) ** 2


class MediumModel:
    """Forward model of a medium, with stages of increasing accuracy.

    Discrete ordinates are used where they apply, see `choose_solver`.  They have no noise, all
    stages but the last use a few of the wavelengths, and derivatives are differences of solutions,
    which need one solution per parameter and hold for dry and for wet snow.  Otherwise, spectra
    are simulated, with derivatives from the same paths.

    Parameters
    ----------
    medium : Medium
    measurement : Measurement
    state_vector : StateVector
        See `splits.retrieval.medium_model.make_medium_state_vector`.
    incidence : float or "diffuse"
    solver : str
    max_stderr : float, optional
        Error that determines the number of streams, by default `MAX_ERROR`; or the standard error
        of the last simulations, by default `NOISE_FRACTION` of the smallest noise.
    seed : int
        Of the survey, and of simulations.
    progress : callable, optional
    **options
        Other options of `splits.spectrophotometer`: the number of rays, threads and the kernel.
    """

    def __init__(
        self, medium: Medium, measurement: Measurement, state_vector: StateVector,
        incidence: float | str, solver: str, max_stderr: float | None, seed: int,
        progress: ProgressCallback, **options: Any,
    ) -> None:  # fmt: skip
        self.medium, self.measurement, self.state_vector = medium, measurement, state_vector
        self.incidence, self.seed, self._options = incidence, seed, options
        self.wavelengths = (
            choose_band_wavelengths(measurement.bands)
            if measurement.bands
            else np.unique(measurement.wavelength_nm)
        )
        self.operator = make_measurement_operator(measurement, self.wavelengths).weights
        self.names = [name for name in state_vector.names if name != SCALE]
        self.rows = [state_vector.names.index(name) for name in self.names]
        self.scale_row = state_vector.names.index(SCALE) if SCALE in state_vector.names else None
        self._cache: dict[tuple[bytes, int], Any] = {}
        self.solver = MONTE_CARLO
        if solver != MONTE_CARLO:
            self.solver = choose_solver(
                solver, self.list_extreme_media(), self.wavelengths,
                find_further_obstacle=lambda one: find_parameter_obstacle(one, self.names),
            ).solver  # fmt: skip
        if self.is_exact:
            # The number of streams that an error requires in the middle of all ranges.
            medium, incidence, _ = self.make_inputs(np.full(len(state_vector.names), 0.5))
            stack = make_granular_stack(medium, self.wavelengths)
            with limit_blas_threads():
                solution = solve_spectrum(
                    stack, _compute_cosines(incidence), max_stderr or MAX_ERROR
                )
            self.n_streams, self._truncation = solution.n_streams, solution.truncation
            return
        min_noise = float(np.sqrt(np.diag(measurement.covariance).min()))
        default_stderr = (
            min(max(NOISE_FRACTION * min_noise, MIN_STDERR), MAX_STDERR)
            if measurement.noise_known
            else UNKNOWN_NOISE_MAX_STDERR
        )
        self.max_stderr = max_stderr or default_stderr
        self._progress = ProgressTracker(progress, self.max_stderr, len(state_vector.names))

    @property
    def is_exact(self) -> bool:
        """Whether the model has no noise."""
        return self.solver != MONTE_CARLO

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements of the last stage, shape (states, n)."""
        return np.array([self.evaluate_state(state, LAST_STAGE) for state in states])

    def evaluate_state(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the modelled measurement of one state, shape (n,)."""
        if not self.is_exact:
            return self._simulate_with_covariance(state, stage)[0]
        key = (state.tobytes(), stage)
        if key not in self._cache:
            self._cache[key] = self._solve([state], stage)[0]
        return self._cache[key]  # type: ignore[no-any-return]

    def error_covariance(self, state: np.ndarray, stage: int = LAST_STAGE) -> np.ndarray:
        """Return the covariance of the errors of the model, shape (n, n).

        Errors of the tables of grains and of streams are correlated over `ERROR_CORRELATION_NM`.
        """
        if not self.is_exact:
            return self._simulate_with_covariance(state, stage)[1]
        medium, _, scale = self.make_inputs(state)
        optics = compute_optics_error(make_granular_stack(medium, self.wavelengths))
        stderr = scale * np.hypot(optics, self._truncation)
        covariance = correlate_errors(stderr, self.wavelengths, ERROR_CORRELATION_NM)
        operator = self.operator[self.select_values(stage)]
        return operator @ covariance @ operator.T

    def jacobian(
        self, state: np.ndarray, stage: int = LAST_STAGE, seed: int | None = None
    ) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        if self.is_exact:
            steps = np.where(state > 0.5, -DIFFERENCE_STEP, DIFFERENCE_STEP)
            shifted = self._solve(state + np.diag(steps), stage)
            return (shifted - self.evaluate_state(state, stage)).T / steps
        error = max(self.get_stage_stderr(stage), MIN_JACOBIAN_STDERR)
        seed = self.seed if seed is None else seed
        spectrum, scale = self.simulate(state, error, self.names, seed)
        step = 1e-6
        low, high = np.clip(state - step, 0.0, 1.0), np.clip(state + step, 0.0, 1.0)
        to_physical = self.state_vector.to_physical
        rates = (to_physical(high) - to_physical(low)) / (high - low)
        jacobian = np.empty((len(self.operator), len(state)))
        jacobian[:, self.rows] = scale * (self.operator @ spectrum.reflectance_jacobian.values.T)
        if self.scale_row is not None:
            jacobian[:, self.scale_row] = self.operator @ spectrum.reflectance.values
        return jacobian * rates

    def compute_final_jacobians(self, state: np.ndarray) -> list[np.ndarray]:
        """Return at least two independent Jacobians of the last stage; the same without noise.

        Simulations have independent random numbers, and are as many as their noise requires.
        """
        if self.is_exact:
            return [self.jacobian(state)] * 2
        jacobians: list[np.ndarray] = []
        min_jacobians, max_jacobians = N_JACOBIANS_RANGE
        covariance = self.measurement.covariance + self.error_covariance(state)
        while len(jacobians) < min_jacobians or (
            self.measurement.noise_known
            and len(jacobians) < max_jacobians
            and is_jacobian_noisy(jacobians, covariance)
        ):
            jacobians.append(self.jacobian(state, seed=self.seed + 1 + len(jacobians)))
        return jacobians

    def select_values(self, stage: int) -> np.ndarray:
        """Return the positions of the measured values that a stage uses."""
        n_values = self.measurement.values.size
        if not self.is_exact or stage == LAST_STAGE or self.measurement.bands:
            return np.arange(n_values)
        return choose_trial_wavelengths(n_values)

    def get_stage_stderr(self, stage: int) -> float:
        """Return the standard error of the simulations of a stage."""
        return self.max_stderr if stage == LAST_STAGE else max(SURVEY_STDERR, self.max_stderr)

    def make_inputs(self, state: np.ndarray) -> tuple[Medium, float | str, float]:
        """Return the medium, the incidence and the scale of a state."""
        physical = self.state_vector.to_physical(state)
        values = {n: float(physical[row]) for row, n in zip(self.rows, self.names, strict=True)}
        incidence = values.pop(INCIDENCE_KEY, self.incidence)
        medium = replace_parameters(self.medium, values)
        scale = 1.0 if self.scale_row is None else float(physical[self.scale_row])
        return medium, incidence, scale

    def make_objective(self, state: np.ndarray, stage: int) -> Objective:
        """Return the objective near a state, with the errors of measurement and model."""
        positions = self.select_values(stage)
        measured, whitening = self.measurement.values[positions], np.eye(positions.size)
        if self.measurement.noise_known:
            covariance = self.measurement.covariance[np.ix_(positions, positions)]
            whitening = compute_whitening(covariance + self.error_covariance(state, stage))
        return Objective(measured, whitening, self.state_vector)

    def list_extreme_media(self) -> list[Medium]:
        """Return the media in the middle (first) and at the corners of the ranges of each layer.

        Corners without a medium are left out, such as more water than fits into dense snow.
        """
        middle = np.full(len(self.state_vector.names), 0.5)
        media, by_layer = [self.make_inputs(middle)[0]], defaultdict(list)
        for row, name in zip(self.rows, self.names, strict=True):
            if name != INCIDENCE_KEY:
                by_layer[name.split(".")[1] if name.startswith("layers.") else ""].append(row)
        for rows in by_layer.values():
            for corner in product((BOUND_MARGIN, 1.0 - BOUND_MARGIN), repeat=len(rows)):
                state = middle.copy()
                state[rows] = corner
                with suppress(InvalidValue):
                    media.append(self.make_inputs(state)[0])
        return media

    def find_minima(self) -> tuple[Minima, list[np.ndarray]]:
        """Return separated minima, best first, and independent Jacobians at the best one."""
        from scipy.stats import qmc

        state_vector = self.state_vector
        n_parameters = len(state_vector.names)
        survey_states = qmc.Sobol(n_parameters, seed=self.seed).random(count_survey(n_parameters))
        has_prior = np.isfinite(state_vector.prior_sd)
        survey_states[:, has_prior] = (
            state_vector.prior_mean[has_prior]
            + (survey_states[:, has_prior] - 0.5) * state_vector.prior_sd[has_prior]
        )
        survey_states = np.clip(survey_states, 0.02, 0.98)
        objective = self.make_objective(survey_states[0], 0)
        minima = []
        for state in survey_states:
            residuals = objective.compute_residuals(self.evaluate_state(state, 0), state)
            minima.append((float(residuals @ residuals), state))
        for stage, (radius, separation, max_increase) in enumerate(DESCENT_STAGES, 1):
            costs, states = zip(*minima, strict=True)
            selected = select_distinct(
                costs, states, N_STARTS[self.solver], separation, max_increase
            )
            objective = self.make_objective(states[selected[0]], stage)
            minima = [
                minimize_gauss_newton(
                    partial(self.evaluate_state, stage=stage),
                    partial(self.jacobian, stage=stage),
                    states[i], objective, MAX_EVALUATIONS, radius,
                )
                for i in selected
            ]  # fmt: skip
            minima.sort(key=lambda minimum: minimum[0])
        (_, best), *others = minima
        distinct = [one for one in others if np.abs(one[1] - best).max() > MIN_SEPARATION]
        return [minima[0], *distinct], self.compute_final_jacobians(best)

    def _solve(self, states: Sequence[np.ndarray], stage: int) -> np.ndarray:
        """Return the modelled measurements of states, shape (states, n)."""
        operator = self.operator[self.select_values(stage)]
        used = np.flatnonzero(operator.any(axis=0))
        media, incidences, scales = zip(*map(self.make_inputs, states), strict=True)
        snowpacks = [make_granular_stack(medium, self.wavelengths[used]) for medium in media]
        cosines = np.array([_compute_cosines(incidence) for incidence in incidences])
        with limit_blas_threads():
            reflectance = solve_snowpacks(snowpacks, cosines, self.n_streams)[:, 0]
        return np.array(scales)[:, np.newaxis] * (reflectance @ operator[:, used].T)

    def simulate(
        self, state: np.ndarray, max_stderr: float, names: list[str], seed: int
    ) -> tuple[Any, float]:
        """Return a simulation at a state with derivatives by some parameters, and the scale."""
        medium, incidence, scale = self.make_inputs(state)
        spectrum = spectrophotometer(
            medium, self.wavelengths, incidence, max_stderr=max_stderr, seed=seed,
            solver=MONTE_CARLO, jacobian=names, **self._options,
            progress=self._progress.track_run(max_stderr, count_runs(len(names))),
        )  # fmt: skip
        return spectrum, scale

    def _simulate_with_covariance(
        self, state: np.ndarray, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and the covariance of its noise."""
        key = (state.tobytes(), stage)
        if key not in self._cache:
            spectrum, scale = self.simulate(state, self.get_stage_stderr(stage), [], self.seed)
            values = scale * (self.operator @ spectrum.reflectance.values)
            batches = scale * spectrum.reflectance_batches.values @ self.operator.T
            stderr = scale * np.abs(self.operator) @ spectrum.reflectance_stderr.values
            covariance = batches.T @ batches
            covariance += np.diag(np.maximum(stderr**2 - np.diag(covariance), 0.0))
            self._cache[key] = values, covariance
        return self._cache[key]  # type: ignore[no-any-return]


def _compute_cosines(incidence: float | str) -> np.ndarray:
    """Return the cosines of the beams: none for isotropic light."""
    angles = [] if isinstance(incidence, str) else [incidence]
    return np.cos(np.radians(angles))


def make_medium_state_vector(
    medium: Any, ranges: Any, prior: Any, incidence: float | str
) -> StateVector:
    """Return the state vector of a medium's free parameters.

    Parameters
    ----------
    medium : Medium
    ranges : mapping
        (low, high) by name, for parameters of derivatives, ``incidence_deg`` and ``scale``.
    prior : mapping or None
    incidence : float or "diffuse"

    Raises
    ------
    ValueError
        For an unknown parameter, or a range outside the limits of the medium.
    """
    check_medium(medium, allow_semi_infinite=True)
    if not isinstance(ranges, Mapping):
        hint = 'such as {"optical_radius_um": (50, 1500)}; only a table has default ranges'
        raise invalid("free", ranges, "a mapping of names to (low, high)", hint)
    with key_prefix("free"):
        check_alternatives(ALTERNATIVES, {str(name): pair for name, pair in ranges.items()})
        check_single_parts(map(str, ranges))
    allowed_ranges: dict[str, ParameterRange] = {SCALE: ParameterRange(*SCALE_RANGE, "identity")}
    for name, pair in ranges.items():
        if name == SCALE:
            continue
        if name != INCIDENCE_KEY:
            get_parameter(medium, name, [INCIDENCE_KEY, SCALE])
        elif incidence == "diffuse":
            raise unknown_key(f"free.{name}", ["scale"])
        limits = np.array(check_named_numbers(f"free.{name}", pair, ("low", "high")))
        if not limits[0] < limits[1]:
            raise invalid(f"free.{name}", pair, "low < high")
        for value in limits:
            if name == INCIDENCE_KEY:
                check_incidence(name, float(value))
                continue
            try:
                replace_parameter(medium, name, float(value))
            except InvalidValue as error:
                # The parameter may be in a layer, or a part of a whole.
                is_own = f".{name}".endswith(f".{error.key}")
                allowed = error.allowed if is_own else "a valid value of the medium"
                hint = error.hint if is_own else str(error)
                raise invalid(f"free.{name}", float(value), allowed, hint) from None
        middle = np.array([limits[0], 0.5 * limits.sum(), limits[1]])
        allowed_ranges[name] = ParameterRange(
            float(limits[0]), float(limits[1]), transform_axis(name, middle)[0]
        )
    return StateVector.from_ranges(dict(ranges), prior, allowed_ranges)


def check_measurement_incidence(fixed: Mapping[str, Any] | None, ranges: Any) -> float | str:
    """Return the incidence of a measurement of a medium; reject an invalid one."""
    free = ranges if isinstance(ranges, Mapping) else ()
    return check_incidence(
        "incidence_deg",
        check_axis_values(fixed, [INCIDENCE_KEY], "fixed.", free_axes=free).get(INCIDENCE_KEY, 0.0),
    )
