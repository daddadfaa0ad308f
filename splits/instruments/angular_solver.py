"""BRDFs, BTDFs and factors by discrete ordinates, in the form of simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.error_target import ErrorTarget
from splits.discrete_ordinates.applicability import find_direction_obstacle, make_granular_stack
from splits.discrete_ordinates.granular_stack import REVERSED, GranularStack, SpectrumSolution
from splits.discrete_ordinates.homogeneous_layer import TINY
from splits.discrete_ordinates.refraction import Geometry
from splits.discrete_ordinates.stack_brdf import solve_bidirectional, solve_relative_spectrum
from splits.instruments.angular_estimate import AngularEstimate, compute_anisotropy
from splits.media.medium import Medium
from splits.simulation.threads import limit_blas_threads

PHASE_FUNCTION_FACTOR = 0.06
"""Error of a reflectance, over the requested error of a BRDF, for which the paths through grains
give a phase function with that error."""


class AngularRequest(NamedTuple):
    """Directions, and the error of their values.

    Attributes
    ----------
    wavelengths : float, shape (wavelengths,)
        nm.
    polar, azimuth : float, shape (angles,)
        Degrees.
    max_error : float
    target : ErrorTarget
        What the error applies to; the azimuth of directions runs fastest.
    """

    wavelengths: np.ndarray
    polar: np.ndarray
    azimuth: np.ndarray
    max_error: float
    target: ErrorTarget


class AngularResult(NamedTuple):
    """Result of a goniophotometer.

    Attributes
    ----------
    estimate : AngularEstimate
    stokes : dict
        See `splits.instruments.angular_dataset.make_angular_dataset`.
    undefined : tuple of str
        Variables of the dataset that are left out.
    attributes : dict
    """

    estimate: AngularEstimate
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]]
    undefined: tuple[str, ...]
    attributes: dict[str, Any]

    @property
    def is_converged(self) -> bool:
        """Whether the requested error is reached."""
        return bool(self.attributes["stop_reason"] == "converged")


def find_angular_obstacle(medium: Medium, estimator: str, rays: int | None) -> str | None:
    """Return why discrete ordinates cannot replace a goniophotometer, None if they can.

    Parameters
    ----------
    medium, estimator, rays
        As for `splits.goniophotometer`.
    """
    if estimator != "expansion":
        return f"the estimator {estimator} needs paths"
    if rays is not None:
        return "a number of rays needs paths"
    return find_direction_obstacle(medium)


def solve_angular_results(
    medium: Medium, request: AngularRequest, incidences: Sequence[float | str], threads: int
) -> list[AngularResult]:
    """Return angular distributions by discrete ordinates, for each incidence.

    The beams are solved together, so that the requested error determines one number of streams for
    all of them.

    Parameters
    ----------
    medium : Medium
        Without obstacle.
    request : AngularRequest
    incidences : sequence of float or "diffuse"
        Degrees, or isotropic light.
    threads : int
        For paths through grains.
    """
    snowpack = make_granular_stack(
        medium, request.wavelengths, PHASE_FUNCTION_FACTOR * request.max_error, threads
    )
    beams = [float(incidence) for incidence in incidences if incidence != "diffuse"]
    with limit_blas_threads():
        by_beam = iter(_solve_beams(snowpack, request, beams) if beams else [])
        return [
            _solve_diffuse(snowpack, request) if incidence == "diffuse" else next(by_beam)
            for incidence in incidences
        ]


def _solve_diffuse(snowpack: GranularStack, request: AngularRequest) -> AngularResult:
    """Return factors under diffuse light, by reciprocity.

    The reflectance factor in a direction is the reflectance of a beam from there, and the
    transmittance factor is the transmittance of a beam from there through the inverted snowpack.
    """
    cosines = np.cos(np.radians(request.polar))
    reversed_stack = snowpack._replace(equilibrium=REVERSED)
    inverted = reversed_stack._replace(layers=snowpack.layers[::-1])
    spectrum, above, below = (
        solve_relative_spectrum(one, cosines, request.max_error, request.target.side)
        for one in (snowpack, reversed_stack, inverted)
    )
    values = np.stack([above.budget.reflectance, below.budget.transmittance])[..., :-1]
    errors = np.stack([
        np.stack([one.bound_errors(values[..., i])[side] for i in range(cosines.size)], axis=-1)
        for side, one in enumerate((above, below))
    ])  # fmt: skip
    mean, stderr = (
        np.repeat(one / np.pi, request.azimuth.size, axis=-1) for one in (values, errors)
    )
    totals = _select_totals(spectrum, -1)
    relative = spectrum.bound_errors(totals)[0] / np.maximum(totals[0], TINY)
    independent = np.hypot(stderr[0], mean[0] * relative[:, np.newaxis])
    anisotropy = compute_anisotropy(mean[0], independent, totals[0])
    estimate = _make_estimate([mean, stderr, *anisotropy], spectrum, -1, 0.0)
    n_streams = max(one.n_streams for one in (spectrum, above, below))
    return _make_result(estimate, request, spectrum, n_streams)


def _solve_beams(
    snowpack: GranularStack, request: AngularRequest, incidence_deg: list[float]
) -> list[AngularResult]:
    """Return the BRDF and the BTDF under each of several beams."""
    # Both are symmetric in the azimuth.
    azimuths, first, columns = np.unique(
        np.minimum(request.azimuth, 360.0 - request.azimuth), return_index=True, return_inverse=True
    )
    cosines, views = (np.cos(np.radians(one)) for one in (incidence_deg, request.polar))
    mask = request.target.direction_mask.reshape(request.polar.size, -1)[:, first]
    solution = solve_bidirectional(
        snowpack, Geometry(cosines, views, np.radians(azimuths)), request.max_error,
        request.target._replace(direction_mask=mask.ravel()),
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
        estimate = _make_estimate(by_direction, solution.spectrum, beam, direct)
        results.append(_make_result(estimate, request, solution.spectrum, n_streams))
    return results


def _select_totals(spectrum: SpectrumSolution, column: int) -> np.ndarray:
    """Return reflectance and transmittance, shape (2, wavelengths); see `_make_estimate`."""
    return np.stack([
        np.clip(side[..., column], 0.0, 1.0)
        for side in (spectrum.budget.reflectance, spectrum.budget.transmittance)
    ])  # fmt: skip


def _make_estimate(
    by_direction: Sequence[np.ndarray], spectrum: SpectrumSolution, column: int, direct: Any
) -> AngularEstimate:
    """Return an estimate.

    Parameters
    ----------
    by_direction : float, shapes (2, wavelengths, directions) and (wavelengths, directions)
        Values (1/sr), reflected and transmitted, and their errors; anisotropy factors and theirs.
    spectrum : SpectrumSolution
    column : int
        Number of the beam, −1 for diffuse light.
    direct : float, shape (2, wavelengths)
        Reflectance and transmittance without scattering.
    """
    mean, stderr, anisotropy, anisotropy_stderr = by_direction
    totals = _select_totals(spectrum, column)
    hemispherical = np.zeros((4, *totals.shape))
    hemispherical[0] = totals
    hemispherical[1] = spectrum.bound_errors(totals)
    hemispherical[2] = direct
    return AngularEstimate(
        np.maximum(mean, 0.0), stderr, stderr, hemispherical, np.zeros(totals.shape, dtype=int),
        np.zeros_like(mean), np.maximum(anisotropy, 0.0), anisotropy_stderr,
    )  # fmt: skip


def _make_result(
    estimate: AngularEstimate, request: AngularRequest, spectrum: SpectrumSolution, n_streams: int
) -> AngularResult:
    """Return an estimate with the attributes of its solution."""
    reached = estimate.compute_max_error(request.target)
    attributes = {
        "stop_reason": "converged" if reached <= request.max_error else "solver_error",
        "rays": 0,
        "streams": n_streams,
        "truncation_error": float(spectrum.truncation.max()),
        "optics_error": float(spectrum.optics_error.max()),
    }
    return AngularResult(estimate, {}, (), attributes)
