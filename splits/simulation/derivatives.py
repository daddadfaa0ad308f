"""What derivatives a spectrum is to come with, and how each of them is found.

What only changes how much is absorbed along the same paths (impurities, the albedo of a ground, the
size of everything in a pack without end) has exact derivatives, from the paths of the spectrum
itself.  All else changes the paths: `splits.simulation.finite_differences`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.parameter_names import IMPURITY_KEYWORDS
from splits.core.uncertainty import Variable, make_deviation_variable, make_variable
from splits.core.validation import invalid
from splits.media.medium import GranularMedium, LayeredMedium, Medium
from splits.media.parameters import (
    INCIDENCE_KEY,
    get_derivative_unit,
    get_parameter,
    shift_parameter,
)
from splits.simulation.finite_differences import FiniteDifference
from splits.simulation.path_reuse import compute_path_signature
from splits.simulation.path_tally import Derivatives, PathSharingMedia

MAX_ABSORPTION_STEP = 1e-3
"""Part of what any wavelength's absorption is moved by at most: what absorbs is linear in amounts
of impurities, and diffusion theory, where it stands for the rest of a pack, is smooth."""
MIN_ABSORPTION_STEP_PER_M = 1e-7
"""By how much (1/m) it is moved where nothing absorbs: theory goes as its root."""
PARAMETER_STEP = 1e-4
"""Part of itself that another parameter is moved by."""


class Perturbations(NamedTuple):
    """Parameters whose derivatives come from the paths of a spectrum itself.

    Attributes
    ----------
    parameters : tuple of str
    media : tuple of Medium
        With one after the other moved.
    size_ratios : float, shape (parameters,)
        Sizes of these in units of the medium's own.
    steps : float, shape (parameters,)
        By so much each is moved.
    """

    parameters: tuple[str, ...]
    media: tuple[Medium, ...]
    size_ratios: np.ndarray
    steps: np.ndarray

    @classmethod
    def select_exact(
        cls, medium: Medium, names: Sequence[str], wavelengths: np.ndarray
    ) -> Perturbations:
        """Return the moves of those parameters that leave the paths as they are."""
        own, found = compute_path_signature(medium) if _is_granular(medium) else (b"", 1.0), []
        for name in names:
            step = _choose_step(medium, name, wavelengths) if _is_granular(medium) else 0.0
            if not step:
                continue
            other = shift_parameter(medium, name, step)
            alike, unit = compute_path_signature(other)
            if alike == own[0]:
                found.append((name, other, unit / own[1], step))
        parameters, media, scales, steps = zip(*found, strict=True) if found else ((),) * 4
        return cls(parameters, media, np.array(scales), np.array(steps))


NO_PERTURBATIONS = Perturbations((), (), np.zeros(0), np.zeros(0))


def check_jacobian(medium: Medium, incidence: float | str, jacobian: Any) -> tuple[str, ...]:
    """Return the parameters that a user asks derivatives to, or refuse them.

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
            value = get_parameter(medium, name)
            if not math.isfinite(value):
                raise invalid("jacobian", name, "of a finite value", f"here it is {value:g}")
        elif isinstance(incidence, str):
            raise invalid("jacobian", name, "left out under this light", "it is one of a beam")
    return names


def _is_granular(medium: Medium) -> bool:
    return isinstance(medium, GranularMedium | LayeredMedium)


def _choose_step(medium: Medium, name: str, wavelengths: np.ndarray) -> float:
    """Return by how much to move a parameter, 0 where it can be told that paths change."""
    if name == INCIDENCE_KEY:
        return 0.0
    amount = name.split(".")[-2:-1]
    if not amount or amount[0] not in IMPURITY_KEYWORDS:
        trial = PARAMETER_STEP * abs(get_parameter(medium, name))
        for step in (trial, -trial):
            try:
                shift_parameter(medium, name, step)
            except ValueError:
                continue
            return step
        return 0.0
    base, more = (
        PathSharingMedia.from_media([one]).compute_constants(wavelengths)[0].absorption
        for one in (medium, shift_parameter(medium, name, 1.0))
    )
    steps = [1.0]
    for before, rise in zip(base, np.abs(more - base), strict=True):
        absorbing = before > 0.0
        both = absorbing & (rise > 0.0)
        if both.any():
            steps.append(MAX_ABSORPTION_STEP * float((before[both] / rise[both]).min()))
        elif rise.any():
            # Clean pores, for example: what else absorbs is there to be compared with.
            least = (
                MAX_ABSORPTION_STEP * before[absorbing].min()
                if absorbing.any()
                else MIN_ABSORPTION_STEP_PER_M
            )
            steps.append(float(least / rise.max()))
    return min(steps)


def combine_derivatives(
    names: Sequence[str],
    exact: Derivatives,
    perturbations: Perturbations,
    finite_differences: Sequence[FiniteDifference],
) -> Derivatives:
    """Return derivatives in the order asked for, of paths and of differences."""
    found = {name: exact.select(slice(i, i + 1)) for i, name in enumerate(perturbations.parameters)}
    found |= {one.parameter: one.derivatives for one in finite_differences}
    rows = [found[name] for name in names]
    return Derivatives(
        np.concatenate([row.mean for row in rows], axis=1),
        np.concatenate([row.batch_deviations for row in rows], axis=2),
        np.concatenate([row.bias_bound for row in rows], axis=1),
    )


def make_jacobian_variables(
    derivatives: Derivatives, parameters: Sequence[str], names: Sequence[str]
) -> dict[str, Variable]:
    """Return derivatives of reflectance and transmittance over parameter and wavelength."""
    found: dict[str, Variable] = {}
    if not parameters:
        return found
    dims = ("parameter", "wavelength")
    for side, name in enumerate(names):
        label = f"derivative of {name} to the parameter, in the inverse of its unit"
        key = f"{name}_jacobian"
        found |= make_variable(key, dims, derivatives.mean[side], derivatives.stderr[side], label)
        found |= make_deviation_variable(key, dims, derivatives.batch_deviations[:, side], label)
    return found


def make_parameter_coordinates(
    parameters: Sequence[str], perturbations: Perturbations
) -> dict[str, object]:
    """Return the coordinates of parameters, none without any."""
    if not parameters:
        return {}
    units = [get_derivative_unit(parameter) for parameter in parameters]
    how = [
        "shared_paths" if name in perturbations.parameters else "finite_difference"
        for name in parameters
    ]
    return {
        "parameter": ("parameter", list(parameters), {"long_name": "parameter of the medium"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of derivatives to it"}),
        "parameter_method": ("parameter", how, {"long_name": "where derivatives to it are from"}),
    }
