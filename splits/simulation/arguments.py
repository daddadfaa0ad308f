"""What several instruments ask alike, checked alike."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from numbers import Integral
from typing import Any

import numpy as np

from splits.core.arrays import as_1d_array, check_array_range, check_increasing
from splits.core.validation import (
    NON_NUMERIC_TYPES,
    as_scalar,
    check_range,
    invalid,
    snap_to_limits,
    suggest_name,
)
from splits.media.medium import (
    GranularMedium,
    LayeredMedium,
    ParticleMedium,
    SurfaceMedium,
    check_thickness,
)
from splits.simulation.threads import count_cpus

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
HALF_WIDTH_RANGE_M = {"beam_spread": (1e-9, 1e6), "surface_map": (1e-9, 1e9), "lens": (1e-9, 1e6)}
"""Half the edge of the square that an instrument looks at: shortest, longest."""
MAX_INT64 = 2**63 - 1
MAX_DATASET_VALUES = 10_000_000
"""Largest number of values of a quantity by wavelength and direction: a run takes some thirty
times their memory."""
MEDIUM_NAMES: dict[type, tuple[str, ...]] = {
    GranularMedium: ("Snow", "Sand"),
    LayeredMedium: ("Stack",),
    ParticleMedium: ("Layer",),
    SurfaceMedium: ("Layer",),
}
"""Names of the media that are what an instrument asks for."""


def check_medium(medium: Any, *kinds: type, allow_semi_infinite: bool = False) -> None:
    """Refuse what is no medium of these kinds, by default of any.

    Parameters
    ----------
    medium : object
    *kinds : type
        Keys of `MEDIUM_NAMES`.
    allow_semi_infinite : bool
        Whether packs without end are taken.
    """
    kinds = kinds or (GranularMedium, LayeredMedium, ParticleMedium)
    is_class = isinstance(medium, type)
    if isinstance(medium, kinds) and not is_class:
        if isinstance(medium, GranularMedium | LayeredMedium):
            check_thickness(medium)
            if math.isinf(medium.depth_m) and not allow_semi_infinite:
                hint = "give depth_m; spectra, albedos and profiles take packs without end"
                raise invalid("depth_m", math.inf, "finite", hint)
        return
    names = [name for kind in kinds for name in MEDIUM_NAMES[kind]]
    given = medium if is_class else getattr(medium, "kind", medium)
    near = suggest_name(medium.__name__ if is_class else str(given).capitalize(), names)
    hint = re.sub(r"mean (\w+)", r"mean splits.\1()", near)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise invalid("medium", given, allowed, hint)


def check_wavelengths(wavelength_nm: Any) -> np.ndarray:
    """Return wavelengths (nm) as a strictly increasing array, or refuse them."""
    values = as_1d_array("wavelength_nm", wavelength_nm, "numbers in nanometres")
    low, high = WAVELENGTH_RANGE_NM
    values = snap_to_limits(values, low, high)
    outside = values[(values < low) | (values > high)]
    if outside.size:
        first = float(outside[0])
        micrometres = low <= 1e3 * first <= high and first < low
        hint = f"in micrometres? write {1e3 * first:g}" if micrometres else ""
        check_range("wavelength_nm", first, low, high, "nm", hint=hint)
    return check_increasing("wavelength_nm", values)


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", or refuse it."""
    if isinstance(incidence_deg, str):
        if incidence_deg == "diffuse":
            return incidence_deg
        allowed = "an angle in degrees, or diffuse"
        raise invalid("incidence_deg", incidence_deg, allowed, _suggest_incidence(incidence_deg))
    return check_single_angle(incidence_deg, "an angle in degrees, or diffuse")


def check_beam_angle(incidence_deg: Any) -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, or refuse it."""
    if isinstance(incidence_deg, str):
        hint = "not for this instrument"
        hint = hint if incidence_deg == "diffuse" else _suggest_incidence(incidence_deg)
        raise invalid("incidence_deg", incidence_deg, "an angle", hint)
    return check_single_angle(incidence_deg, "an angle in degrees")


def check_single_angle(incidence_deg: Any, allowed: str) -> float:
    """Return one angle of incidence in [0, 89.9999] degrees, or refuse it."""
    if isinstance(incidence_deg, Iterable) and getattr(incidence_deg, "shape", None) != ():
        hint = "one call for each angle, or an experiment with a grid"
        raise invalid("incidence_deg", incidence_deg, allowed, hint)
    return check_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def _suggest_incidence(given: str) -> str:
    """Return what was meant by text in place of an angle, if that can be told."""
    try:
        return f"write {float(given):g}, without quotes"
    except ValueError:
        return suggest_name(given, ["diffuse"])


def check_integer(key: str, value: object, low: int, high: int = MAX_INT64) -> int:
    """Return a whole number from `low` to `high`, by default what fits into 63 bits, or refuse."""
    value = as_scalar(value)
    if not isinstance(value, Integral) or isinstance(value, NON_NUMERIC_TYPES):
        hint = f"write {int(value)}" if isinstance(value, float) and value.is_integer() else ""
        raise invalid(key, value, f"a whole number of at least {low}", hint)
    whole = int(value)
    if not low <= whole <= high:
        least = whole < low and high == MAX_INT64
        allowed = f"of at least {low}" if least else f"from {low} to {high}"
        raise invalid(key, value, f"a whole number {allowed}")
    return whole


def check_half_width(instrument: str, half_width_m: Any) -> float:
    """Return half the edge of what an instrument looks at (m), or refuse it.

    Parameters
    ----------
    instrument : str
        Key of `HALF_WIDTH_RANGE_M`.
    half_width_m : number
    """
    return check_range("half_width_m", half_width_m, *HALF_WIDTH_RANGE_M[instrument], "m")


def check_dataset_size(n_wavelengths: int, n_directions: int) -> None:
    """Refuse a goniophotometer's result that would not fit into memory."""
    if n_wavelengths * n_directions > MAX_DATASET_VALUES:
        raise invalid(
            "wavelength_nm", f"{n_wavelengths} wavelengths", f"at most {MAX_DATASET_VALUES // n_directions}",
            f"{n_directions} directions each; {MAX_DATASET_VALUES} values fit into memory",
        )  # fmt: skip


def check_threads(threads: Any) -> int:
    """Return a number of threads, every CPU this process may use for None, or refuse it."""
    if threads is None:
        return count_cpus()
    return check_integer("threads", threads, 1)


def check_direction_angles(key: str, values: Any, upper_deg: float) -> np.ndarray:
    """Return increasing angles from 0 to below `upper_deg` degrees, or refuse them."""
    angles = as_1d_array(key, values, "numbers in degrees")
    return check_increasing(
        key, check_array_range(key, angles, 0.0, upper_deg, "degrees", open_high=True)
    )


def check_n_bins(n_bins: Any) -> tuple[int, int]:
    """Return numbers of cells in polar and azimuth angle, 1 to 1000 each, or refuse them."""
    try:
        polar, azimuth = (check_integer("n_bins", n, 1, 1000) for n in n_bins)
    except (TypeError, ValueError):
        raise invalid("n_bins", n_bins, "two whole numbers from 1 to 1000") from None
    return polar, azimuth
