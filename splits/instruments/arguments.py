"""What several instruments ask alike, checked alike."""

from __future__ import annotations

import re
from numbers import Integral
from typing import Any

import numpy as np

from splits.checks import in_range, refuse, suggestion
from splits.instruments.threads import cpus
from splits.media.granular import GranularMedium
from splits.media.turbid import SurfaceMedium, TurbidMedium

WAVELENGTH_RANGE_NM = (200.0, 100_000.0)
MEDIA: dict[type, tuple[str, ...]] = {
    GranularMedium: ("Snow", "Sand"),
    TurbidMedium: ("Layer",),
    SurfaceMedium: ("Layer",),
}
"""Names of the media that are what an instrument asks for."""


def check_medium(medium: Any, *kinds: type) -> None:
    """Refuse what is no medium of these kinds, by default of any.

    Parameters
    ----------
    medium : object
    *kinds : type
        Keys of `MEDIA`.
    """
    kinds = kinds or (GranularMedium, TurbidMedium)
    is_class = isinstance(medium, type)
    if isinstance(medium, kinds) and not is_class:
        return
    names = [name for kind in kinds for name in MEDIA[kind]]
    given = medium if is_class else getattr(medium, "kind", medium)
    near = suggestion(medium.__name__ if is_class else str(given).capitalize(), names)
    hint = re.sub(r"mean (\w+)", r"mean splits.\1()", near)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise refuse("medium", given, allowed, hint)


def check_wavelengths(wavelength_nm: Any) -> np.ndarray:
    """Return wavelengths (nm) as a strictly increasing array, or refuse them."""
    try:
        values = np.atleast_1d(np.asarray(list(np.atleast_1d(wavelength_nm)), dtype=float))
    except (TypeError, ValueError):
        raise refuse("wavelength_nm", wavelength_nm, "numbers in nanometres") from None
    low, high = WAVELENGTH_RANGE_NM
    if values.size == 0:
        raise refuse("wavelength_nm", [], "at least one wavelength in nanometres")
    if values.ndim > 1:
        raise refuse("wavelength_nm", values.tolist(), "one row of numbers in nanometres")
    for value in values:
        in_range("wavelength_nm", float(value), low, high, "nm")
    if not (np.diff(values) > 0).all():
        raise refuse("wavelength_nm", values.tolist(), "strictly increasing")
    return values


def check_incidence(incidence_deg: Any) -> float | str:
    """Return the angle of incidence in [0, 89.9999] degrees, or "diffuse", or refuse it."""
    if isinstance(incidence_deg, str):
        if incidence_deg == "diffuse":
            return incidence_deg
        allowed = "an angle in degrees, or diffuse"
        raise refuse(
            "incidence_deg", incidence_deg, allowed, suggestion(incidence_deg, ["diffuse"])
        )
    return in_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def check_beam(incidence_deg: Any) -> float:
    """Return the polar angle of a beam in [0, 89.9999] degrees, or refuse it."""
    if incidence_deg == "diffuse":
        hint = "diffuse light is for the spectrophotometer"
        raise refuse("incidence_deg", incidence_deg, "an angle", hint)
    return in_range("incidence_deg", incidence_deg, 0.0, 89.9999, "degrees")


def check_whole(key: str, value: object, low: int) -> int:
    """Return a whole number of at least `low` that fits into 63 bits, or refuse it."""
    whole = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else -1
    if not low <= whole < 2**63:
        hint = f"write {int(value)}" if isinstance(value, float) and value.is_integer() else ""
        raise refuse(key, value, f"a whole number of at least {low}", hint)
    return whole


def check_threads(threads: Any) -> int:
    """Return a number of threads, every CPU this process may use for None, or refuse it."""
    if threads is None:
        return cpus()
    return check_whole("threads", threads, 1)
