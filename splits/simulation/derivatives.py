"""Derivatives of spectra: which parameters have exact ones and which need finite differences.

Parameters that only change absorption along the same paths (impurities, the albedo of a ground, the
size of everything in a semi-infinite medium) have exact derivatives, estimated from the paths of
the spectrum.  All others change the paths and need finite differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import InvalidValue, invalid
from splits.media.medium import Medium
from splits.media.parameters import (
    INCIDENCE_KEY,
    choose_step,
    get_derivative_unit,
    get_parameter,
    get_parameter_quantity,
    list_amounts,
    replace_parameter,
    shift_parameter,
)
from splits.simulation.shared_paths import PathSharingMedia, compute_path_signature
from splits.simulation.spectral_nodes import bound_derivative_error
from splits.simulation.spectral_tally import SIDE_QUANTITIES, Derivatives, SpectralEstimate

MAX_ABSORPTION_STEP = 1e-3
"""Largest relative change of the absorption at any wavelength: absorption is linear in amounts of
impurities, and diffusion theory below a truncation depth is smooth."""
MIN_ABSORPTION_STEP_PER_M = 1e-7
"""Change of the absorption (1/m) where nothing absorbs; diffusion theory depends on its root."""
PARAMETER_STEP = 1e-4
"""Relative change of other parameters."""


class Perturbations(NamedTuple):
    """Parameters that change only absorption, so that the paths of a spectrum give derivatives.

    Attributes
    ----------
    parameters : tuple of str
    media : tuple of Medium
        Each with one of the parameters changed.
    size_ratios : float, shape (parameters,)
        Sizes of these in units of the unperturbed medium's.
    steps : float, shape (parameters,)
        Changes of the parameters.
    """

    parameters: tuple[str, ...]
    media: tuple[Medium, ...]
    size_ratios: np.ndarray
    steps: np.ndarray

    @classmethod
    def select_exact(
        cls, medium: Medium, names: Sequence[str], wavelengths: np.ndarray
    ) -> Perturbations:
        """Return the perturbations of the parameters that leave the paths unchanged."""
        if not names:
            return NO_PERTURBATIONS
        signature, perturbations = compute_path_signature(medium), []
        for name in names:
            step = _choose_step(medium, name, wavelengths)
            if not step:
                continue
            perturbed = shift_parameter(medium, name, step)
            perturbed_signature, unit = compute_path_signature(perturbed)
            if perturbed_signature == signature[0]:
                perturbations.append((name, perturbed, unit / signature[1], step))
        parameters, media, size_ratios, steps = (
            zip(*perturbations, strict=True) if perturbations else ((),) * 4
        )
        return cls(parameters, media, np.array(size_ratios), np.array(steps))

    def list_methods(self, names: Sequence[str]) -> list[str]:
        """Return the methods of the derivatives with respect to parameters."""
        return [
            "shared_paths" if name in self.parameters else "finite_difference" for name in names
        ]


NO_PERTURBATIONS = Perturbations((), (), np.zeros(0), np.zeros(0))


def check_jacobian(medium: Medium, incidence: float | str, jacobian: Any) -> tuple[str, ...]:
    """Return the parameters for which derivatives are requested, after checking them.

    Raises
    ------
    ValueError
        For a parameter that the medium does not have, or named twice.
    """
    if isinstance(jacobian, str) or not isinstance(jacobian, Sequence):
        raise invalid("jacobian", jacobian, "a list of parameters")
    names = tuple(jacobian)
    for name in names:
        if names.count(name) > 1:
            raise invalid("jacobian", name, "named once")
        if name != INCIDENCE_KEY:
            value = get_parameter(medium, name, [INCIDENCE_KEY])
            if not math.isfinite(value):
                raise invalid("jacobian", name, "of a finite value", f"here it is {value:g}")
        elif isinstance(incidence, str):
            raise invalid("jacobian", name, "left out for diffuse light", "it belongs to a beam")
    return names


def _choose_step(medium: Medium, name: str, wavelengths: np.ndarray) -> float:
    """Return the step of a parameter, 0 where its change is known to alter the paths."""
    if name == INCIDENCE_KEY:
        return 0.0
    key = name.split(".")[-2:-1]
    if not key or key[0] not in list_amounts():
        size = PARAMETER_STEP * abs(get_parameter(medium, name))
        for step in (size, -size):
            try:
                shift_parameter(medium, name, step)
            except InvalidValue:
                continue
            return step
        return 0.0
    base, perturbed = (
        PathSharingMedia.from_media([one]).compute_constants(wavelengths)[0].absorption
        for one in (medium, shift_parameter(medium, name, 1.0))
    )
    steps = [1.0]
    for before, change in zip(base, np.abs(perturbed - base), strict=True):
        absorbing = before > 0.0
        changed = absorbing & (change > 0.0)
        if changed.any():
            steps.append(MAX_ABSORPTION_STEP * float((before[changed] / change[changed]).min()))
        elif change.any():
            # Clean pores, for example: the step is relative to the other absorbing materials.
            min_change = (
                MAX_ABSORPTION_STEP * before[absorbing].min()
                if absorbing.any()
                else MIN_ABSORPTION_STEP_PER_M
            )
            steps.append(float(min_change / change.max()))
    return min(steps)


def add_jacobian(
    dataset: xr.Dataset, derivatives: Derivatives, parameters: Sequence[str], methods: list[str]
) -> xr.Dataset:
    """Return a dataset with derivatives of reflectance and transmittance.

    They are over parameter and wavelength; the methods are coordinates over the parameter.
    """
    variables: dict[str, Variable] = {}
    dims = ("parameter", "wavelength")
    for side, name in enumerate(SIDE_QUANTITIES):
        label = f"derivative of {name} with respect to the parameter, in the inverse of its unit"
        key = f"{name}_jacobian"
        mean, stderr = derivatives.mean[side], derivatives.stderr[side]
        deviations = derivatives.batch_deviations[:, side]
        variables |= make_variable(key, dims, mean, stderr, label, deviations=deviations)
    units = [get_derivative_unit(parameter) for parameter in parameters]
    coordinates = {
        "parameter": ("parameter", list(parameters), {"long_name": "parameter of the medium"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the parameter"}),
        "parameter_method": ("parameter", methods, {"long_name": "method of its derivatives"}),
    }
    return dataset.assign_coords(coordinates).assign(variables)


# --------------------------------------------------------------------------------------------------
# Derivatives to parameters that change the paths: finite differences with common random numbers.
#
# Two media that differ a little are sampled by almost the same paths, so that noise mostly cancels
# (common random numbers; Glasserman & Yao 1992, Management Science 38, 884-908).  Four runs around
# the value, or on one side where a range ends, leave an error of the fourth or third order of the
# step.

FIRST_STEP_FRACTION = 0.25
"""First step relative to the value: larger steps have less noise, but more truncation error."""
MAX_HALVINGS = 10
MIN_CONVERGENCE_RATIO = 1.2
"""Smallest ratio of successive changes, as the step is halved, of a derivative that converges."""
STENCIL_OFFSETS = tuple(
    tuple(place + shift for place in (-2.0, -1.0, 1.0, 2.0))
    for shift in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0)
)
"""Stencil points in steps: around the value, or increasingly one-sided where a range ends."""

MediumEstimator = Callable[[Medium, float | str], SpectralEstimate]


def compute_finite_difference(
    estimator: MediumEstimator, medium: Medium, incidence: float | str, parameter: str
) -> tuple[Derivatives, int]:
    """Return derivatives with respect to a parameter, and the number of rays traced for them.

    The step is halved until the truncation error of the stencil is smaller than noise.  For
    one-sided stencils the error estimate of a single stencil is not sufficient, as reflectance may
    be singular within any step; the change of the derivative with the step is then included.

    Parameters
    ----------
    estimator : callable
        Takes a medium and an incidence, returns an estimate from the same random numbers each time.
    medium : Medium
    incidence : float or "diffuse"
    parameter : str

    Raises
    ------
    ValueError
        Where no valid medium lies near this one, or reflectance has a square-root singularity here.
    """
    value = float(incidence) if parameter == INCIDENCE_KEY else get_parameter(medium, parameter)
    coordinate = _Coordinate.for_parameter(parameter, value)
    first_step = coordinate.choose_first_step(parameter)
    estimates: dict[float, SpectralEstimate] = {}
    best: Derivatives | None = None
    one_sided: list[Derivatives] = []
    last_error = invalid(parameter, value, "inside its range")
    for halving in range(MAX_HALVINGS + 1):
        step = first_step * 0.5**halving
        try:
            offsets, inputs = _make_stencil(medium, incidence, parameter, coordinate, step)
        except InvalidValue as error:
            last_error = error
            continue
        for x, perturbed in inputs.items():
            if x not in estimates:
                estimates[x] = estimator(*perturbed)
        derivatives = _differentiate(offsets, step, [estimates[x] for x in inputs])
        if sum(offsets) != 0.0:
            one_sided.append(derivatives)
            best = derivatives = _bound_step_error(one_sided)
            is_estimated = len(one_sided) > 1
        else:
            # One-sided stencils are compared by their errors only where there is no other.
            is_better = (
                best is None or one_sided or (derivatives.stderr**2).sum() < (best.stderr**2).sum()
            )
            best = derivatives if is_better else best
            one_sided, is_estimated = [], True
        if is_estimated and (derivatives.bias_bound**2).sum() < 0.5 * (derivatives.stderr**2).sum():
            break
    if best is None:
        raise last_error
    if len(one_sided) > 2:
        # The derivative must not grow each time the step is halved.
        sizes = [float(np.sqrt((one.mean**2).sum())) for one in one_sided[-3:]]
        noise = float(np.sqrt((best.batch_deviations**2).sum()))
        slowest = min(sizes[1] / sizes[0], sizes[2] / sizes[1])
        if slowest > MIN_CONVERGENCE_RATIO and sizes[2] - sizes[0] > 4.0 * noise:
            hint = "reflectance has a square-root singularity there: choose a nearby value"
            raise invalid(f"jacobian ({parameter})", value, "where the derivative is finite", hint)
    n_rays = sum(one.rays["rays"] for one in estimates.values())
    return coordinate.to_value_derivatives(best), n_rays


class _Coordinate(NamedTuple):
    """Coordinate in which differences are taken: the value, or the root of a distance.

    Near the end of its range that a parameter declares, reflectance depends on the square root of
    the distance: of the water in narrow pores, of absorption.

    Attributes
    ----------
    start : float
        Coordinate of the value.
    endpoint : float
        Value from which the root counts.
    sign : float
        Direction from the endpoint; 0 where the coordinate is the value itself.
    """

    start: float
    endpoint: float
    sign: float

    @classmethod
    def for_parameter(cls, parameter: str, value: float) -> _Coordinate:
        """Return the coordinate for a parameter; at the endpoint it is the value itself."""
        endpoint = get_parameter_quantity(parameter).root_at
        if endpoint is None or value == endpoint:
            return cls(value, 0.0, 0.0)
        return cls(abs(value - endpoint) ** 0.5, endpoint, 1.0 if endpoint == 0.0 else -1.0)

    def choose_first_step(self, parameter: str) -> float:
        """Return the first step of the coordinate."""
        size = self.start**2 if self.sign else abs(self.start)
        step = choose_step(parameter, size, FIRST_STEP_FRACTION)
        return float((size + step) ** 0.5 - self.start if self.sign else step)

    def to_value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return self.endpoint + self.sign * coordinate**2 if self.sign else coordinate

    def to_value_derivatives(self, derivatives: Derivatives) -> Derivatives:
        """Convert derivatives with respect to the coordinate to those with respect to the value."""
        rate = 1.0 / (2.0 * self.sign * self.start) if self.sign else 1.0
        return Derivatives(
            rate * derivatives.mean,
            rate * derivatives.batch_deviations,
            abs(rate) * derivatives.bias_bound,
        )


def _make_stencil(
    medium: Medium, incidence: float | str, parameter: str, coordinate: _Coordinate, step: float
) -> tuple[tuple[float, ...], dict[float, tuple[Medium, float | str]]]:
    """Return stencil points in steps, and the medium and incidence at each coordinate.

    Raises
    ------
    ValueError
        If no stencil is within the range of the parameter.
    """
    last_error = invalid(parameter, coordinate.to_value(coordinate.start), "inside its range")
    for offsets in STENCIL_OFFSETS:
        points = [coordinate.start + offset * step for offset in offsets]
        if coordinate.sign and min(points) < 0.0:
            continue
        inputs: dict[float, tuple[Medium, float | str]] = {}
        try:
            for point in points:
                value = coordinate.to_value(point)
                if parameter != INCIDENCE_KEY:
                    inputs[point] = replace_parameter(medium, parameter, value), incidence
                elif not 0.0 <= value < 90.0:
                    raise invalid(INCIDENCE_KEY, value, "0 to below 90 degrees")
                else:
                    inputs[point] = medium, value
        except InvalidValue as error:
            last_error = error
        else:
            return offsets, inputs
    raise last_error


def _differentiate(
    offsets: tuple[float, ...], step: float, estimates: Sequence[SpectralEstimate]
) -> Derivatives:
    """Return derivatives from runs at stencil points."""
    means = np.stack([one.mean[:2] for one in estimates])
    batch_deviations = np.stack([one.batch_deviations for one in estimates])
    fine, coarse = _compute_stencil_weights(offsets, step)
    mean, coarse_mean = (np.tensordot(weights, means, 1) for weights in (fine, coarse))
    noise = (np.tensordot(fine - coarse, batch_deviations, 1) ** 2).sum(axis=0)
    # The error of the lower-order rule, above noise, is proportional to the step squared; that of
    # the higher-order rule to its fourth power, or the third where the stencil is not symmetric.
    coarse_error = np.sqrt(np.maximum((coarse_mean - mean) ** 2 - noise, 0.0))
    size = np.abs(mean)
    relative_error = np.divide(coarse_error, size, out=np.ones_like(coarse_error), where=size > 0.0)
    is_symmetric = sum(offsets) == 0.0
    truncation_error = coarse_error * (relative_error if is_symmetric else np.sqrt(relative_error))
    # With truncation, the error of the theory is added.
    bounds = [np.maximum(one.interpolation_error[:2], one.interpolation_bound) for one in estimates]
    interpolation_error = bound_derivative_error(np.max(bounds, axis=0), mean)
    error_bound = np.hypot(np.minimum(truncation_error, coarse_error), interpolation_error)
    return Derivatives(
        mean[:, None], np.tensordot(fine, batch_deviations, 1)[:, :, None], error_bound[:, None]
    )


def _bound_step_error(one_sided_derivatives: Sequence[Derivatives]) -> Derivatives:
    """Return the last derivatives, with an error bound from their change with the step.

    If each halving changes them by 1/r of the previous change, the remaining error is 1/(r − 1) of
    the last one.
    """
    last = one_sided_derivatives[-1]
    if len(one_sided_derivatives) < 2:
        return last
    changes = [float(np.sqrt(((b.mean - a.mean) ** 2).sum()))
             for a, b in pairwise(one_sided_derivatives[-3:])]  # fmt: skip
    ratio = changes[0] / max(changes[-1], 1e-300) if len(changes) > 1 else 2.0
    factor = 1.0 / (min(max(ratio, MIN_CONVERGENCE_RATIO), 8.0) - 1.0)
    error_bound = factor * np.abs(last.mean - one_sided_derivatives[-2].mean)
    return last._replace(bias_bound=np.maximum(last.bias_bound, error_bound))


def _compute_stencil_weights(
    offsets: tuple[float, ...], step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the highest-order rule, and those of one of lower order."""
    points = np.array(offsets, dtype=float)
    fine = compute_difference_weights(points) / step
    coarse = np.zeros_like(fine)
    subset = [0, 3] if points.sum() == 0.0 else np.argsort(np.abs(points), kind="stable")[:3]
    coarse[subset] = compute_difference_weights(points[subset]) / step
    return fine, coarse


def compute_difference_weights(positions: np.ndarray) -> np.ndarray:
    """Return the weights whose sum is the derivative at 0 of the interpolating polynomial."""
    powers = np.vander(positions, increasing=True).T
    return np.linalg.solve(powers, np.eye(len(positions))[1])
