"""Group index of materials, from the dispersion of their refractive index."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.core.validation import InvalidValue, invalid

FIT_HALF_WIDTH = 0.08
"""Half width of the fit of the dispersion, in ln λ: tables have rounded values at steps of 2 to 4 %
and are interpolated linearly."""
N_FIT_POINTS = 33


class GroupIndex(NamedTuple):
    """Group index and its error.

    Attributes
    ----------
    value, stderr : float, shape (wavelengths, materials)
    """

    value: np.ndarray
    stderr: np.ndarray


def compute_group_index(
    compute_index: Callable[[np.ndarray], np.ndarray], wavelength_nm: np.ndarray
) -> GroupIndex:
    """Return the group index n − λ dn/dλ of materials.

    The dispersion is the slope of a parabola that is fitted to n over ln λ.  The error follows
    from the difference from the slope over half the range, and from the change of the slope there.

    Parameters
    ----------
    compute_index : callable
        Returns complex refractive indices, shape (wavelengths, materials), at wavelengths (nm).
    wavelength_nm : float, shape (wavelengths,)

    Raises
    ------
    ValueError
        If an index is not known within 8 % of a wavelength.
    """
    index = compute_index(wavelength_nm).real
    steps = np.linspace(-FIT_HALF_WIDTH, FIT_HALF_WIDTH, N_FIT_POINTS)
    inner = np.abs(steps) <= 0.5 * FIT_HALF_WIDTH * (1.0 + 1e-9)
    slopes, errors = [], []
    for wavelength in wavelength_nm:
        values = _evaluate_around(compute_index, wavelength, steps)
        wide, narrow, left, right = (
            np.polynomial.polynomial.polyfit(steps[part], values[part], degree)[1]
            for part, degree in (
                (steps == steps, 2), (inner, 2), (inner & (steps <= 0.0), 1),
                (inner & (steps >= 0.0), 1),
            )
        )  # fmt: skip
        slopes.append(wide)
        # The error of a slope is proportional to the square of the range; at a kink, slopes differ.
        errors.append(np.hypot(4.0 / 3.0 * (wide - narrow), 0.5 * (right - left)))
    return GroupIndex(index - np.array(slopes), np.array(errors))


def _evaluate_around(
    compute_index: Callable[[np.ndarray], np.ndarray], wavelength: float, steps: np.ndarray
) -> np.ndarray:
    """Return refractive indices at wavelengths around one (nm), by steps of ln λ."""
    try:
        return compute_index(wavelength * np.exp(steps)).real
    except InvalidValue as error:
        compute_index(np.array([wavelength]))
        known = str(error).partition("must be ")[2].partition(" (")[0]
        raise invalid(
            "wavelength_nm", float(wavelength),
            f"{100 * FIT_HALF_WIDTH:.0f} % inside the range of all refractive indices",
            f"their dispersion gives the group velocity; one of them is known {known}",
        ) from None  # fmt: skip
