"""Fit of a sand to a measured spectrum: retrieval of the parameters of SPLITS Table 2.

Every point of the unit cube is a sand (`splits.retrieval.sand_parameters.UnitCube`).  The noise is
unknown: `splits.retrieval.gauss_newton` finds the smallest misfit, and
`splits.retrieval.least_squares` estimates the errors from it.  A spectrum rarely constrains all
parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from splits.core.arrays import align_to_labels, check_array_range, find_labels
from splits.core.validation import check_integer, invalid
from splits.instruments import spectrophotometer
from splits.retrieval.gauss_newton import DescentStage, LocalMinimum, Objective, search_minima
from splits.retrieval.least_squares import apply_priors
from splits.retrieval.optimal_estimation import find_active_bounds
from splits.retrieval.residual_covariance import MIN_RESIDUAL_DOF, estimate_fit_covariance
from splits.retrieval.sand_forward_model import Effort, SandForwardModel
from splits.retrieval.sand_parameters import FitResult, FittedParameter, UnitCube
from splits.simulation.arguments import check_incidence, check_wavelengths


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
        (low, high) by name, instead of those of `splits.retrieval.sand_parameters.DEFAULT_RANGES`.
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
    start_time = time.perf_counter()
    effort = effort or Effort()
    wavelengths = check_wavelengths(wavelength_nm)
    target = check_measured_reflectance(measured, wavelengths, find_labels(wavelength_nm))
    cube = UnitCube(base_settings, ranges)
    min_wavelengths = len(cube.names) + MIN_RESIDUAL_DOF
    if len(wavelengths) < min_wavelengths:
        allowed = f"{min_wavelengths} wavelengths at least"
        raise invalid("wavelength_nm", wavelengths.tolist(), allowed)
    incidence, seed = check_incidence(incidence_deg), check_integer("seed", seed, 0)
    model = SandForwardModel(cube, wavelengths, incidence, effort, seed, threads)
    stage_minima = _run_descents(model, target, effort, log)
    best = stage_minima[-1][0].state
    spectrum = spectrophotometer(
        cube.to_sand(best), wavelengths, incidence, effort.max_stderr, model.seeds[-1],
        threads=threads,
    )  # fmt: skip
    modelled, stderr = spectrum.reflectance.values, spectrum.reflectance_stderr.values
    residual = modelled - target
    jacobians = model.compute_jacobians(best)
    active_bounds = find_active_bounds(best, np.mean(jacobians, axis=0).T @ residual)
    fit_covariance = estimate_fit_covariance(jacobians, residual, model.noise(best), active_bounds)
    draws = apply_priors(cube.state_vector, best, fit_covariance.state, seed).draws.states
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
            (_compute_rms_misfit(minimum, target), cube.to_parameters(minimum.state))
            for minimum in stage_minima[0]
        ],
        evaluations=model.n_simulations,
        seconds=seconds,
    )


def _run_descents(
    model: SandForwardModel, measured: np.ndarray, effort: Effort, log: Callable[[str], None]
) -> list[list[LocalMinimum]]:
    """Return the minima found by the descents of every stage, best first."""
    # Imported here, as it would slow the start of the workflow by a second.
    from scipy.stats import qmc

    survey_states = qmc.Sobol(len(model.cube.names), seed=model.seeds[0]).random(effort.points)
    stages = [DescentStage(*pair) for pair in zip(effort.starts, effort.evaluations, strict=True)]
    objective = Objective.least_squares(measured, model.state_vector)

    def log_stage(_: int, cost: float) -> None:
        log(f"{model.n_simulations} sands, best misfit {np.sqrt(cost / len(measured)):.4f}")

    stage_minima = search_minima(
        model, lambda state, stage: objective, survey_states, stages, log_stage
    )
    misfit = _compute_rms_misfit(stage_minima[-1][0], measured)
    log(f"{model.n_simulations} sands, best misfit {misfit:.4f}; errors follow")
    return stage_minima


def _compute_rms_misfit(minimum: LocalMinimum, measured: np.ndarray) -> float:
    return float(np.sqrt(minimum.cost / len(measured)))


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
