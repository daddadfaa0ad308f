"""Choice between Monte Carlo simulation and discrete ordinates, and spectra by the latter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splits.core.validation import check_choice, invalid
from splits.discrete_ordinates.applicability import (
    find_obstacle,
    find_parameter_obstacle,
    is_tabulated,
    make_granular_stack,
)
from splits.discrete_ordinates.granular_stack import (
    SpectrumSolution,
    compute_optics_error,
    solve_with_exponent_error,
)
from splits.discrete_ordinates.parameter_derivatives import (
    DryDerivatives,
    WetDerivatives,
    solve_derivatives,
)
from splits.kernels.tallies.exits import N_BATCHES
from splits.media.medium import Medium
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate
from splits.simulation.threads import limit_blas_threads

MONTE_CARLO, DISCRETE_ORDINATES, AUTO = "monte_carlo", "discrete_ordinates", "auto"
OPTICS_SHARE_OF_ERROR = 0.86
"""Error of single scattering that leaves half of a requested error for truncation."""
LEAST_PATH_ERROR = 1e-4
"""About the error of a reflectance by the default largest number of rays."""
SOLVERS = (MONTE_CARLO, DISCRETE_ORDINATES, AUTO)


def choose_solver(
    solver: Any, media: Iterable[Medium], wavelength_nm: np.ndarray, obstacle: str | None = None,
    parameters: Sequence[str] = (), max_stderr: float = np.inf,
) -> str:  # fmt: skip
    """Return the solver for media: with "auto", discrete ordinates where they are the best.

    They are if they apply to natural snow, and are accurate enough.  For other grains, their first
    spectrum takes longer than paths.

    Parameters
    ----------
    solver : object
        As given by the user.
    media : iterable of Medium
    wavelength_nm : float, shape (wavelengths,)
    obstacle : str, optional
        Another reason why discrete ordinates do not apply.
    parameters : sequence of str
        Parameters of the only medium with respect to which derivatives are computed.
    max_stderr : float
        Requested error of hemispherical values; "auto" uses paths if discrete ordinates have a
        larger one, unless paths would hardly reach a smaller one.

    Raises
    ------
    ValueError
        For an unknown solver, and where discrete ordinates are requested and do not apply.
    """
    solver = check_choice("solver", solver, SOLVERS)
    if solver == MONTE_CARLO:
        return MONTE_CARLO
    media = list(media)
    reasons = (find_obstacle(medium, wavelength_nm) for medium in media)
    obstacle = obstacle or next((reason for reason in reasons if reason), None)
    if obstacle is None and parameters:
        obstacle = find_parameter_obstacle(media[0], parameters)
    if obstacle is None:
        sufficient = max(OPTICS_SHARE_OF_ERROR * max_stderr, LEAST_PATH_ERROR)
        is_best = solver != AUTO or all(
            is_tabulated(medium)
            and compute_optics_error(make_granular_stack(medium, wavelength_nm)).max() <= sufficient
            for medium in media
        )
        return DISCRETE_ORDINATES if is_best else MONTE_CARLO
    if solver == AUTO:
        return MONTE_CARLO
    allowed = "'monte_carlo' or 'auto' for this medium"
    raise invalid("solver", solver, allowed, f"for discrete ordinates, {obstacle}")


def solve_estimate(
    media: Sequence[Medium], wavelength_nm: np.ndarray, incidence: float | str, max_stderr: float,
    threads: int, parameters: Sequence[str] = (),
) -> SpectralEstimate:  # fmt: skip
    """Return hemispherical values of media by discrete ordinates, in the form of simulations.

    Parameters
    ----------
    media : sequence of Medium
        Without obstacle (`splits.discrete_ordinates.applicability.find_obstacle`).
    wavelength_nm : float, shape (wavelengths,)
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    max_stderr : float
        Determines the number of streams, and of paths through grains.
    threads : int
        For paths through grains.
    parameters : sequence of str
        Parameters of the only medium with respect to which derivatives are computed, without
        obstacle (`splits.discrete_ordinates.applicability.find_parameter_obstacle`).
    """
    is_diffuse = incidence == "diffuse"
    cosines = np.array([] if is_diffuse else [np.cos(np.radians(float(incidence)))])
    stacks = [make_granular_stack(medium, wavelength_nm, max_stderr, threads) for medium in media]
    with limit_blas_threads():
        solutions = [solve_with_exponent_error(stack, cosines, max_stderr) for stack in stacks]
        estimate = make_estimate(solutions, -1 if is_diffuse else 0)
        if not parameters:
            return estimate
        of_medium = (WetDerivatives if stacks[0].is_wet else DryDerivatives).from_medium(
            media[0], parameters, wavelength_nm, incidence
        )
        values, bound = solve_derivatives(of_medium, solutions[0])
    derivatives = Derivatives(values, np.zeros((N_BATCHES, *values.shape)), bound)
    return replace(estimate, derivatives=derivatives)


def make_estimate(solutions: Sequence[SpectrumSolution], column: int) -> SpectralEstimate:
    """Return solutions in the form of simulations, for one beam or for diffuse light (−1)."""
    sides = [
        np.concatenate([getattr(one.budget, name)[..., column] for one in solutions])
        for name in ("reflectance", "transmittance")
    ]
    reflectance, transmittance = (np.clip(side, 0.0, 1.0) for side in sides)
    mean = np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])
    n_rows = mean.shape[1]
    parts = np.split(mean, np.cumsum([one.error.size for one in solutions])[:-1], axis=1)
    stderr = np.concatenate(
        [one.bound_errors(part) for one, part in zip(solutions, parts, strict=True)], axis=1
    )
    return SpectralEstimate(
        mean, stderr, np.zeros_like(stderr), np.zeros((N_BATCHES, 2, n_rows)),
        _make_no_derivatives(n_rows), np.zeros(n_rows), _describe(solutions),
    )  # fmt: skip


def get_derivative_method(medium: Medium) -> str:
    """Return the method of derivatives by discrete ordinates: analytic, or differences if wet."""
    layers: Any = medium.scene_layers
    is_wet = any(layer.wet_fraction > 0.0 for layer in layers)
    return "finite_difference" if is_wet else "analytic"


def _make_no_derivatives(n_rows: int) -> Derivatives:
    none = np.zeros((2, 0, n_rows))
    return Derivatives(none, np.zeros((N_BATCHES, 2, 0, n_rows)), none)


def _describe(solutions: Sequence[SpectrumSolution]) -> dict[str, Any]:
    """Return the attributes of spectra by discrete ordinates."""
    return {
        "rays": 0,
        "streams": max(one.n_streams for one in solutions),
        "truncation_error": float(max(one.truncation.max() for one in solutions)),
        "optics_error": float(max(one.optics_error.max() for one in solutions)),
    }
