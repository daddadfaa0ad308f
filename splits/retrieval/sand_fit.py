"""Fit of a sand to a measured spectrum: retrieval of the parameters of SPLITS Table 2.

Every point of the unit cube is a sand within the ranges of this table (`UnitCube`).  Partitions and
textures have two coordinates each.  The coordinate is logarithmic where reflectance depends on the
logarithm of the parameter.  The noise is unknown: `splits.retrieval.gauss_newton` finds the
smallest misfit, and `splits.retrieval.least_squares` estimates the errors from it.  A spectrum
rarely constrains all parameters.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import align_to_labels, check_array_range, check_named_numbers, find_labels
from splits.core.inputs import check_incidence, check_wavelengths
from splits.core.validation import check_integer, check_range, invalid, suggest_name
from splits.instruments import spectrophotometer
from splits.media import Sand
from splits.retrieval.gauss_newton import DescentStage, Objective, search_minima
from splits.retrieval.least_squares import MIN_RESIDUAL_DOF, apply_priors, estimate_fit_covariance
from splits.retrieval.optimal_estimation import find_active_bounds
from splits.retrieval.state_vector import ParameterRange, StateVector
from splits.simulation.spectral_tally import choose_node_rows, estimate_fixed_budget

DEFAULT_RANGES: dict[str, tuple[float, float]] = {
    "iron_oxide": (0.0005, 0.05),
    "hematite_ratio": (0.0, 1.0),
    "magnetite": (0.0, 0.3),
    "pure": (0.0, 1.0),
    "coated_fraction": (0.0, 1.0),
    "fines": (0.005, 0.15),
    "clay": (1e-4, 0.1),
}
"""Default ranges, SPLITS Table 2: ``pure`` is the mass fraction of pure particles,
``coated_fraction`` the coated fraction of the others, ``fines`` silt + 1.5 clay, and ``clay`` the
mass fraction of clay, limited to fines/1.5.  Clay below the ``size_tail`` of `splits.Sand` is
negligible."""

RANGE_LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(DEFAULT_RANGES, (0.0, 1.0)),
    "fines": (0.0, 0.15),
    "clay": (0.0, 0.1),
}
"""Limits of the ranges."""

LOGARITHMIC_PARAMETERS = ("iron_oxide", "magnetite", "clay")
"""Parameters with a logarithmic coordinate, since small amounts have a large effect."""
_ZERO_START_SLOPE_RATIO = 100.0
"""Ratio of the slopes at both ends of a geometric coordinate that starts at 0."""

FITTED_KEYWORDS = ("iron_oxide", "hematite_ratio", "magnetite", "partition", "texture")
"""Keywords of `splits.Sand` that a fit varies."""


class UnitCube:
    """The unit cube of coordinates, one for every range.

    Parameters
    ----------
    fixed_keywords : mapping
        Keywords of `splits.Sand` that stay fixed.
    ranges : mapping, optional
        (low, high) by name, instead of those of `DEFAULT_RANGES`.

    Attributes
    ----------
    names : tuple of str
        Names of the coordinates.
    state_vector : StateVector
        State vector of the coordinates.
    ranges : dict

    Raises
    ------
    ValueError
        For an invalid range or keyword.
    """

    def __init__(
        self,
        fixed_keywords: Mapping[str, Any],
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.fixed_keywords = dict(fixed_keywords)
        for key in self.fixed_keywords:
            if key in FITTED_KEYWORDS:
                raise invalid(
                    key, self.fixed_keywords[key], "left out", "the fit varies it; see ranges"
                )
        self.ranges = resolve_ranges(ranges or {})
        self.names = tuple(self.ranges)
        unit = ParameterRange(0.0, 1.0, "identity")
        self.state_vector = StateVector.from_ranges(
            self.names, None, dict.fromkeys(self.names, unit)
        )
        for corner in itertools.product((0.0, 1.0), repeat=len(self.names)):
            try:
                self.to_sand(np.array(corner))
            except ValueError as error:
                raise ValueError(f"ranges: must contain valid sands only: {error}") from None

    def to_keywords(self, coordinates: np.ndarray) -> dict[str, Any]:
        """Return the keywords of the sand at a point of the cube, including the fixed ones.

        Parameters
        ----------
        coordinates : float, shape (coordinates,)
            Each 0 to 1, in the order of `names`.
        """
        coordinate_of = dict(zip(self.names, np.asarray(coordinates, dtype=float), strict=True))

        def interpolate(name: str, maximum: float = np.inf) -> float:
            low, high = self.ranges[name]
            high = min(high, maximum)
            slope_ratio = (
                (high / low if low > 0.0 else _ZERO_START_SLOPE_RATIO)
                if name in LOGARITHMIC_PARAMETERS
                else 1.0
            )
            fraction = (
                coordinate_of[name]
                if slope_ratio == 1.0
                else (slope_ratio ** coordinate_of[name] - 1.0) / (slope_ratio - 1.0)
            )
            return float(min(max(low + fraction * (high - low), low), high))

        pure = interpolate("pure")
        coated = (1.0 - pure) * interpolate("coated_fraction")
        mixed = max(1.0 - pure - coated, 0.0)
        fines = interpolate("fines")
        clay = interpolate("clay", fines / 1.5)
        silt = max(fines - 1.5 * clay, 0.0)
        return {
            **self.fixed_keywords,
            "iron_oxide": interpolate("iron_oxide"),
            "hematite_ratio": interpolate("hematite_ratio"),
            "magnetite": interpolate("magnetite"),
            "partition": (pure, mixed, coated),
            "texture": (clay, silt, 1.0 - clay - silt),
        }

    def to_sand(self, coordinates: np.ndarray) -> Sand:
        """Return the sand at a point of the cube."""
        return Sand(**self.to_keywords(coordinates))

    def to_parameters(self, coordinates: np.ndarray) -> dict[str, float]:
        """Return the parameters at a point of the cube by name."""
        keywords = self.to_keywords(coordinates)
        partition = zip(("pure", "mixed", "coated"), keywords["partition"], strict=True)
        return {
            **{name: keywords[name] for name in ("iron_oxide", "hematite_ratio", "magnetite")},
            **{f"partition_{name}": value for name, value in partition},
            **dict(zip(("clay", "silt", "sand"), keywords["texture"], strict=True)),
        }


def resolve_ranges(given: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return `DEFAULT_RANGES` with given ones replaced; reject invalid ranges."""
    ranges = dict(DEFAULT_RANGES)
    for name, values in given.items():
        if name not in DEFAULT_RANGES:
            allowed = "one of " + ", ".join(DEFAULT_RANGES)
            raise invalid("ranges", name, allowed, suggest_name(name, DEFAULT_RANGES))
        low, high = check_named_numbers(
            f"ranges.{name}", values, ("low", "high"), RANGE_LIMITS[name]
        )
        for bound, value in (("low", low), ("high", high)):
            check_range(f"ranges.{name} ({bound})", value, *RANGE_LIMITS[name])
        if not low < high:
            raise invalid(f"ranges.{name}", values, "low < high")
        ranges[name] = (low, high)
    if 1.5 * ranges["clay"][0] > ranges["fines"][0]:
        raise invalid(
            "ranges.clay (low)",
            ranges["clay"][0],
            f"at most {ranges['fines'][0] / 1.5:g}",
            "all clay counts 1.5 times among the fines",
        )
    return ranges


@dataclass(frozen=True)
class FittedParameter:
    """A fitted parameter and its error.

    Attributes
    ----------
    value : float
        A mass fraction, or the fraction of hematite in the iron oxide.
    stderr : float
        Standard error, the root-mean-square deviation of the posterior from the value.
    constrained : bool
        Whether the error, in ranks among all sands of the ranges, is below half of that without a
        measurement.
    """

    value: float
    stderr: float
    constrained: bool


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """Result of a fit of a sand.

    Attributes
    ----------
    parameters : dict of FittedParameter
        iron_oxide, hematite_ratio, magnetite, partition_pure, partition_mixed,
        partition_coated, clay, silt, sand.
    settings : dict
        Keywords of `splits.Sand` for the fitted sand, including the fixed ones.
    rmse, rmse_stderr : float
        Root-mean-square misfit of `spectrum`, and an upper bound of its standard error from
        simulation noise.
    wavelength_nm, measured, modelled, modelled_stderr : float, shape (wavelengths,)
    spectrum : xarray.Dataset
        Final simulation, see `splits.spectrophotometer`.
    names : tuple of str
        Names of the coordinates, see `DEFAULT_RANGES`.
    coordinates, coordinates_stderr : float, shape (coordinates,)
        Coordinates in the unit cube.  The error of an unconstrained one in the middle of its range
        is 1/√12.
    correlation : float, shape (coordinates, coordinates)
    alternatives : list of (float, dict)
        Misfit and parameters of the minima of the first stage, best first.  Different values at
        nearly the same misfit indicate several solutions.  These misfits, unlike `rmse`, are from
        few rays.
    evaluations : int
        Number of sands simulated.
    seconds : float
        Wall time.
    """

    parameters: dict[str, FittedParameter]
    settings: dict[str, Any]
    rmse: float
    rmse_stderr: float
    wavelength_nm: np.ndarray
    measured: np.ndarray
    modelled: np.ndarray
    modelled_stderr: np.ndarray
    spectrum: xr.Dataset
    names: tuple[str, ...]
    coordinates: np.ndarray
    coordinates_stderr: np.ndarray
    correlation: np.ndarray
    alternatives: list[tuple[float, dict[str, float]]]
    evaluations: int
    seconds: float

    def __repr__(self) -> str:
        """Return the misfit, and one line per parameter with its error."""
        lines = [f"misfit {self.rmse:.4f} ± {self.rmse_stderr:.4f}"]
        for name, parameter in self.parameters.items():
            note = "constrained" if parameter.constrained else "not constrained"
            lines.append(f"{name:16} {parameter.value:.4f} ± {parameter.stderr:.4f}  {note}")
        return "\n".join(lines)


@dataclass(frozen=True)
class Effort:
    """Computational effort of a fit.

    Attributes
    ----------
    points : int
        Number of sands in the survey, a power of 2.
    starts : tuple of int
        Number of the best sands from which each stage of descents starts.
    evaluations : tuple of int
        Largest number of simulations per descent, by stage.
    rays : tuple of int
        Rays per node of the survey and of every stage.
    max_stderr : float
        Standard error of the final spectrum, 1e-6 to 0.5.
    """

    points: int = 128
    starts: tuple[int, ...] = (6, 3, 1)
    evaluations: tuple[int, ...] = (40, 40, 40)
    rays: tuple[int, ...] = (512, 512, 2048, 16_384)
    max_stderr: float = 0.002

    def __post_init__(self) -> None:
        if not len(self.starts) == len(self.evaluations) == len(self.rays) - 1:
            raise invalid("effort", self, "starts, evaluations and rays for the same stages")


class SandForwardModel:
    """Forward model of sands with a fixed number of rays, see `splits.retrieval.gauss_newton`.

    Parameters
    ----------
    cube : UnitCube
    wavelengths : float, shape (wavelengths,)
        Wavelengths (nm).
    incidence : float or "diffuse"
    effort : Effort
    seed : int
    threads : int, optional

    Attributes
    ----------
    n_simulations : int
        Number of sands simulated so far.
    """

    bound_margin = 0.0

    def __init__(
        self,
        cube: UnitCube,
        wavelengths: np.ndarray,
        incidence: float | str,
        effort: Effort,
        seed: int,
        threads: int | None,
    ) -> None:
        self.cube, self.state_vector = cube, cube.state_vector
        self.wavelengths_nm, self.incidence, self.threads = wavelengths, incidence, threads
        self.n_rays = effort.rays
        self.n_simulations = 0
        n_seeds = len(effort.rays) + N_JACOBIANS + 1
        states = np.random.SeedSequence(seed).generate_state(n_seeds)
        self.seeds = [int(state) for state in states]
        """Seeds of the survey and every stage, of the Jacobians, and of the final spectrum."""
        self._last_result: tuple[bytes, int, np.ndarray] = (b"", 0, np.empty(0))

    def _simulate(self, state: np.ndarray, rays: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return reflectance and its batch deviations."""
        self.n_simulations += 1
        mean, _, batches = estimate_fixed_budget(
            self.cube.to_sand(state), self.wavelengths_nm, self.incidence,
            choose_node_rows(len(self.wavelengths_nm)), rays, seed, self.threads,
        )  # fmt: skip
        return mean[0], batches[:, 0]

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return reflectance with the rays of a stage, shape (wavelengths,)."""
        if self._last_result[:2] != (state.tobytes(), stage):
            reflectance = self._simulate(state, self.n_rays[stage], self.seeds[stage])[0]
            self._last_result = state.tobytes(), stage, reflectance
        return self._last_result[2]

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the Jacobian by one-sided differences inside the cube."""
        reflectance, columns = self.evaluate(state, stage), []
        for i, coordinate in enumerate(state):
            shifted = state.copy()
            shifted[i] += JACOBIAN_STEP if coordinate + JACOBIAN_STEP <= 1.0 else -JACOBIAN_STEP
            columns.append(
                (self.evaluate(shifted, stage) - reflectance) / (shifted[i] - coordinate)
            )
        return np.column_stack(columns)

    def noise(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the noise common to all simulations of the last stage."""
        batches = self._simulate(state, self.n_rays[-1], self.seeds[len(self.n_rays) - 1])[1]
        covariance: np.ndarray = batches.T @ batches
        return covariance

    def compute_jacobians(self, state: np.ndarray) -> list[np.ndarray]:
        """Return independent Jacobians, each with its own random numbers."""
        first = len(self.n_rays)
        rays = max(self.n_rays[-1] // _JACOBIAN_RAYS_DIVISOR, 1)

        def simulate(seed: int, x: np.ndarray) -> np.ndarray:
            return self._simulate(x, rays, seed)[0]

        return [
            compute_central_differences(partial(simulate, seed), state)
            for seed in self.seeds[first : first + N_JACOBIANS]
        ]


def compute_central_differences(
    model: Callable[[np.ndarray], np.ndarray], x: np.ndarray
) -> np.ndarray:
    """Return the Jacobian by central differences, clipped to the cube."""
    columns = []
    for i in range(len(x)):
        upper, lower = x.copy(), x.copy()
        upper[i] = min(x[i] + 2.0 * JACOBIAN_STEP, 1.0)
        lower[i] = max(x[i] - 2.0 * JACOBIAN_STEP, 0.0)
        columns.append((model(upper) - model(lower)) / (upper[i] - lower[i]))
    return np.column_stack(columns)


JACOBIAN_STEP = 0.05
"""Step of a coordinate for derivatives, large enough compared with uncorrelated noise."""
N_JACOBIANS = 4
"""Number of independent Jacobians for the errors."""
_JACOBIAN_RAYS_DIVISOR = 8
"""Ratio of the rays of the last stage to those of a Jacobian, whose noise causes no bias."""


def fit(
    base_settings: Mapping[str, Any],
    wavelength_nm: Any,
    measured: Any,
    incidence_deg: float | str,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 1,
    threads: int | None = None,
    log: Callable[[str], None] = lambda line: None,
    *,
    effort: Effort | None = None,
) -> FitResult:
    """Find the sand whose reflectance is closest to a measured one.

    Parameters
    ----------
    base_settings : mapping
        Keywords of `splits.Sand` that stay fixed, for example ``refractive_index``.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), at least two more than coordinates.
    measured : array_like
        Hemispherical reflectance there, 0 to 1.
    incidence_deg : float or "diffuse"
        Polar angle of the beam in the measurement, 0 to 89.9999 degrees.
    ranges : mapping, optional
        (low, high) by name, instead of those of `splits.retrieval.sand_fit.DEFAULT_RANGES`.
    seed : int
        Non-negative; the same seed gives the same result on any number of threads.
    threads : int, optional
    log : callable
        Receives lines of progress.
    effort : Effort, optional

    Raises
    ------
    ValueError
        For a value outside its range.
    """
    # Imported here, as it would slow the start of the workflow by a second.
    from scipy.stats import qmc

    start_time = time.perf_counter()
    effort = effort or Effort()
    wavelengths = check_wavelengths("wavelength_nm", wavelength_nm)
    target = check_measured_reflectance(measured, wavelengths, find_labels(wavelength_nm))
    cube = UnitCube(base_settings, ranges)
    min_wavelengths = len(cube.names) + MIN_RESIDUAL_DOF
    if len(wavelengths) < min_wavelengths:
        allowed = f"{min_wavelengths} wavelengths at least"
        raise invalid("wavelength_nm", wavelengths.tolist(), allowed)
    incidence = check_incidence("incidence_deg", incidence_deg)
    seed = check_integer("seed", seed, 0)
    model = SandForwardModel(cube, wavelengths, incidence, effort, seed, threads)

    def log_stage(_: int, cost: float) -> None:
        log(f"{model.n_simulations} sands, best misfit {compute_misfit(cost):.4f}")

    def compute_misfit(cost: float) -> float:
        return float(np.sqrt(cost / len(target)))

    survey_states = qmc.Sobol(len(cube.names), seed=model.seeds[0]).random(effort.points)
    stages = [DescentStage(*pair) for pair in zip(effort.starts, effort.evaluations, strict=True)]
    objective = Objective.least_squares(target, model.state_vector)
    stage_minima = search_minima(
        model, lambda state, stage: objective, survey_states, stages, log_stage
    )
    misfit = compute_misfit(stage_minima[-1][0].cost)
    log(f"{model.n_simulations} sands, best misfit {misfit:.4f}; errors follow")
    best = stage_minima[-1][0].state
    spectrum = spectrophotometer(
        cube.to_sand(best), wavelengths, incidence, max_stderr=effort.max_stderr,
        seed=model.seeds[-1],
        threads=threads,
    )  # fmt: skip
    modelled, stderr = spectrum.reflectance.values, spectrum.reflectance_stderr.values
    residual = modelled - target
    jacobians = model.compute_jacobians(best)
    active_bounds = find_active_bounds(best, np.mean(jacobians, axis=0).T @ residual)
    covariance, _ = estimate_fit_covariance(jacobians, residual, model.noise(best), active_bounds)
    draws = apply_priors(cube.state_vector, best, covariance, seed).draws.states
    value, value_stderr = _compute_rms(residual), _compute_rms(stderr)
    seconds = time.perf_counter() - start_time
    log(f"{model.n_simulations} sands, rmse {value:.4f} ± {value_stderr:.4f}, {seconds:.0f} s")
    return FitResult(
        parameters=estimate_parameter_errors(cube, best, draws),
        settings=cube.to_keywords(best),
        rmse=value,
        rmse_stderr=value_stderr,
        wavelength_nm=wavelengths,
        measured=target,
        modelled=modelled,
        modelled_stderr=stderr,
        spectrum=spectrum,
        names=cube.names,
        coordinates=best,
        coordinates_stderr=np.sqrt(np.mean((draws - best) ** 2, axis=0)),
        correlation=np.corrcoef(draws, rowvar=False),
        alternatives=[
            (compute_misfit(minimum.cost), cube.to_parameters(minimum.state))
            for minimum in stage_minima[0]
        ],
        evaluations=model.n_simulations,
        seconds=seconds,
    )


def check_measured_reflectance(
    measured: Any, wavelengths: np.ndarray, labels: Any = None
) -> np.ndarray:
    """Return measured reflectances in the order of wavelengths; reject values outside [0, 1].

    Parameters
    ----------
    measured : array_like
    wavelengths : float, shape (wavelengths,)
        In nm.
    labels : sequence, optional
        Labels of the wavelengths, by which labelled values are ordered.
    """
    values = align_to_labels("measured", measured, wavelengths, labels, allowed="numbers in [0, 1]")
    if values.shape != wavelengths.shape:
        allowed = f"{wavelengths.size} numbers, one for each wavelength"
        raise invalid("measured", f"of shape {values.shape}", allowed)
    return check_array_range("measured", values, 0.0, 1.0)


def estimate_parameter_errors(
    cube: UnitCube, best: np.ndarray, draws: np.ndarray
) -> dict[str, FittedParameter]:
    """Return the parameters with errors, from draws of the posterior.

    Whether a parameter is constrained is decided by ranks among sands drawn from the whole cube,
    which do not depend on the scale of the parameter.
    """
    uniform = np.random.default_rng(1).random(draws.shape)
    posterior_samples, prior_samples = (
        [cube.to_parameters(state) for state in states] for states in (draws, uniform)
    )
    parameters = {}
    for name, value in cube.to_parameters(best).items():
        values = np.array([sample[name] for sample in posterior_samples])
        ordered = np.sort([sample[name] for sample in prior_samples])
        rank, ranks = np.searchsorted(ordered, value), np.searchsorted(ordered, values)
        prior_spread = _compute_rms(np.arange(len(ordered)) - rank)
        parameters[name] = FittedParameter(
            value,
            _compute_rms(values - value),
            bool(_compute_rms(ranks - rank) < 0.5 * prior_spread),
        )
    return parameters


def _compute_rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
