"""SolverChoice between Monte Carlo simulation and discrete ordinates, and spectra by the latter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from splits.core.uncertainty import ErrorTarget
from splits.core.validation import invalid
from splits.discrete_ordinates.applicability import (
    DEFAULT_ERROR,
    find_obstacle,
    find_table_obstacle,
    is_tabulated,
    make_granular_stack,
)
from splits.discrete_ordinates.derivatives import SpectrumDerivatives, solve_derivatives
from splits.discrete_ordinates.granular_stack import (
    CUTOFF_SHARE,
    REVERSED,
    GranularStack,
    SpectrumSolution,
    compute_optics_error,
    solve_spectrum,
    solve_with_exponent_error,
)
from splits.discrete_ordinates.homogeneous_layer import TINY
from splits.discrete_ordinates.radiance import Geometry
from splits.discrete_ordinates.stack_brdf import solve_bidirectional, solve_relative_spectrum
from splits.instruments.angular_estimate import AngularEstimate, compute_anisotropy
from splits.media.medium import Medium
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate
from splits.simulation.threads import limit_blas_threads

MONTE_CARLO: Final = "monte_carlo"
DISCRETE_ORDINATES: Final = "discrete_ordinates"
AUTO: Final = "auto"
REQUESTED = "requested"
"""Reason of a solver that the user chose."""
OPTICS_SHARE_OF_ERROR = 0.86
"""Error of single scattering that leaves half of a requested error for truncation."""
LEAST_PATH_ERROR = 1e-4
"""About the error of a reflectance by the default largest number of rays."""


class SolverChoice(NamedTuple):
    """Solver of media, with what it solves.

    Attributes
    ----------
    solver : {"discrete_ordinates", "monte_carlo"}
    reason : str
        Why this solver is taken.
    stacks : list of GranularStack
        The media in the form of discrete ordinates; empty for Monte Carlo simulation.
    """

    solver: str
    reason: str
    stacks: list[GranularStack]

    @classmethod
    def monte_carlo(cls, reason: str) -> SolverChoice:
        """Return the choice of Monte Carlo simulation."""
        return cls(MONTE_CARLO, reason, [])

    @classmethod
    def of_missed_error(cls, error: float, requested: float) -> SolverChoice:
        """Return the choice of Monte Carlo simulation for the error of a solution."""
        return cls.monte_carlo(
            f"discrete ordinates have an error of {error:.2g} where {requested:g} is requested"
        )

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of results."""
        return {"solver": self.solver, "solver_reason": self.reason}


def choose_solver(
    solver: str, media: Iterable[Medium], wavelength_nm: np.ndarray,
    max_error: float | None = None, threads: int = 1, *, obstacle: str | None = None,
    find_further_obstacle: Callable[[Medium], str | None] = lambda medium: None,
    max_stderr: float = np.inf,
) -> SolverChoice:  # fmt: skip
    """Choose the solver of media: with "auto", discrete ordinates where they are the best.

    They are if they apply to natural snow, and are accurate enough.  For other grains, their first
    spectrum takes longer than paths.

    Parameters
    ----------
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
    media : iterable of Medium
    wavelength_nm : float, shape (wavelengths,)
    max_error : float, optional
        Error that determines the number of paths through grains, see
        `splits.discrete_ordinates.applicability.make_granular_stack`.  Without it, no paths are
        traced, and the choice has no stacks.
    threads : int
        For these paths.
    obstacle : str, optional
        Another reason why discrete ordinates do not apply.
    find_further_obstacle : callable
        Returns such a reason for a medium that has no other one, or None.
    max_stderr : float
        Requested error of hemispherical values; "auto" uses paths if discrete ordinates have a
        larger one, unless paths would hardly reach a smaller one.

    Raises
    ------
    ValueError
        Where discrete ordinates are requested and do not apply.
    """
    if solver == MONTE_CARLO:
        return SolverChoice.monte_carlo(REQUESTED)
    media, stacks = list(media), []
    obstacles = (obstacle or find_obstacle(one) or find_further_obstacle(one) for one in media)
    reason = next(filter(None, obstacles), None)
    has_tables = all(map(is_tabulated, media))
    if not reason and solver == AUTO and not has_tables:
        return SolverChoice.monte_carlo("paths are faster for grains other than natural snow")
    # Paths through grains are traced after all other obstacles are known.
    if not reason and (has_tables or max_error is not None):
        sufficient = max(OPTICS_SHARE_OF_ERROR * max_stderr, LEAST_PATH_ERROR)
        for medium in media:
            stack = make_granular_stack(medium, wavelength_nm, max_error or DEFAULT_ERROR, threads)
            reason = find_table_obstacle(medium, stack, wavelength_nm)
            if reason:
                break
            if solver == AUTO:
                optics_error = float(compute_optics_error(stack).max())
                if optics_error > sufficient:
                    return SolverChoice.of_missed_error(optics_error, max_stderr)
            # All stacks of a large table would not fit into memory.
            if max_error is not None:
                stacks.append(stack)
    if reason and solver != AUTO:
        allowed = "'monte_carlo' or 'auto' for this medium"
        raise invalid("solver", solver, allowed, f"for discrete ordinates, {reason}")
    if reason:
        return SolverChoice.monte_carlo(f"discrete ordinates do not apply: {reason}")
    reason = "solutions of natural snow have no noise" if solver == AUTO else REQUESTED
    return SolverChoice(DISCRETE_ORDINATES, reason, stacks)


def solve_estimate(
    stacks: Sequence[GranularStack], incidence: float | str, max_stderr: float
) -> tuple[SpectralEstimate, list[SpectrumSolution]]:
    """Return hemispherical values of media in the form of simulations, and their solutions.

    Parameters
    ----------
    stacks : sequence of GranularStack
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    max_stderr : float
        Determines the number of streams.
    """
    is_diffuse = incidence == "diffuse"
    cosines = np.array([] if is_diffuse else [np.cos(np.radians(float(incidence)))])
    with limit_blas_threads():
        solutions = [solve_with_exponent_error(stack, cosines, max_stderr) for stack in stacks]
    return make_estimate(solutions, -1 if is_diffuse else 0), solutions


def solve_reflectances(
    stacks: Sequence[GranularStack], incidences: Sequence[float | str], max_stderr: float
) -> list[SpectrumSolution]:
    """Return solutions for beams and for diffuse light (last), without layers that are not seen.

    Parameters
    ----------
    stacks : sequence of GranularStack
    incidences : sequence of float or "diffuse"
        Degrees, or isotropic light.
    max_stderr : float
        Determines the number of streams, and what is not seen.
    """
    beams = [float(incidence) for incidence in incidences if incidence != "diffuse"]
    cosines, cutoff = np.cos(np.radians(beams)), CUTOFF_SHARE * max_stderr
    with limit_blas_threads():
        return [
            solve_spectrum(stack._replace(cutoff=cutoff), cosines, max_stderr) for stack in stacks
        ]


def solve_parameter_derivatives(
    medium: Medium, solution: SpectrumSolution, wavelength_nm: np.ndarray,
    incidence: float | str, parameters: Sequence[str],
) -> Derivatives:  # fmt: skip
    """Return the derivatives of a solution to parameters of its medium, see `solve_estimate`.

    Parameters
    ----------
    medium : Medium
        Without obstacle (`splits.discrete_ordinates.applicability.find_parameter_obstacle`).
    solution : SpectrumSolution
    wavelength_nm : float, shape (wavelengths,)
    incidence : float or "diffuse"
    parameters : sequence of str
    """
    of_medium = SpectrumDerivatives.from_medium(medium, parameters, wavelength_nm, incidence)
    with limit_blas_threads():
        return Derivatives.from_solution(*solve_derivatives(of_medium, solution))


def make_estimate(solutions: Sequence[SpectrumSolution], column: int) -> SpectralEstimate:
    """Return solutions in the form of simulations, for one beam or for diffuse light (−1)."""
    reflectance, transmittance = np.concatenate(
        [_select_totals(one, column) for one in solutions], axis=1
    )
    mean = np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])
    parts = np.split(mean, np.cumsum([one.error.size for one in solutions])[:-1], axis=1)
    stderr = np.concatenate(
        [one.bound_errors(part) for one, part in zip(solutions, parts, strict=True)], axis=1
    )
    attributes = {
        "streams": max(one.n_streams for one in solutions),
        "truncation_error": float(max(one.truncation.max() for one in solutions)),
        "optics_error": float(max(one.optics_error.max() for one in solutions)),
    }
    return SpectralEstimate.from_solution(mean, stderr, attributes)


# --------------------------------------------------------------------------------------------------
# BRDFs, BTDFs and factors by discrete ordinates, in the form of simulations.

PHASE_FUNCTION_FACTOR = 0.06
"""Error of a reflectance, over the requested error of a BRDF, for which the paths through grains
give a phase function with that error."""


AngularSolution = tuple[AngularEstimate, dict[str, Any]]
"""Angular distributions by discrete ordinates, with their attributes."""


def solve_angular_distributions(
    snowpack: GranularStack, polar: np.ndarray, azimuth: np.ndarray, max_error: float,
    target: ErrorTarget, incidences: Sequence[float | str],
) -> list[AngularSolution]:  # fmt: skip
    """Return angular distributions by discrete ordinates, for each incidence.

    The beams are solved together, so that the requested error determines one number of streams for
    all of them.

    Parameters
    ----------
    snowpack : GranularStack
    polar, azimuth : float, shape (angles,)
        Degrees.
    max_error : float
    target : ErrorTarget
        What the error applies to; the azimuth of directions runs fastest.
    incidences : sequence of float or "diffuse"
        Degrees, or isotropic light.
    """
    beams = [float(incidence) for incidence in incidences if incidence != "diffuse"]
    with limit_blas_threads():
        by_beam = iter(
            _solve_beams(snowpack, polar, azimuth, max_error, target, beams) if beams else []
        )
        return [
            _solve_diffuse(snowpack, polar, azimuth.size, max_error, target)
            if incidence == "diffuse"
            else next(by_beam)
            for incidence in incidences
        ]


def _solve_diffuse(
    snowpack: GranularStack, polar: np.ndarray, n_azimuths: int, max_error: float,
    target: ErrorTarget,
) -> AngularSolution:  # fmt: skip
    """Return factors under diffuse light, by reciprocity.

    The reflectance factor in a direction is the reflectance of a beam from there, and the
    transmittance factor is the transmittance of a beam from there through the inverted snowpack.
    """
    cosines = np.cos(np.radians(polar))
    reversed_stack = snowpack._replace(equilibrium=REVERSED)
    inverted = reversed_stack._replace(layers=snowpack.layers[::-1])
    spectrum, above, below = (
        solve_relative_spectrum(one, cosines, max_error, target.side)
        for one in (snowpack, reversed_stack, inverted)
    )
    values = np.stack([above.budget.reflectance, below.budget.transmittance])[..., :-1]
    errors = np.stack([
        np.stack([one.bound_errors(values[..., i])[side] for i in range(cosines.size)], axis=-1)
        for side, one in enumerate((above, below))
    ])  # fmt: skip
    mean, stderr = (np.repeat(one / np.pi, n_azimuths, axis=-1) for one in (values, errors))
    totals = _select_totals(spectrum, -1)
    relative = spectrum.bound_errors(totals)[0] / np.maximum(totals[0], TINY)
    independent = np.hypot(stderr[0], mean[0] * relative[:, np.newaxis])
    anisotropy = compute_anisotropy(mean[0], independent, totals[0])
    n_streams = max(one.n_streams for one in (spectrum, above, below))
    by_direction = [mean, stderr, *anisotropy]
    return _make_solution(by_direction, spectrum, -1, 0.0, n_streams, max_error, target)


def _solve_beams(
    snowpack: GranularStack, polar: np.ndarray, azimuth: np.ndarray, max_error: float,
    target: ErrorTarget, incidence_deg: list[float],
) -> list[AngularSolution]:  # fmt: skip
    """Return the BRDF and the BTDF under each of several beams."""
    # Both are symmetric in the azimuth.
    azimuths, first, columns = np.unique(
        np.minimum(azimuth, 360.0 - azimuth), return_index=True, return_inverse=True
    )
    cosines, views = (np.cos(np.radians(one)) for one in (incidence_deg, polar))
    mask = target.direction_mask.reshape(polar.size, -1)[:, first]
    solution = solve_bidirectional(
        snowpack, Geometry(cosines, views, np.radians(azimuths)), max_error,
        target._replace(direction_mask=mask.ravel()),
    )  # fmt: skip
    n_streams = max(solution.n_streams, solution.spectrum.n_streams)
    results = []
    for beam in range(cosines.size):
        by_direction = [
            values[..., beam, :, :][..., columns.ravel()].reshape(*values.shape[:-3], -1)
            for values in (
                solution.values,
                solution.error,
                solution.anisotropy,
                solution.anisotropy_error,
            )
        ]
        direct = np.stack([
            solution.direct.reflected[..., beam], solution.direct.transmitted[..., beam]
        ])  # fmt: skip
        results.append(_make_solution(
            by_direction, solution.spectrum, beam, direct, n_streams, max_error, target
        ))  # fmt: skip
    return results


def _select_totals(spectrum: SpectrumSolution, column: int) -> np.ndarray:
    """Return reflectance and transmittance, shape (2, wavelengths); see `_make_solution`."""
    return np.stack([
        np.clip(side[..., column], 0.0, 1.0)
        for side in (spectrum.budget.reflectance, spectrum.budget.transmittance)
    ])  # fmt: skip


def _make_solution(
    by_direction: Sequence[np.ndarray], spectrum: SpectrumSolution, column: int, direct: Any,
    n_streams: int, max_error: float, target: ErrorTarget,
) -> AngularSolution:  # fmt: skip
    """Return a solution in the form of simulations.

    Parameters
    ----------
    by_direction : float, shapes (2, wavelengths, directions) and (wavelengths, directions)
        Values (1/sr), reflected and transmitted, and their errors; anisotropy factors and theirs.
    spectrum : SpectrumSolution
    column : int
        Number of the beam, −1 for diffuse light.
    direct : float, shape (2, wavelengths)
        Reflectance and transmittance without scattering.
    n_streams : int
    max_error, target
        See `solve_angular_distributions`.
    """
    mean, stderr, anisotropy, anisotropy_stderr = by_direction
    totals = _select_totals(spectrum, column)
    estimate = AngularEstimate(
        np.maximum(mean, 0.0), stderr, stderr,
        totals, spectrum.bound_errors(totals), direct + np.zeros(totals.shape),
        np.zeros(totals.shape), np.zeros(totals.shape, dtype=int), np.zeros_like(mean),
        np.maximum(anisotropy, 0.0), anisotropy_stderr,
    )  # fmt: skip
    reached = estimate.compute_max_error(target)
    return estimate, {
        "stop_reason": "converged" if reached <= max_error else "solver_error",
        "rays": 0,
        "streams": n_streams,
        "truncation_error": float(spectrum.truncation.max()),
        "optics_error": float(spectrum.optics_error.max()),
    }
