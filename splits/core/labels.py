"""Labels and units of other people's data: texts, numbers, times in UTC, and spellings of units.

Labels that are accepted here can be written to a netCDF file and are read from it unchanged.
Of units, only conversions that need no other quantity are known.  A unit is compared without
spaces, dots, ``^``, ``*`` and ``_``, with superscripts as digits, and without regard to capital
letters other than the M of mega: ``kg m-3``, ``kg.m-3``, ``Kg m^-3`` and ``kg m⁻³`` are the same.
"""

from __future__ import annotations

import calendar
import datetime
import re
import unicodedata
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import has_surrogates, invalid, join_names

TIME_EXAMPLE = "2024-01-31T10:00, or with a zone 2024-01-31T10:00+01:00"
_TIME_PATTERN = re.compile(r"\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2}.*)?")
_MONTH = "|".join(filter(None, [*calendar.month_name, *calendar.month_abbr]))
_DATE_PATTERN = re.compile(
    rf"((19|20)\d{{6}}|\d{{4}}[-./]\d{{1,2}}[-./]\d{{1,2}}|\d{{1,2}}[-./ ]\d{{1,2}}[-./ ]\d{{4}}"
    rf"|\d{{1,2}}[-. ]+({_MONTH})[-., ]+\d{{4}}|({_MONTH})[-. ]+\d{{1,2}}[, ]+\d{{4}})"
    r"([T ,]*\d{1,2}:?\d{2}.*)?",
    re.IGNORECASE,
)
"""Days with a year of four digits in any form, and the time of day that may follow them."""


def parse_time(text: str) -> pd.Timestamp | None:
    """Return the time of a text of ISO 8601 in UTC, or None for any other text.

    A date is its beginning, and a time without a zone is in UTC.  Digits without hyphens, such as
    20240131, are numbers.
    """
    if not _TIME_PATTERN.fullmatch(text):
        return None
    try:
        return as_utc(pd.DatetimeIndex([datetime.datetime.fromisoformat(text)]))[0]
    except ValueError:
        return None


def as_utc(times: pd.DatetimeIndex) -> pd.DatetimeIndex:
    """Return times in UTC without a zone, in nanoseconds, as files hold them.

    Times without a zone are in UTC.
    """
    naive = times if times.tz is None else times.tz_convert("UTC").tz_localize(None)
    return naive.as_unit("ns")


def convert_times(labels: pd.Index) -> pd.Index:
    """Return labels that are times of any zones, or their texts, as times in UTC.

    Texts are those of `parse_time`.  Other labels are unchanged.

    Raises
    ------
    ValueError
        For times that 64 bits of nanoseconds do not hold.
    """
    if isinstance(labels, pd.DatetimeIndex):
        return as_utc(labels)
    is_number = isinstance(labels.dtype, np.dtype) and labels.dtype.kind != "O"
    values = [] if is_number else labels.tolist()
    times = [parse_time(value) if isinstance(value, str) else value for value in values]
    if not times or not all(isinstance(time, datetime.date) for time in times):
        return labels
    times = [pd.to_datetime(time, utc=True) for time in times]
    return as_utc(pd.DatetimeIndex(times, name=labels.name))


def normalize_labels(key: str, labels: pd.Index) -> pd.Index:
    """Return labels that a netCDF file holds, of the same length.

    Parameters
    ----------
    key : str
        Key named in error messages.
    labels : pandas.Index
        Texts, numbers, durations or times, see `convert_times`.

    Raises
    ------
    ValueError
        For labels of another type, or of several types, and for texts of dates in another form.
    """
    if isinstance(labels, pd.MultiIndex):
        levels = [normalize_labels(key, labels.get_level_values(name)) for name in labels.names]
        return pd.MultiIndex.from_arrays(levels, names=labels.names)
    try:
        labels = convert_times(labels)
    except ValueError:
        allowed = f"times from {pd.Timestamp.min.year + 1} to {pd.Timestamp.max.year - 1}"
        raise invalid(key, str(min(labels)), allowed) from None
    if isinstance(labels, xr.CFTimeIndex):
        return labels
    values = labels.tolist()
    # Categories and nullable types of pandas hold values of another type.
    inferred = labels if isinstance(labels.dtype, np.dtype) else pd.Index(values, name=labels.name)
    if isinstance(inferred.dtype, np.dtype) and inferred.dtype.kind in "biufmM":
        return inferred
    for value in values:
        is_text = isinstance(value, str | bytes) and isinstance(value, type(values[0]))
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
        if not is_text or "\0" in text or has_surrogates(text):
            hint = "give times as datetimes, and other labels as texts"
            found = f"{text} of type {type(value).__name__}"
            raise invalid(key, found, "texts, numbers or times, all of one type", hint)
    texts = [value for value in values if isinstance(value, str)]
    if any(map(_DATE_PATTERN.fullmatch, texts)):
        wrong = next(text for text in texts if parse_time(text) is None)
        allowed = f"a time of ISO 8601, such as {TIME_EXAMPLE}"
        raise invalid(key, wrong, allowed, "all labels are times, or none is")
    return pd.Index(values, dtype=object, name=labels.name)


def normalize_attributes(attributes: dict[Any, Any]) -> dict[str, Any]:
    """Return the attributes that a netCDF file holds: texts and numbers."""
    kinds = str | int | float | np.number
    return {str(key): value for key, value in attributes.items() if isinstance(value, kinds)}


def check_direction(variable: xr.DataArray, allowed: str) -> None:
    """Check that a coordinate, by its attribute ``positive``, does not point the other way."""
    direction = str(variable.attrs.get("positive", allowed)).lower()
    if direction != allowed:
        raise invalid(f"{variable.name}.positive", direction, allowed, "reverse the coordinate")


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
