"""What derivatives a spectrum is to come with, and what they become in a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.checks import refuse
from splits.instruments.scenes import constants_of
from splits.instruments.shared_paths import Slopes
from splits.media.granular import GranularMedium, LayeredMedium
from splits.media.parameters import moved, unit_of
from splits.media.turbid import Medium
from splits.uncertainty import Variable, deviations, quantity

STEP = 1e-3
"""Part of what any wavelength's absorption is moved by at most: what absorbs is linear in amounts
of impurities, and diffusion theory, where it stands for the rest of a pack, is smooth."""
LEAST_PER_M = 1e-7
"""By how much (1/m) it is moved where nothing absorbs: theory goes as its root."""


class Moves(NamedTuple):
    """Parameters, and a medium with one after the other moved.

    Attributes
    ----------
    parameters : tuple of str
    media : tuple of Medium
    steps : float, shape (parameters,)
    """

    parameters: tuple[str, ...]
    media: tuple[Medium, ...]
    steps: np.ndarray

    @classmethod
    def of(cls, medium: Medium, jacobian: Any, wavelengths: np.ndarray) -> Moves:
        """Return the moves that a user asks for, or refuse them.

        Raises
        ------
        ValueError
            For a parameter that the medium does not have, or named twice.
        """
        if isinstance(jacobian, str) or not isinstance(jacobian, Sequence):
            raise refuse("jacobian", jacobian, "a list of parameters")
        names = tuple(jacobian)
        if names and not isinstance(medium, GranularMedium | LayeredMedium):
            raise refuse("jacobian", list(names), "left out for this medium")
        for name in names:
            if names.count(name) > 1:
                raise refuse("jacobian", name, "named once")
        base = constants_of(medium, wavelengths).absorption if names else np.zeros(0)
        steps = np.array([_step(medium, name, base, wavelengths) for name in names])
        media = tuple(moved(medium, n, float(step)) for n, step in zip(names, steps, strict=True))
        return cls(names, media, steps)


def _step(medium: Medium, parameter: str, base: np.ndarray, wavelengths: np.ndarray) -> float:
    """Return by how much to move a parameter."""
    rise = np.abs(constants_of(moved(medium, parameter, 1.0), wavelengths).absorption - base)
    steps = [1.0]
    for before, more in zip(base, rise, strict=True):
        absorbing = before > 0.0
        both = absorbing & (more > 0.0)
        if both.any():
            steps.append(STEP * float((before[both] / more[both]).min()))
        elif more.any():
            # Clean pores, for example: what else absorbs is there to be compared with.
            least = STEP * before[absorbing].min() if absorbing.any() else LEAST_PER_M
            steps.append(float(least / more.max()))
    return min(steps)


def slope_variables(
    slopes: Slopes, parameters: Sequence[str], names: Sequence[str]
) -> dict[str, Variable]:
    """Return derivatives of reflectance and transmittance over parameter and wavelength."""
    found: dict[str, Variable] = {}
    if not parameters:
        return found
    dims = ("parameter", "wavelength")
    for side, name in enumerate(names):
        label = f"derivative of {name} to the parameter, in the inverse of its unit"
        key = f"{name}_jacobian"
        found |= quantity(key, dims, slopes.mean[side], slopes.stderr[side], label)
        found |= deviations(key, dims, slopes.groups[:, side], label)
    return found


def parameter_axis(parameters: Sequence[str]) -> dict[str, Any]:
    """Return the coordinates of parameters, none without any."""
    if not parameters:
        return {}
    units = [unit_of(parameter) for parameter in parameters]
    return {
        "parameter": ("parameter", list(parameters), {"long_name": "parameter of the medium"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of derivatives to it"}),
    }
