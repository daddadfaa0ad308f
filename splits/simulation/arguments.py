"""Checks of arguments that several instruments have in common."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from splits.core.arrays import as_1d_array, check_array_range, check_axis
from splits.core.validation import check_integer, check_range, invalid, suggest_name, suggest_number
from splits.simulation.threads import count_cpus

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
FULL_TURN_DEG = 360.0
HALF_WIDTH_RANGE_M = {"beam_spread": (1e-9, 1e6), "surface_map": (1e-9, 1e9), "lens": (1e-9, 1e6)}
"""Smallest and largest half edge (m) of the square that an instrument observes."""
MAX_DATASET_VALUES = 10_000_000
"""Largest number of values of a quantity over wavelength and direction: a run takes about thirty
times their memory."""


def check_wavelengths(
    wavelength_nm: Any, key: str = "wavelength_nm", *, is_sorted: bool = True
) -> np.ndarray:
    """Return wavelengths (nm) as an array, after checking their range.

    They must be strictly increasing unless `is_sorted` is false.
    """
    values = as_1d_array(key, wavelength_nm, "numbers in nanometres")
    if is_sorted:
        return check_axis(key, values, *WAVELENGTH_RANGE_NM, "nm")
    return check_array_range(key, values, *WAVELENGTH_RANGE_NM, "nm")


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", after checking it."""
    if isinstance(incidence_deg, str):
        if incidence_deg == "diffuse":
            return incidence_deg
        allowed = "an angle in degrees, or diffuse"
        hint = suggest_number(incidence_deg) or suggest_name(incidence_deg, ["diffuse"])
        raise invalid("incidence_deg", incidence_deg, allowed, hint)
    return check_single_angle(incidence_deg, "an angle in degrees, or diffuse")


def check_beam_angle(incidence_deg: Any) -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, after checking it."""
    if isinstance(incidence_deg, str):
        hint = suggest_number(incidence_deg) or "this instrument takes a beam"
        raise invalid("incidence_deg", incidence_deg, "an angle", hint)
    return check_single_angle(incidence_deg, "an angle in degrees")


def check_single_angle(incidence_deg: Any, allowed: str) -> float:
    """Return one angle of incidence in [0, 89.9999] degrees, after checking it."""
    if isinstance(incidence_deg, Iterable) and getattr(incidence_deg, "shape", None) != ():
        hint = "one call for each angle, or an experiment with a grid"
        raise invalid("incidence_deg", incidence_deg, allowed, hint)
    return check_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def check_half_width(instrument: str, half_width_m: Any) -> float:
    """Return half the edge of the square that an instrument observes (m), after checking it.

    Parameters
    ----------
    instrument : str
        Key of `HALF_WIDTH_RANGE_M`.
    half_width_m : number
    """
    return check_range("half_width_m", half_width_m, *HALF_WIDTH_RANGE_M[instrument], "m")


def check_dataset_size(n_wavelengths: int, n_directions: int) -> None:
    """Check that the result of a goniophotometer fits into memory."""
    if n_wavelengths * n_directions > MAX_DATASET_VALUES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths",
            f"at most {MAX_DATASET_VALUES // n_directions}",
            f"{n_directions} directions each; {MAX_DATASET_VALUES} values fit into memory",
        )  # fmt: skip


def check_threads(threads: Any) -> int:
    """Return a number of threads; None gives every CPU that this process may use."""
    if threads is None:
        return count_cpus()
    return check_integer("threads", threads, 1)


def check_direction_angles(key: str, values: Any, upper_deg: float) -> np.ndarray:
    """Return increasing angles from 0 to below `upper_deg` degrees, after checking them.

    Azimuths are from 0 to below 360 degrees everywhere.
    """
    angles = as_1d_array(key, values, "numbers in degrees")
    outside = angles[(angles < 0.0) | (angles >= upper_deg)]
    is_azimuth = upper_deg == FULL_TURN_DEG
    hint = f"write {outside[0] % FULL_TURN_DEG:g}" if is_azimuth and outside.size else ""
    return check_axis(key, angles, 0.0, upper_deg, "degrees", open_high=True, hint=hint)


def check_n_bins(n_bins: Any) -> tuple[int, int]:
    """Return the numbers of bins in polar and azimuth angle, after checking them (1 to 1000)."""
    try:
        polar, azimuth = (check_integer("n_bins", n, 1, 1000) for n in n_bins)
    except (TypeError, ValueError):
        raise invalid("n_bins", n_bins, "two whole numbers from 1 to 1000") from None
    return polar, azimuth
