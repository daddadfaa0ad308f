"""Labels of other people's data: texts, numbers, and times in UTC.

What is accepted here can be written to a netCDF file and is read from it unchanged.
"""

from __future__ import annotations

import datetime
import re
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import has_surrogates, invalid

TIME_EXAMPLE = "2024-01-31T10:00, or with a zone 2024-01-31T10:00+01:00"
_TIME_PATTERN = re.compile(r"\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2}.*)?")


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
    """Return labels that are times of any zones as times in UTC, and other labels unchanged.

    Raises
    ------
    ValueError
        For times that 64 bits of nanoseconds do not hold.
    """
    if isinstance(labels, pd.DatetimeIndex):
        return as_utc(labels)
    values = labels.tolist() if labels.dtype == object else []
    if not values or not all(isinstance(value, datetime.date) for value in values):
        return labels
    times = [pd.to_datetime(value, utc=True) for value in values]
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
        For labels of another type, or of several types.
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
