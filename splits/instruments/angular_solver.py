"""BRDFs and reflectance factors of dry point grains by discrete ordinates, as simulations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from splits.discrete_ordinates.applicability import make_pack
from splits.discrete_ordinates.pack_brdf import (
    compute_direct_transmittance,
    solve_brdf,
    solve_relative_spectrum,
)
from splits.discrete_ordinates.plane_pack import PlanePack, SpectrumSolution
from splits.discrete_ordinates.radiance import Geometry
from splits.instruments.angular_estimate import AngularEstimate
from splits.media.medium import Medium

UNAVAILABLE_VARIABLES = ("btdf", "transmittance_factor")
"""Variables that discrete ordinates do not compute."""
PHASE_FUNCTION_SHARE = 0.06
"""Error of a reflectance for which the paths through grains give a phase function with an error
of 1 in proportion."""


class AngularRequest(NamedTuple):
    """Directions, and the error of their values.

    Attributes
    ----------
    wavelengths : float, shape (wavelengths,)
        nm.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    polar, azimuth : float, shape (angles,)
        Degrees.
    relative_stderr : float
    direction_mask : bool, shape (directions,)
        Directions to which the error applies; azimuth runs fastest.
    """

    wavelengths: np.ndarray
    incidence: float | str
    polar: np.ndarray
    azimuth: np.ndarray
    relative_stderr: float
    direction_mask: np.ndarray


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


def find_angular_obstacle(
    medium: Medium, estimator: str = "expansion", target: str = "brdf", rays: int | None = None
) -> str | None:
    """Return why discrete ordinates cannot replace a goniophotometer, None if they can.

    Parameters
    ----------
    medium : Medium
    estimator, target, rays
        As for `splits.goniophotometer`.
    """
    if target != "brdf":
        return f"the {target.upper()} needs paths"
    if estimator != "expansion":
        return f"the estimator {estimator} needs paths"
    if rays is not None:
        return "a number of rays needs paths"
    layers: Any = medium.scene_layers
    granular = [layer for layer in layers if layer.has_grains]
    if any(layer.wet_fraction > 0.0 for layer in granular):
        return "the BRDF of wet snow needs paths"
    if any(layer.interpretation.grain_extent != "point" for layer in granular):
        return "the BRDF of grains that are no points needs paths"
    return None


def solve_angular_result(medium: Medium, request: AngularRequest, threads: int) -> AngularResult:
    """Return angular distributions by discrete ordinates.

    Parameters
    ----------
    medium : Medium
        Without obstacle.
    request : AngularRequest
    threads : int
        For paths through grains.
    """
    snowpack = make_pack(
        medium, request.wavelengths, PHASE_FUNCTION_SHARE * request.relative_stderr, threads
    )
    solve = _solve_diffuse if request.incidence == "diffuse" else _solve_beam
    estimate, attributes = solve(snowpack, request)
    return AngularResult(estimate, {}, UNAVAILABLE_VARIABLES, attributes)


def _solve_diffuse(
    snowpack: PlanePack, request: AngularRequest
) -> tuple[AngularEstimate, dict[str, Any]]:
    """Return reflectance factors under diffuse light: the reflectances of beams, by reciprocity."""
    cosines = np.cos(np.radians(request.polar))
    spectrum = solve_relative_spectrum(snowpack, cosines, request.relative_stderr)
    mean = spectrum.budget.reflectance[:, :-1] / np.pi
    stderr = np.minimum(spectrum.error[:, np.newaxis] / np.pi, mean)
    repeats = request.azimuth.size
    estimate = _make_estimate(
        np.repeat(mean, repeats, axis=1), np.repeat(stderr, repeats, axis=1), spectrum, -1, 0.0
    )
    return estimate, _describe(estimate, request, spectrum, spectrum.n_streams)


def _solve_beam(
    snowpack: PlanePack, request: AngularRequest
) -> tuple[AngularEstimate, dict[str, Any]]:
    """Return the BRDF under a beam."""
    cosine = np.cos(np.radians(np.array([float(request.incidence)])))
    # The BRDF is symmetric in the azimuth.
    azimuths, columns = np.unique(
        np.minimum(request.azimuth, 360.0 - request.azimuth), return_inverse=True
    )
    geometry = Geometry(cosine, np.cos(np.radians(request.polar)), np.radians(azimuths))
    limited: np.ndarray = request.direction_mask.reshape(request.polar.size, -1)[:, 0]
    solution = solve_brdf(snowpack, geometry, request.relative_stderr, limited)
    shape = (request.wavelengths.size, -1)
    mean, stderr = (
        values[..., columns.ravel()].reshape(shape) for values in (solution.brdf, solution.error)
    )
    direct = compute_direct_transmittance(snowpack, cosine)[:, 0]
    estimate = _make_estimate(np.maximum(mean, 0.0), stderr, solution.spectrum, 0, direct)
    n_streams = max(solution.n_streams, solution.spectrum.n_streams)
    return estimate, _describe(estimate, request, solution.spectrum, n_streams)


def _make_estimate(
    mean: np.ndarray, stderr: np.ndarray, spectrum: SpectrumSolution, column: int, direct: Any
) -> AngularEstimate:
    """Return an estimate without transmitted distribution.

    Parameters
    ----------
    mean, stderr : float, shape (wavelengths, directions)
        1/sr.
    spectrum : SpectrumSolution
    column : int
        0 for the beam, -1 for diffuse light.
    direct : float, shape (wavelengths,)
        Transmittance without scattering.
    """
    none = np.zeros_like(mean)
    totals = np.stack([
        np.clip(side[..., column], 0.0, 1.0)
        for side in (spectrum.budget.reflectance, spectrum.budget.transmittance)
    ])  # fmt: skip
    hemispherical = np.zeros((4, *totals.shape))
    hemispherical[0] = totals
    # A bounded quantity cannot be wrong by more than itself.
    hemispherical[1] = np.minimum(spectrum.error, totals)
    hemispherical[2, 1] = direct
    both = np.stack([mean, none]), np.stack([stderr, none])
    return AngularEstimate(
        *both, both[1], hemispherical, np.zeros(totals.shape, dtype=int), np.zeros_like(both[0])
    )


def _describe(
    estimate: AngularEstimate, request: AngularRequest, spectrum: SpectrumSolution, n_streams: int
) -> dict[str, Any]:
    """Return the attributes of a solution."""
    reached = estimate.compute_max_error(0, request.direction_mask)
    return {
        "stop_reason": "converged" if reached <= request.relative_stderr else "interpolation_bound",
        "rays": 0,
        "streams": n_streams,
        "truncation_error": float(spectrum.truncation.max()),
        "optics_error": float(spectrum.optics_error.max()),
    }
