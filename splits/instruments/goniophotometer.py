"""Virtual goniophotometer: angular distributions of reflected and transmitted light."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback, with_progress
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import check_choice, check_integer, check_range, invalid
from splits.instruments.angular_bins import DEFAULT_N_BINS, compute_bin_centres
from splits.instruments.angular_estimate import AngularEstimate, compute_max_relative_error
from splits.instruments.angular_expansion import make_direction_mask, trace_expansion
from splits.instruments.angular_result import (
    AngularResult,
    count_traced_rays,
    estimate_by_bins,
    from_detectors,
    make_angular_attributes,
    relabel_for_diffuse_light,
)
from splits.instruments.next_event import StoppingRule, estimate_at_detectors
from splits.media.medium import Medium
from splits.simulation.arguments import (
    check_dataset_size,
    check_direction_angles,
    check_incidence,
    check_medium,
    check_n_bins,
    check_threads,
    check_wavelengths,
)
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.runner import Runner
from splits.simulation.scene import compute_optical_constants, get_reflecting_ground
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.tracer import KERNELS

POLAR_DEG = tuple(np.arange(0.0, 90.0, 2.5).tolist())
AZIMUTH_DEG = tuple(np.arange(0.0, 360.0, 5.0).tolist())

ANGULAR_ESTIMATORS = ("expansion", "bins", "next_event")
TARGET_SIDES = {"brdf": 0, "btdf": 1}
TRANSMITTED_VARIABLES = ("btdf", "transmittance", "direct_transmittance")
"""Variables of light that leaves below, which is undefined over a ground."""

_INTERPOLATION_FRACTION = 0.05
"""Bound on the error of a reflectance from interpolation between refractive indices, relative to
the requested relative error."""


@reject_unknown_arguments
@with_progress
def goniophotometer(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    rays: int | None = None,
    seed: int = 1,
    *,
    relative_stderr: float = 0.02,
    target: str = "brdf",
    polar_deg: Any = POLAR_DEG,
    azimuth_deg: Any = AZIMUTH_DEG,
    estimator: str = "expansion",
    n_bins: tuple[int, int] = DEFAULT_N_BINS,
    max_rays: int = 1_000_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the BRDF and the BTDF of a medium under a beam, or its factors under diffuse light.

    Parameters
    ----------
    medium : GranularMedium or ParticleMedium
        For example `splits.Snow` or `splits.ParticleLayer`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of the beam, 0 to 89.9999 degrees, or isotropic radiance (for the estimator
        ``expansion`` only).  Above 89.9 degrees a run takes minutes, because few sampled grains fit
        below the boundary.
    rays : int, optional
        Number of rays, rounded up; by default the number that `relative_stderr` requires.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    relative_stderr : float
        Largest standard error relative to the value, 1e-4 to 0.5, for polar angles up to
        `splits.instruments.angular_expansion.MAX_CONVERGED_POLAR_DEG`; with ``next_event``, for
        all.
    target : {"brdf", "btdf"}
        The function to which the error applies; wavelengths without light there are ignored.
    polar_deg : array_like
        Angles from the vertical, 0 to below 90 degrees, strictly increasing: from straight up for
        reflected light, and from straight down for transmitted light.
    azimuth_deg : array_like
        Angles from the direction in which the beam travels, 0 to below 360 degrees, strictly
        increasing, for reflected and transmitted light.  The principal plane is 0 (forward) and 180
        (backward).
    estimator : {"expansion", "bins", "next_event"}
        "expansion" uses orthonormal polynomials over the hemisphere.  "bins" counts rays in angular
        bins of equal solid angle, the collectors of the papers, with `rays` rays, a million by
        default.  "next_event", for particle layers of one refractive index under a smooth surface,
        is next-event estimation: every scattering contributes to each direction, so the cost is
        proportional to the number of directions.
    n_bins : (int, int)
        Numbers of bins in polar angle and in azimuth.  Results are at the centres of the bins, and
        `polar_deg` and `azimuth_deg` are ignored.
    max_rays : int
        Number of rays after which a run to an error stops.  The attribute ``stop_reason`` is
        "converged", "max_rays", "max_degree" or "unresolved_lobe".  "max_degree" means that the
        light is in lobes too narrow for the polynomials, which more rays do not change; use bins.
        "unresolved_lobe" means that the run has converged except for directions in a lobe, where
        terms that are insignificant individually keep the reported error above the requested one
        (see ``relative_stderr_reached``); request a smaller error.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress` of relative
        errors.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``, ``polar`` and ``azimuth``: ``brdf`` and ``btdf`` (1/sr) of scattered
        light; the ``reflectance_factor`` π·BRDF; the ``anisotropy_factor``, π·BRDF divided by the
        reflectance of scattered light (its error is that of the BRDF alone), 0 without such light.
        Over ``wavelength``: ``reflectance`` and ``transmittance`` of all light, and their
        unscattered parts, which leave as collimated beams: ``specular_reflectance`` and
        ``direct_transmittance``.  All with their standard errors ``…_stderr``.

        Next-event estimation and bins of a polarized medium add ``brdf_q``, ``brdf_u``, ``brdf_v``
        and the same of the BTDF: Stokes parameters for unpolarized incidence, Q > 0 along the plane
        that contains the normal.  Over a diffuse bottom the BTDF is that of the light that arrives
        there, at angles within the layer; next-event estimation does not compute it.

        Under diffuse light there is no BRDF: ``reflectance_factor`` is then the
        hemispherical-directional one, of all light, ``transmittance_factor`` the same below, and
        ``reflectance`` and ``transmittance`` are bihemispherical.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 7; Budak & Grimailo 2020, Eqs 4-5; Nicodemus et al. (1977) for the
    terms.
    """
    check_medium(medium)
    wavelengths, incidence = check_wavelengths(wavelength_nm), check_incidence(incidence_deg)
    relative_stderr = check_range("relative_stderr", relative_stderr, 1e-4, 0.5)
    has_ground = get_reflecting_ground(medium) is not None
    side = _get_target_side(target, has_ground)
    _check_estimator(estimator, incidence)
    check_choice("kernel", kernel, KERNELS)
    seed, max_rays = check_integer("seed", seed, 0), check_integer("max_rays", max_rays, 1)
    if rays is not None:
        check_integer("rays", rays, 1)
    threads = check_threads(threads)
    start_time = time.perf_counter()
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = choose_nodes(index, medium.list_interfaces(), _INTERPOLATION_FRACTION * relative_stderr)
    runner = Runner(medium, incidence, seed, threads, False, kernel, progress)
    bins = n_bins if estimator == "bins" else None
    polar, azimuth = _make_directions(polar_deg, azimuth_deg, bins)
    check_dataset_size(len(wavelengths), len(polar) * len(azimuth))
    stopping_rule = StoppingRule(side, relative_stderr, rays, max_rays)
    if estimator == "bins":
        result = estimate_by_bins(runner, nodes, absorption, n_bins, rays or 1_000_000)
    elif estimator == "next_event":
        result = from_detectors(
            estimate_at_detectors(medium, polar, azimuth, stopping_rule, runner),
            wavelengths,
        )
    else:
        result = _estimate_by_expansion(runner, nodes, absorption, polar, azimuth, stopping_rule)
    direction_mask = make_direction_mask(polar, azimuth) | (estimator == "next_event")
    max_error = compute_max_relative_error(result.estimate, side, direction_mask)
    attributes = {
        **make_run_attributes(
            "Virtual goniophotometer", "goniophotometer", medium, start_time, seed, threads
        ),
        "incidence_deg": incidence,
        "estimator": estimator,
        "target": target,
        "relative_stderr_reached": max_error,
        **make_angular_attributes(result, stopping_rule, nodes, runner),
    }
    dataset = _make_dataset(result.estimate, result.stokes, wavelengths, polar, azimuth, attributes)
    undefined = TRANSMITTED_VARIABLES if has_ground else result.undefined_variables
    dataset = dataset.drop_vars([name + suffix for name in undefined for suffix in ("", "_stderr")])
    return relabel_for_diffuse_light(dataset) if incidence == "diffuse" else dataset


def _estimate_by_expansion(
    runner: Runner,
    nodes: IndexNodes,
    absorption: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    stopping_rule: StoppingRule,
) -> AngularResult:
    """Return the result of the expansion in polynomials."""
    tallies, estimate, stop_reason = trace_expansion(
        runner, nodes, absorption, polar, azimuth, stopping_rule
    )
    return AngularResult(estimate, stop_reason, count_traced_rays(tallies), tallies)


def _check_estimator(estimator: str, incidence: float | str) -> None:
    """Check the estimator, and that it supports the incidence."""
    check_choice("estimator", estimator, ANGULAR_ESTIMATORS)
    if isinstance(incidence, str) and estimator != "expansion":
        allowed = "an angle for this estimator"
        raise invalid("incidence_deg", incidence, allowed, "expansion allows it")


def _get_target_side(target: str, has_ground: bool) -> int:
    """Return the side of the sample of the target, which must not be that of a ground."""
    side = TARGET_SIDES[check_choice("target", target, TARGET_SIDES)]
    if has_ground and side == 1:
        raise invalid("target", target, "brdf over a ground", "no light leaves through a ground")
    return side


def _make_directions(
    polar_deg: Any, azimuth_deg: Any, n_bins: tuple[int, int] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the requested directions (degrees), or those of bin centres."""
    if n_bins is not None:
        return compute_bin_centres(check_n_bins(n_bins))
    return check_direction_angles("polar_deg", polar_deg, 90.0), check_direction_angles(
        "azimuth_deg", azimuth_deg, 360.0
    )


def _make_dataset(
    estimate: AngularEstimate,
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    wavelengths: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Return an estimate as a labelled dataset."""
    grid = ("wavelength", "polar", "azimuth")
    shape = (len(wavelengths), len(polar), len(azimuth))
    scattered = estimate.compute_scattered()[0][:, np.newaxis]
    anisotropy_scale = np.divide(
        np.pi, scattered, out=np.zeros_like(scattered), where=scattered > 0.0
    )
    variables: dict[str, Variable] = {}
    directional = {
        "brdf": ("bidirectional reflectance distribution function", "sr-1", 0, 1.0),
        "btdf": ("bidirectional transmittance distribution function", "sr-1", 1, 1.0),
        "reflectance_factor": ("bidirectional reflectance factor", "1", 0, np.pi),
        "anisotropy_factor": ("anisotropy factor", "1", 0, anisotropy_scale),
    }
    for name, (long_name, units, side, factor) in directional.items():
        mean = (factor * estimate.mean[side]).reshape(shape)
        stderr = (factor * estimate.stderr[side]).reshape(shape)
        variables |= make_variable(name, grid, mean, stderr, long_name, units)
    for name, (values, error) in stokes.items():
        component = name[-1].upper()
        label = f"Stokes {component} of the light of the {name[:4].upper()}"
        variables |= make_variable(
            name, grid, values.reshape(shape), error.reshape(shape), label, "sr-1"
        )
    hemispherical = {
        "reflectance": ("directional-hemispherical reflectance", 0, 0),
        "transmittance": ("directional-hemispherical transmittance", 0, 1),
        "specular_reflectance": ("reflectance without scattering", 2, 0),
        "direct_transmittance": ("transmittance without scattering", 2, 1),
    }
    for name, (long_name, row, side) in hemispherical.items():
        mean, stderr = estimate.hemispherical[row : row + 2, side]
        variables |= make_variable(name, "wavelength", mean, stderr, long_name)
    angle_attributes = {"units": "degree"}
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "polar": ("polar", polar, {**angle_attributes, "long_name": "angle from the normal"}),
        "azimuth": (
            "azimuth",
            azimuth,
            {**angle_attributes, "long_name": "angle from the direction in which the beam travels"},
        ),
    }
    return xr.Dataset(variables, coordinates, attributes)
