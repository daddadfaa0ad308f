"""Group index of materials, from the dispersion of their refractive index.

Tables of water are too coarse for its dispersion in the visible.  There, that of the formulation of
IAPWS is used (IAPWS R9-97, Release on the Refractive Index of Ordinary Water Substance as a
Function of Wavelength, Temperature and Pressure, 1997; Harvey, Gallagher & Levelt Sengers 1998, J.
Phys. Chem. Ref. Data 27, 761).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.core.validation import InvalidValue, invalid

FIT_HALF_WIDTH = 0.08
"""Half width of the fit of the dispersion, in ln λ: tables have rounded values at steps of 2 to 4 %
and are interpolated linearly."""
N_FIT_POINTS = 33

WATER_RANGE_NM = (200.0, 1100.0)
"""Range of wavelengths of the formulation of IAPWS."""
COLD_WATER, WARM_WATER = (273.15, 999.84), (293.15, 998.21)
"""Temperature (K) and density (kg/m³) of water at 0 and 20 °C and atmospheric pressure."""
_IAPWS = (
    0.244257733, 9.74634476e-3, -3.73234996e-3, 2.68678472e-4, 1.58920570e-3, 2.45934259e-3,
    0.900704920, -1.66626219e-2,
)  # fmt: skip
_ULTRAVIOLET, _INFRARED = 0.2292020, 5.432937
_WATER_ERROR = (
    (200.0, 210.0, 230.0, 250.0, 300.0, 400.0, 800.0, 1000.0, 1100.0),
    (1e-2, 2e-3, 1e-3, 1e-3, 4e-4, 1e-4, 1e-4, 3e-4, 5e-4),
)
"""Wavelengths (nm) and largest difference there from the group index by Daimon & Masumura (2007,
Applied Optics 46, 3811, at 19 and 21.5 °C)."""


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


def compute_water_group_index(wavelength_nm: np.ndarray, at_melting_point: bool) -> GroupIndex:
    """Return the group index of liquid water by IAPWS R9-97.

    Parameters
    ----------
    wavelength_nm : float, shape (wavelengths,)
        Vacuum wavelengths in `WATER_RANGE_NM`.
    at_melting_point : bool
        Whether the water has 0 °C.  Otherwise its temperature is unknown: the value is the mean of
        those at 0 and at 20 °C, and the error includes half of their difference.

    Returns
    -------
    GroupIndex
        Of shape (wavelengths,).
    """
    cold, warm = (_compute_iapws(wavelength_nm, *state) for state in (COLD_WATER, WARM_WATER))
    error = np.interp(wavelength_nm, *_WATER_ERROR)
    if at_melting_point:
        return GroupIndex(cold, error)
    return GroupIndex(0.5 * (cold + warm), np.hypot(error, 0.5 * (warm - cold)))


def compute_temperature_effect(wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the difference between the group indices of water at 0 and at 20 °C."""
    cold, warm = (_compute_iapws(wavelength_nm, *state) for state in (COLD_WATER, WARM_WATER))
    return np.abs(cold - warm)


def _compute_iapws(wavelength_nm: np.ndarray, temperature_k: float, density: float) -> np.ndarray:
    """Return the group index at a temperature (K) and a density (kg/m³); Eq. 1 of the release."""
    a0, a1, a2, a3, a4, a5, a6, a7 = _IAPWS
    x, t, d = np.asarray(wavelength_nm) / 589.0, temperature_k / 273.15, density / 1000.0
    below, above = x**2 - _ULTRAVIOLET**2, x**2 - _INFRARED**2
    # (n² − 1)/(n² + 2), and its derivative times x.
    lorentz = d * (
        a0 + a1 * d + a2 * t + a3 * x**2 * t + a4 / x**2 + a5 / below + a6 / above + a7 * d**2
    )
    slope = 2.0 * d * (a3 * x**2 * t - a4 / x**2 - a5 * x**2 / below**2 - a6 * x**2 / above**2)
    index = np.sqrt((1.0 + 2.0 * lorentz) / (1.0 - lorentz))
    group: np.ndarray = index - 1.5 * slope / (index * (1.0 - lorentz) ** 2)
    return group


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
