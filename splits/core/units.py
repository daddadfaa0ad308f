"""Units of input data: recognized spellings, and conversion to the unit of a variable.

Only conversions that need no other quantity are known.  A unit is compared without spaces, dots,
``^``, ``*`` and ``_``, with superscripts as digits, and without regard to capital letters other
than the M of mega: ``kg m-3``, ``kg.m-3``, ``Kg m^-3`` and ``kg m⁻³`` are the same.
"""

from __future__ import annotations

import re
import unicodedata
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid, join_names

ZERO_CELSIUS_K = 273.15


class Conversion(NamedTuple):
    """Linear conversion, ``factor * value + offset``."""

    factor: float
    offset: float = 0.0


def _list_spellings(*groups: tuple[str, float]) -> dict[str, Conversion]:
    """Return conversions by spelling, from texts of spellings separated by `` | ``."""
    return {
        spelling: Conversion(factor)
        for spellings, factor in groups
        for spelling in spellings.split(" | ")
    }


CONVERSIONS: dict[str, dict[str, Conversion]] = {
    "m": _list_spellings(
        ("m | metre | meter | metres | meters", 1.0), ("cm | centimetre | centimeter", 1e-2),
        ("mm | millimetre | millimeter", 1e-3), ("in | inch | inches", 0.0254),
        ("ft | foot | feet", 0.3048),
    ),
    "um": _list_spellings(
        ("um | micrometre | micrometer | micron", 1.0), ("mm | millimetre | millimeter", 1e3),
        ("m | metre | meter", 1e6),
    ),
    "kg m-3": _list_spellings(("kg m-3 | kg/m3", 1.0), ("g cm-3 | g/cm3", 1e3)),
    "m2 kg-1": _list_spellings(("m2 kg-1 | m2/kg", 1.0), ("cm2 g-1 | cm2/g", 0.1)),
    "degC": _list_spellings(
        ("degC | °C | degrees Celsius | degree Celsius | Celsius | celsius", 1.0)
    ) | {name: Conversion(1.0, -ZERO_CELSIUS_K) for name in ("K", "kelvin", "Kelvin")},
    "1": _list_spellings(
        ("1 | dimensionless | unitless | m3 m-3 | m3/m3", 1.0),
        ("% | percent | % by Vol | vol% | %vol", 1e-2)
    ),
    "1e-9": _list_spellings(
        ("1e-9 | ng g-1 | ng/g | ug kg-1 | ug/kg", 1.0), ("ug g-1 | ug/g | mg kg-1 | mg/kg", 1e3),
        ("g g-1 | g/g | kg kg-1 | kg/kg", 1e9),
    ),
    "ml-1": _list_spellings(
        ("ml-1 | mL-1 | 1/ml | 1/mL | cells/ml | cells/mL | cells ml-1 | cells mL-1 | cm-3", 1.0),
        ("l-1 | L-1 | 1/l | 1/L", 1e-3), ("m-3", 1e-6),
    ),
    "degree": _list_spellings(
        ("degree | degrees | deg | °", 1.0), ("rad | radian | radians", 180.0 / np.pi)
    ),
}  # fmt: skip
"""Conversions to each unit of the package, by spelling of the unit of the data."""


NANOMETRES = ("nm", "nanometre", "nanometres", "nanometer", "nanometers")


def normalize_unit(unit: object) -> str:
    """Return the spelling of a unit in which spellings are compared."""
    text = unicodedata.normalize("NFKC", str(unit)).replace("μ", "u").replace("−", "-")
    text = re.sub(r"[\s.^*_·⋅]", "", text)
    return text if re.search("M([gm]|$)", text) else text.lower()


_NORMALIZED = {
    target: {normalize_unit(spelling): conversion for spelling, conversion in known.items()}
    for target, known in CONVERSIONS.items()
}


def is_unit(unit: object, target: str) -> bool:
    """Return whether a unit can be converted to a key of `CONVERSIONS`."""
    return normalize_unit(unit) in _NORMALIZED[target]


def check_nanometres(key: str, wavelength: Any) -> None:
    """Check that a coordinate of wavelengths states no other unit than nm in its attributes."""
    unit = getattr(wavelength, "attrs", {}).get("units")
    if unit is not None and normalize_unit(unit).lower() not in NANOMETRES:
        raise invalid(f"{key}.wavelength.units", unit, "nm", "convert the values, or correct units")


def convert_units(key: str, values: np.ndarray, unit: Any, target: str) -> np.ndarray:
    """Return numbers in the unit of a variable.

    Parameters
    ----------
    key : str
        Variable named in error messages.
    values : float, any shape
    unit : str or None
        Unit of the numbers; they are unchanged for None and for an empty text.
    target : str
        Key of `CONVERSIONS`.

    Raises
    ------
    ValueError
        For a unit that is unknown or belongs to another quantity.
    """
    if unit is None or not str(unit).strip():
        return values
    conversion = _NORMALIZED[target].get(normalize_unit(unit))
    if conversion is None:
        hint = "convert the values, or correct the attribute units"
        raise invalid(f"{key}.units", unit, f"one of {join_names(CONVERSIONS[target])}", hint)
    return conversion.factor * values + conversion.offset if conversion != (1.0, 0.0) else values
