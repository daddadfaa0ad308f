"""What several instruments ask alike, checked alike."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from numbers import Integral
from typing import Any

import numpy as np

from splits.arrays import check_each, increasing, row_of
from splits.checks import NO_NUMBERS, in_range, refuse, scalar, snap_to_ends, suggestion
from splits.instruments.threads import cpus
from splits.media.granular import GranularMedium, LayeredMedium, check_room
from splits.media.turbid import SurfaceMedium, TurbidMedium

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
HALF_WIDTH_M = {"bssrdf": (1e-9, 1e6), "surface": (1e-9, 1e9), "lens": (1e-9, 1e6)}
"""Half the edge of the square that an instrument looks at: shortest, longest."""
MOST_WHOLE = 2**63 - 1
MOST_VALUES = 10_000_000
"""Largest number of values of a quantity by wavelength and direction: a run takes some thirty
times their memory."""
MEDIA: dict[type, tuple[str, ...]] = {
    GranularMedium: ("Snow", "Sand"),
    LayeredMedium: ("Stack",),
    TurbidMedium: ("Layer",),
    SurfaceMedium: ("Layer",),
}
"""Names of the media that are what an instrument asks for."""


def check_medium(medium: Any, *kinds: type, allow_semi_infinite: bool = False) -> None:
    """Refuse what is no medium of these kinds, by default of any.

    Parameters
    ----------
    medium : object
    *kinds : type
        Keys of `MEDIA`.
    endless : bool
        Whether packs without end are taken.
    """
    kinds = kinds or (GranularMedium, LayeredMedium, TurbidMedium)
    is_class = isinstance(medium, type)
    if isinstance(medium, kinds) and not is_class:
        if isinstance(medium, GranularMedium | LayeredMedium):
            check_room(medium)
            if math.isinf(medium.depth_m) and not allow_semi_infinite:
                hint = "give depth_m; spectra, albedos and profiles take packs without end"
                raise refuse("depth_m", math.inf, "finite", hint)
        return
    names = [name for kind in kinds for name in MEDIA[kind]]
    given = medium if is_class else getattr(medium, "kind", medium)
    near = suggestion(medium.__name__ if is_class else str(given).capitalize(), names)
    hint = re.sub(r"mean (\w+)", r"mean splits.\1()", near)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise refuse("medium", given, allowed, hint)


def check_wavelengths(wavelength_nm: Any) -> np.ndarray:
    """Return wavelengths (nm) as a strictly increasing array, or refuse them."""
    values = row_of("wavelength_nm", wavelength_nm, "numbers in nanometres")
    low, high = WAVELENGTH_RANGE_NM
    values = snap_to_ends(values, low, high)
    outside = values[(values < low) | (values > high)]
    if outside.size:
        first = float(outside[0])
        micrometres = low <= 1e3 * first <= high and first < low
        hint = f"in micrometres? write {1e3 * first:g}" if micrometres else ""
        in_range("wavelength_nm", first, low, high, "nm", hint=hint)
    return increasing("wavelength_nm", values)


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", or refuse it."""
    if isinstance(incidence_deg, str):
        if incidence_deg == "diffuse":
            return incidence_deg
        allowed = "an angle in degrees, or diffuse"
        raise refuse("incidence_deg", incidence_deg, allowed, _meant(incidence_deg))
    return check_angle(incidence_deg, "an angle in degrees, or diffuse")


def check_beam(incidence_deg: Any) -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, or refuse it."""
    if isinstance(incidence_deg, str):
        hint = "not for this instrument"
        hint = hint if incidence_deg == "diffuse" else _meant(incidence_deg)
        raise refuse("incidence_deg", incidence_deg, "an angle", hint)
    return check_angle(incidence_deg, "an angle in degrees")


def check_angle(incidence_deg: Any, allowed: str) -> float:
    """Return one angle of incidence in [0, 89.9999] degrees, or refuse it."""
    if isinstance(incidence_deg, Iterable) and getattr(incidence_deg, "shape", None) != ():
        hint = "one call for each angle, or an experiment with a grid"
        raise refuse("incidence_deg", incidence_deg, allowed, hint)
    return in_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def _meant(given: str) -> str:
    """Return what was meant by text in place of an angle, if that can be told."""
    try:
        return f"write {float(given):g}, without quotes"
    except ValueError:
        return suggestion(given, ["diffuse"])


def check_whole(key: str, value: object, low: int, high: int = MOST_WHOLE) -> int:
    """Return a whole number from `low` to `high`, by default what fits into 63 bits, or refuse."""
    value = scalar(value)
    if not isinstance(value, Integral) or isinstance(value, NO_NUMBERS):
        hint = f"write {int(value)}" if isinstance(value, float) and value.is_integer() else ""
        raise refuse(key, value, f"a whole number of at least {low}", hint)
    whole = int(value)
    if not low <= whole <= high:
        least = whole < low and high == MOST_WHOLE
        allowed = f"of at least {low}" if least else f"from {low} to {high}"
        raise refuse(key, value, f"a whole number {allowed}")
    return whole


def check_half_width(instrument: str, half_width_m: Any) -> float:
    """Return half the edge of what an instrument looks at (m), or refuse it.

    Parameters
    ----------
    kind : str
        Key of `HALF_WIDTH_M`.
    half_width_m : number
    """
    return in_range("half_width_m", half_width_m, *HALF_WIDTH_M[instrument], "m")


def check_size(n_wavelengths: int, n_directions: int) -> None:
    """Refuse a goniophotometer's result that would not fit into memory."""
    if n_wavelengths * n_directions > MOST_VALUES:
        raise refuse(
            "wavelength_nm", f"{n_wavelengths} wavelengths", f"at most {MOST_VALUES // n_directions}",
            f"{n_directions} directions each; {MOST_VALUES} values fit into memory",
        )  # fmt: skip


def check_threads(threads: Any) -> int:
    """Return a number of threads, every CPU this process may use for None, or refuse it."""
    if threads is None:
        return cpus()
    return check_whole("threads", threads, 1)


def check_angles(key: str, values: Any, upper_deg: float) -> np.ndarray:
    """Return increasing angles from 0 to below `end` degrees, or refuse them."""
    angles = row_of(key, values, "numbers in degrees")
    return increasing(key, check_each(key, angles, 0.0, upper_deg, "degrees", open_high=True))


def check_cells(n_bins: Any) -> tuple[int, int]:
    """Return numbers of cells in polar and azimuth angle, 1 to 1000 each, or refuse them."""
    try:
        polar, azimuth = (check_whole("cells", n, 1, 1000) for n in n_bins)
    except (TypeError, ValueError):
        raise refuse("cells", n_bins, "two whole numbers from 1 to 1000") from None
    return polar, azimuth
