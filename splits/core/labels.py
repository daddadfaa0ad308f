"""Labels of other people's data: texts, numbers, and times in UTC.

What is accepted here can be written to a netCDF file and is read from it unchanged.
"""

from __future__ import annotations

import calendar
import datetime
import re
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import has_surrogates, invalid

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
