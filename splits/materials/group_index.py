"""Group index of materials, from the dispersion of their refractive index."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

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
    from the difference from the slope over half the range.

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
    wide, narrow = (
        _fit_slopes(compute_index, wavelength_nm, half_width)
        for half_width in (FIT_HALF_WIDTH, 0.5 * FIT_HALF_WIDTH)
    )
    # The error of a slope is proportional to the square of the range.
    return GroupIndex(index - wide, 4.0 / 3.0 * np.abs(wide - narrow))


def _fit_slopes(
    compute_index: Callable[[np.ndarray], np.ndarray], wavelength_nm: np.ndarray, half_width: float
) -> np.ndarray:
    """Return dn/d(ln λ), shape (wavelengths, materials)."""
    steps = np.linspace(-half_width, half_width, N_FIT_POINTS)
    slopes = [
        np.polynomial.polynomial.polyfit(steps, compute_index(one * np.exp(steps)).real, 2)[1]
        for one in wavelength_nm
    ]
    return np.array(slopes)
