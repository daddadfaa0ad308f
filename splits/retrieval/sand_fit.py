"""Which sand has a measured spectrum: a retrieval of what SPLITS Table 2 leaves open.

Every place of the unit cube is a sand (`splits.retrieval.sand_parameters.UnitCube`).  Noise is not
told: `splits.retrieval.gauss_newton` finds the least misfit, `splits.retrieval.least_squares` what
that leaves open.  A spectrum seldom fixes all parameters: the error of each says how far it may
move before the misfit tells.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from splits.core.arrays import align_to_labels, check_array_range, find_labels
from splits.core.optional import import_optional
from splits.core.validation import invalid
from splits.instruments import spectrophotometer
from splits.retrieval.gauss_newton import DescentStage, LocalMinimum, Objective, search_minima
from splits.retrieval.least_squares import apply_priors
from splits.retrieval.optimal_estimation import find_active_bounds
from splits.retrieval.residual_covariance import MIN_RESIDUAL_DOF, estimate_fit_covariance
from splits.retrieval.sand_parameters import FitResult, FittedParameter, UnitCube
from splits.simulation.arguments import check_incidence, check_integer, check_wavelengths
from splits.simulation.fixed_budget import choose_node_rows, estimate_fixed_budget

JACOBIAN_STEP = 0.05
"""Difference of a coordinate for derivatives: large enough against what noise is not shared."""
N_JACOBIANS = 4
"""Independent Jacobians behind the errors."""
_JACOBIAN_RAYS_DIVISOR = 8
"""The last stage's rays over those of each: there are many, and noise in them does not bias."""


@dataclass(frozen=True)
class Effort:
    """How much a fit may cost.

    Attributes
    ----------
    points : int
        Sands of the first survey, a power of 2.
    starts : tuple of int
        How many of the best sands each stage of descent begins with, the survey's first.
    evaluations : tuple of int
        Simulations that each descent may take, by stage.
    rays : tuple of int
        Rays per node of the survey and of every stage.
    max_stderr : float
        Standard error of the last spectrum, 1e-6 to 0.5.
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
    wavelengths_nm : float, shape (wavelengths,)
        In nm.
    incidence : float or "diffuse"
    effort : PackingEffort
    seed : int
    threads : int, optional

    Attributes
    ----------
    n_simulations : int
        Sands simulated so far.
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
        count = len(effort.rays) + N_JACOBIANS + 1
        drawn = np.random.SeedSequence(seed).generate_state(count)
        self.seeds = [int(one) for one in drawn]
        """Of the survey and every stage, of Jacobians, and of the last spectrum."""
        self._last_result: tuple[bytes, int, np.ndarray] = (b"", 0, np.empty(0))

    def _simulate(self, state: np.ndarray, rays: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return reflectance and how far groups of rays take it off."""
        self.n_simulations += 1
        mean, _, groups = estimate_fixed_budget(
            self.cube.to_sand(state), self.wavelengths_nm, self.incidence,
            choose_node_rows(len(self.wavelengths_nm)), rays, seed, self.threads,
        )  # fmt: skip
        return mean[0], groups[:, 0]

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return reflectance with the rays of a stage, shape (wavelengths,)."""
        if self._last_result[:2] != (state.tobytes(), stage):
            found = self._simulate(state, self.n_rays[stage], self.seeds[stage])[0]
            self._last_result = state.tobytes(), stage, found
        return self._last_result[2]

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return derivatives from one neighbour per coordinate, inside the cube."""
        here, columns = self.evaluate(state, stage), []
        for i, x in enumerate(state):
            near = state.copy()
            near[i] += JACOBIAN_STEP if x + JACOBIAN_STEP <= 1.0 else -JACOBIAN_STEP
            columns.append((self.evaluate(near, stage) - here) / (near[i] - x))
        return np.column_stack(columns)

    def noise(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the last stage's noise, which all of its runs share."""
        groups = self._simulate(state, self.n_rays[-1], self.seeds[len(self.n_rays) - 1])[1]
        found: np.ndarray = groups.T @ groups
        return found

    def compute_jacobians(self, state: np.ndarray) -> list[np.ndarray]:
        """Return derivatives with random numbers of their own."""
        first = len(self.n_rays)
        rays = max(self.n_rays[-1] // _JACOBIAN_RAYS_DIVISOR, 1)
        return [
            compute_central_differences(partial(self._simulate_reflectance, rays, stream), state)
            for stream in self.seeds[first : first + N_JACOBIANS]
        ]

    def _simulate_reflectance(self, rays: int, seed: int, state: np.ndarray) -> np.ndarray:
        return self._simulate(state, rays, seed)[0]


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
    """Find the sand whose reflectance comes nearest to a measured one.

    Parameters
    ----------
    base_settings : mapping
        Keywords of `splits.Sand` that stay fixed, for example ``refractive_index``.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), two more than coordinates at least.
    measured : array_like
        Hemispherical reflectance there, 0 to 1.
    incidence_deg : float or "diffuse"
        Polar angle of the beam it was measured under, 0 to 89.9999 degrees.
    ranges : mapping, optional
        (low, high) by name, instead of those of `splits.retrieval.sand_parameters.DEFAULT_RANGES`.
    seed : int
        Non-negative; the same seed gives the same result on any number of threads.
    threads : int, optional
    log : callable
        Receives lines of progress.
    effort : PackingEffort, optional

    Raises
    ------
    ValueError
        For a value outside its range.
    """
    begun = time.perf_counter()
    effort = effort or Effort()
    wavelengths = check_wavelengths(wavelength_nm)
    wanted = check_measured_reflectance(measured, wavelengths, find_labels(wavelength_nm))
    cube = UnitCube(base_settings, ranges)
    least = len(cube.names) + MIN_RESIDUAL_DOF
    if len(wavelengths) < least:
        raise invalid("wavelength_nm", wavelengths.tolist(), f"{least} wavelengths at least")
    beam, seed = check_incidence(incidence_deg), check_integer("seed", seed, 0)
    runs = SandForwardModel(cube, wavelengths, beam, effort, seed, threads)
    ends = _run_descents(runs, wanted, effort, log)
    best = ends[-1][0].state
    spectrum = spectrophotometer(
        cube.to_sand(best), wavelengths, beam, effort.max_stderr, runs.seeds[-1], threads=threads
    )
    modelled, stderr = spectrum.reflectance.values, spectrum.reflectance_stderr.values
    off = modelled - wanted
    jacobians = runs.compute_jacobians(best)
    held = find_active_bounds(best, np.mean(jacobians, axis=0).T @ off)
    left = estimate_fit_covariance(jacobians, off, runs.noise(best), held)
    draws = apply_priors(cube.state_vector, best, left.state, seed).draws.states
    value, value_stderr = _compute_rms(off), _compute_rms(stderr)
    seconds = time.perf_counter() - begun
    log(f"{runs.n_simulations} sands, rmse {value:.4f} ± {value_stderr:.4f}, {seconds:.0f} s")
    return FitResult(
        parameters=estimate_parameter_errors(cube, best, draws),
        settings=cube.to_keywords(best),
        rmse=value,
        rmse_stderr=value_stderr,
        wavelength_nm=wavelengths,
        measured=wanted,
        modelled=modelled,
        modelled_stderr=stderr,
        spectrum=spectrum,
        names=cube.names,
        coordinates=best,
        coordinates_stderr=np.sqrt(np.mean((draws - best) ** 2, axis=0)),
        correlation=np.corrcoef(draws, rowvar=False),
        alternatives=[
            (_compute_rms_misfit(end, wanted), cube.to_parameters(end.state)) for end in ends[0]
        ],
        evaluations=runs.n_simulations,
        seconds=seconds,
    )


def _run_descents(
    model: SandForwardModel, measured: np.ndarray, effort: Effort, log: Callable[[str], None]
) -> list[list[LocalMinimum]]:
    """Return where the descents of every stage ended, best first."""
    # Imported here: it takes a second, which every start of the workflow would take.
    qmc = import_optional("scipy.stats", "retrieval", "fits need").qmc

    places = qmc.Sobol(len(model.cube.names), seed=model.seeds[0]).random(effort.points)
    stages = [DescentStage(*pair) for pair in zip(effort.starts, effort.evaluations, strict=True)]
    aim = Objective.least_squares(measured, model.state_vector)

    def tell(_: int, cost: float) -> None:
        log(f"{model.n_simulations} sands, best misfit {np.sqrt(cost / len(measured)):.4f}")

    ends = search_minima(model, lambda place, stage: aim, places, stages, tell)
    log(
        f"{model.n_simulations} sands, best misfit {_compute_rms_misfit(ends[-1][0], measured):.4f}; now its errors"
    )
    return ends


def _compute_rms_misfit(minimum: LocalMinimum, measured: np.ndarray) -> float:
    return float(np.sqrt(minimum.cost / len(measured)))


def check_measured_reflectance(
    measured: Any, wavelengths: np.ndarray, labels: Any = None
) -> np.ndarray:
    """Return measured reflectances, each in [0, 1], in the order of wavelengths, or refuse them.

    Parameters
    ----------
    measured : array_like
    wavelengths : float, shape (wavelengths,)
        In nm.
    labels : sequence, optional
        Those that the wavelengths have, for values with the same.
    """
    values = align_to_labels("measured", measured, wavelengths, labels, allowed="numbers in [0, 1]")
    if values.shape != wavelengths.shape:
        allowed = f"{wavelengths.size} numbers, one for each wavelength"
        raise invalid("measured", f"of shape {values.shape}", allowed)
    return check_array_range("measured", values, 0.0, 1.0)


def compute_central_differences(
    model: Callable[[np.ndarray], np.ndarray], x: np.ndarray
) -> np.ndarray:
    """Return derivatives between neighbours on both sides, as far as the cube reaches."""
    columns = []
    for i in range(len(x)):
        up, down = x.copy(), x.copy()
        up[i] = min(x[i] + 2.0 * JACOBIAN_STEP, 1.0)
        down[i] = max(x[i] - 2.0 * JACOBIAN_STEP, 0.0)
        columns.append((model(up) - model(down)) / (up[i] - down[i]))
    return np.column_stack(columns)


def estimate_parameter_errors(
    cube: UnitCube, best: np.ndarray, draws: np.ndarray
) -> dict[str, FittedParameter]:
    """Return the parameters with errors, from draws around the best fit.

    What a parameter may be off by is also counted in ranks among sands drawn from the whole cube,
    which treat a logarithmic coordinate and a mass fraction alike.
    """
    everywhere = np.random.default_rng(1).random(draws.shape)
    around, anywhere = ([cube.to_parameters(x) for x in places] for places in (draws, everywhere))
    found = {}
    for name, value in cube.to_parameters(best).items():
        near = np.array([a[name] for a in around])
        order = np.sort([a[name] for a in anywhere])
        rank, ranks = np.searchsorted(order, value), np.searchsorted(order, near)
        unmeasured = _compute_rms(np.arange(len(order)) - rank)
        found[name] = FittedParameter(
            value, _compute_rms(near - value), bool(_compute_rms(ranks - rank) < 0.5 * unmeasured)
        )
    return found


def _compute_rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
