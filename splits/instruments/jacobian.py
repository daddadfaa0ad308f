"""What derivatives a spectrum is to come with, and how each of them is found.

What only changes how much is absorbed along the same paths (impurities, the albedo of a ground, the
size of everything in a pack without end) has exact derivatives, from the paths of the spectrum
itself.  All else changes the paths: `splits.instruments.differences`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.checks import refuse
from splits.instruments.differences import Differences
from splits.instruments.families import likeness
from splits.instruments.shared_paths import Family, Slopes
from splits.media.granular import GranularMedium, LayeredMedium
from splits.media.parameters import INCIDENCE, moved, unit_of, value_of
from splits.media.turbid import Medium
from splits.names import AMOUNTS
from splits.uncertainty import Variable, deviations, quantity

STEP = 1e-3
"""Part of what any wavelength's absorption is moved by at most: what absorbs is linear in amounts
of impurities, and diffusion theory, where it stands for the rest of a pack, is smooth."""
LEAST_PER_M = 1e-7
"""By how much (1/m) it is moved where nothing absorbs: theory goes as its root."""
SMALL = 1e-4
"""Part of itself that another parameter is moved by."""


class Moves(NamedTuple):
    """Parameters whose derivatives come from the paths of a spectrum itself.

    Attributes
    ----------
    parameters : tuple of str
    media : tuple of Medium
        With one after the other moved.
    scales : float, shape (parameters,)
        Sizes of these in units of the medium's own.
    steps : float, shape (parameters,)
        By so much each is moved.
    """

    parameters: tuple[str, ...]
    media: tuple[Medium, ...]
    size_ratios: np.ndarray
    steps: np.ndarray

    @classmethod
    def select_exact(cls, medium: Medium, names: Sequence[str], wavelengths: np.ndarray) -> Moves:
        """Return the moves of those parameters that leave the paths as they are."""
        own, found = likeness(medium) if _grains(medium) else (b"", 1.0), []
        for name in names:
            step = _step(medium, name, wavelengths) if _grains(medium) else 0.0
            if not step:
                continue
            other = moved(medium, name, step)
            alike, unit = likeness(other)
            if alike == own[0]:
                found.append((name, other, unit / own[1], step))
        parameters, media, scales, steps = zip(*found, strict=True) if found else ((),) * 4
        return cls(parameters, media, np.array(scales), np.array(steps))


NO_MOVES = Moves((), (), np.zeros(0), np.zeros(0))


def checked(medium: Medium, incidence: float | str, jacobian: Any) -> tuple[str, ...]:
    """Return the parameters that a user asks derivatives to, or refuse them.

    Raises
    ------
    ValueError
        For a parameter that the medium does not have, or named twice.
    """
    if isinstance(jacobian, str) or not isinstance(jacobian, Sequence):
        raise refuse("jacobian", jacobian, "a list of parameters")
    names = tuple(jacobian)
    for name in names:
        if names.count(name) > 1:
            raise refuse("jacobian", name, "named once")
        if name != INCIDENCE:
            value = value_of(medium, name)
            if not math.isfinite(value):
                raise refuse("jacobian", name, "of a finite value", f"here it is {value:g}")
        elif isinstance(incidence, str):
            raise refuse("jacobian", name, "left out under this light", "it is one of a beam")
    return names


def _grains(medium: Medium) -> bool:
    return isinstance(medium, GranularMedium | LayeredMedium)


def _step(medium: Medium, name: str, wavelengths: np.ndarray) -> float:
    """Return by how much to move a parameter, 0 where it can be told that paths change."""
    if name == INCIDENCE:
        return 0.0
    amount = name.split(".")[-2:-1]
    if not amount or amount[0] not in AMOUNTS:
        trial = SMALL * abs(value_of(medium, name))
        for step in (trial, -trial):
            try:
                moved(medium, name, step)
            except ValueError:
                continue
            return step
        return 0.0
    base, more = (
        Family.from_media([one]).compute_constants(wavelengths)[0].absorption
        for one in (medium, moved(medium, name, 1.0))
    )
    steps = [1.0]
    for before, rise in zip(base, np.abs(more - base), strict=True):
        absorbing = before > 0.0
        both = absorbing & (rise > 0.0)
        if both.any():
            steps.append(STEP * float((before[both] / rise[both]).min()))
        elif rise.any():
            # Clean pores, for example: what else absorbs is there to be compared with.
            least = STEP * before[absorbing].min() if absorbing.any() else LEAST_PER_M
            steps.append(float(least / rise.max()))
    return min(steps)


def together(
    names: Sequence[str], exact: Slopes, perturbations: Moves, finite_differences: Sequence[Differences]
) -> Slopes:
    """Return derivatives in the order asked for, of paths and of differences."""
    found = {name: exact.select(slice(i, i + 1)) for i, name in enumerate(perturbations.parameters)}
    found |= {one.parameter: one.derivatives for one in finite_differences}
    rows = [found[name] for name in names]
    return Slopes(
        np.concatenate([row.mean for row in rows], axis=1),
        np.concatenate([row.batch_deviations for row in rows], axis=2),
        np.concatenate([row.bias_bound for row in rows], axis=1),
    )


def slope_variables(
    derivatives: Slopes, parameters: Sequence[str], names: Sequence[str]
) -> dict[str, Variable]:
    """Return derivatives of reflectance and transmittance over parameter and wavelength."""
    found: dict[str, Variable] = {}
    if not parameters:
        return found
    dims = ("parameter", "wavelength")
    for side, name in enumerate(names):
        label = f"derivative of {name} to the parameter, in the inverse of its unit"
        key = f"{name}_jacobian"
        found |= quantity(key, dims, derivatives.mean[side], derivatives.stderr[side], label)
        found |= deviations(key, dims, derivatives.batch_deviations[:, side], label)
    return found


def parameter_axis(parameters: Sequence[str], perturbations: Moves) -> dict[str, object]:
    """Return the coordinates of parameters, none without any."""
    if not parameters:
        return {}
    units = [unit_of(parameter) for parameter in parameters]
    how = ["paths" if name in perturbations.parameters else "differences" for name in parameters]
    return {
        "parameter": ("parameter", list(parameters), {"long_name": "parameter of the medium"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of derivatives to it"}),
        "parameter_method": ("parameter", how, {"long_name": "where derivatives to it are from"}),
    }
