"""Labels of other people's data: texts, numbers, and times in UTC.

What is accepted here can be written to a netCDF file and is read from it unchanged.
"""

from __future__ import annotations

import datetime
import re

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import invalid

ALLOWED = "texts, numbers or times, of one type"
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
        time = pd.Timestamp(datetime.datetime.fromisoformat(text)).as_unit("ns")
    except ValueError:
        return None
    return time if time.tzinfo is None else time.tz_convert("UTC").tz_localize(None)


def normalize_labels(key: str, labels: pd.Index) -> pd.Index:
    """Return labels that a netCDF file holds, of the same length.

    Parameters
    ----------
    key : str
        Key named in error messages.
    labels : pandas.Index
        Texts, numbers, durations or times.  Times with a zone are converted to UTC, and times
        without one are in UTC.

    Raises
    ------
    ValueError
        For labels of another type, or of several types.
    """
    if isinstance(labels, pd.MultiIndex) and None not in labels.names:
        levels = [normalize_labels(key, labels.get_level_values(name)) for name in labels.names]
        return pd.MultiIndex.from_arrays(levels, names=labels.names)
    if isinstance(labels, pd.DatetimeIndex):
        return as_utc(key, labels)
    has_calendar = isinstance(labels, xr.CFTimeIndex)
    if has_calendar or (isinstance(labels.dtype, np.dtype) and labels.dtype.kind in "biufm"):
        return labels
    values = labels.tolist()
    if isinstance(labels.dtype, pd.api.extensions.ExtensionDtype):
        # Categories and nullable types of pandas hold values of another type.
        inferred = pd.Index(values, name=labels.name)
        if isinstance(inferred.dtype, np.dtype) and inferred.dtype.kind in "biufm":
            return inferred
    if values and all(isinstance(value, datetime.date) for value in values):
        try:
            utc = pd.DatetimeIndex([pd.to_datetime(value, utc=True) for value in values])
        except ValueError:
            utc = None
        if utc is not None:
            return as_utc(key, utc.rename(labels.name))
    for kind in (str, bytes):
        if all(isinstance(value, kind) for value in values):
            if any(("\0" if kind is str else b"\0") in value for value in values):
                raise invalid(key, "a text with a NUL character", "texts without it")
            return pd.Index(values, dtype=object, name=labels.name)
    example = next((v for v in values if not isinstance(v, str)), None)
    hint = "give times as datetimes, other labels as texts"
    raise invalid(key, f"{example!r} of type {type(example).__name__}", ALLOWED, hint)


def as_utc(key: str, times: pd.DatetimeIndex) -> pd.DatetimeIndex:
    """Return times in UTC without a zone, in nanoseconds, which files of netCDF hold."""
    if times.tz is not None:
        times = times.tz_convert("UTC").tz_localize(None)
    try:
        return times.as_unit("ns")
    except ValueError:
        allowed = f"times from {pd.Timestamp.min.year + 1} to {pd.Timestamp.max.year - 1}"
        raise invalid(key, str(times.min()), allowed) from None


def check_direction(variable: xr.DataArray, allowed: str) -> None:
    """Check that a coordinate, by its attribute ``positive``, does not point the other way."""
    direction = str(variable.attrs.get("positive", allowed)).lower()
    if direction != allowed:
        raise invalid(f"{variable.name}.positive", direction, allowed, "reverse the coordinate")
