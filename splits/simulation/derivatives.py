"""Derivatives of spectra: which parameters have exact ones and which need finite differences.

Parameters that only change absorption along the same paths (impurities, the albedo of a ground, the
size of everything in a semi-infinite medium) have exact derivatives, estimated from the paths of
the spectrum.  All others change the paths: see `splits.simulation.finite_differences`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.parameter_names import IMPURITY_KEYWORDS
from splits.core.uncertainty import Variable, make_deviation_variable, make_variable
from splits.core.validation import InvalidValue, invalid
from splits.media.medium import Medium
from splits.media.parameters import (
    INCIDENCE_KEY,
    get_derivative_unit,
    get_parameter,
    shift_parameter,
)
from splits.simulation.path_reuse import compute_path_signature
from splits.simulation.spectral_rows import PathSharingMedia
from splits.simulation.spectral_tally import Derivatives

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
    if not key or key[0] not in IMPURITY_KEYWORDS:
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


def make_jacobian_variables(derivatives: Derivatives, names: Sequence[str]) -> dict[str, Variable]:
    """Return derivatives of reflectance and transmittance over parameter and wavelength."""
    variables: dict[str, Variable] = {}
    dims = ("parameter", "wavelength")
    for side, name in enumerate(names):
        label = f"derivative of {name} with respect to the parameter, in the inverse of its unit"
        key = f"{name}_jacobian"
        mean, stderr = derivatives.mean[side], derivatives.stderr[side]
        variables |= make_variable(key, dims, mean, stderr, label)
        deviations = derivatives.batch_deviations[:, side]
        variables |= make_deviation_variable(key, dims, deviations, label)
    return variables


def make_parameter_coordinates(parameters: Sequence[str], methods: list[str]) -> dict[str, object]:
    """Return the coordinates of the parameters, with the methods of their derivatives."""
    units = [get_derivative_unit(parameter) for parameter in parameters]
    return {
        "parameter": ("parameter", list(parameters), {"long_name": "parameter of the medium"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the parameter"}),
        "parameter_method": ("parameter", methods, {"long_name": "method of its derivatives"}),
    }
