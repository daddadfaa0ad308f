"""One way to read arrays of numbers that a user gives.

Every such array passes through `as_float_array`, alone or within the functions below it.  Masked
members, NaN and the missing values of pandas are one kind, gaps.  Where values have labels of their
own (pandas, xarray), the labels decide what belongs to what, and not the places.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_number,
    check_range,
    invalid,
    short_repr,
    snap_to_limits,
)

MAX_NUMBERS = 20_000
"""A row of numbers, such as wavelengths, is so long at most."""
TEXT_HINT = "this is text, not a number"
UNLABELLED_HINT = "values are matched by their labels; .to_numpy() has none"


def as_float_array(
    key: str, values: Any, allowed: str = "numbers", *, allow_gaps: bool = False
) -> np.ndarray:
    """Return numbers of any shape as a new array of doubles, or refuse them.

    Parameters
    ----------
    key : str
        Name the user knows them by.
    values : array_like
        Numbers of any type, order of bytes and access; no truth values, dates or texts.
    allowed : str
        What they must be, such as "numbers in nanometres".
    allow_gaps : bool
        Whether gaps are returned as NaN, and infinite numbers as they are; else both are refused.
    """
    found = _convert(key, values, allowed)
    wrong = np.flatnonzero(~np.isfinite(found)) if not allow_gaps else np.empty(0)
    if wrong.size:
        value = found.flat[wrong[0]]
        where = f"number {wrong[0] + 1} of {found.size} is " if found.ndim else ""
        hint = f"{where}masked, NaN or missing" if np.isnan(value) else ""
        raise invalid(key, float(value), allowed, hint)
    return found


def _convert(key: str, values: Any, allowed: str) -> np.ndarray:
    """Return numbers as a new array of doubles with NaN for gaps, or refuse them."""
    if isinstance(values, (str, bytes)):
        raise invalid(key, values, allowed, TEXT_HINT)
    if isinstance(values, Set):
        raise invalid(key, values, allowed, "a set has no order")
    if isinstance(values, Mapping):
        raise invalid(key, values, allowed)
    if hasattr(values, "__array__"):
        return _convert_array(key, values, allowed)
    if not isinstance(values, Iterable):
        if values is pd.NA:
            return np.array(np.nan)
        # Numbers that are not finite are judged later.
        return np.array(values if isinstance(values, float) else check_number(key, values, allowed))
    members = list(itertools.islice(values, MAX_NUMBERS + 1))
    if len(members) > MAX_NUMBERS:
        raise invalid(key, f"more than {MAX_NUMBERS} numbers", f"at most {MAX_NUMBERS} numbers")
    rows = [_convert(key, member, allowed) for member in members]
    if len({row.shape for row in rows}) > 1:
        raise invalid(key, members, allowed, "rows differ in length")
    return np.array(rows, dtype=float)


def _convert_array(key: str, values: Any, allowed: str) -> np.ndarray:
    """Return the numbers of an array of whatever library, see `_convert`."""
    dense = values if isinstance(values, np.ndarray) else np.asarray(values)
    data, kind = np.ma.getdata(dense), dense.dtype.kind
    if kind in "fiu":
        found = np.array(data, dtype=float)
    elif kind == "O":
        missing = np.asarray(pd.isna(data))
        found = np.full(data.shape, np.nan)
        found[~missing] = [check_number(key, one, allowed) for one in data[~missing]]
    else:
        told = data.ravel()[0] if kind in "bUS" and data.size else f"of type {dense.dtype}"
        raise invalid(key, told, allowed, TEXT_HINT if kind in "US" else "")
    if isinstance(dense, np.ma.MaskedArray):
        found[np.ma.getmaskarray(dense)] = np.nan
    return found


def as_1d_array(key: str, values: Any, allowed: str = "numbers") -> np.ndarray:
    """Return one number or a row of numbers as an array of doubles, or refuse them.

    Parameters
    ----------
    key : str
    values : array_like
        At least one, and `MAX_NUMBERS` at most; each is finite.
    allowed : str
        What they must be, such as "numbers in nanometres".
    """
    found = as_float_array(key, values, allowed)
    if found.ndim > 1:
        raise invalid(key, np.asarray(values).tolist(), f"one row of {allowed}")
    if not found.size:
        raise invalid(key, [], f"{allowed}, at least one")
    if found.size > MAX_NUMBERS:
        raise invalid(key, f"{found.size} numbers", f"at most {MAX_NUMBERS} numbers")
    return np.atleast_1d(found)


def read_columns(key: str, columns: Mapping[str, Any]) -> list[np.ndarray]:
    """Return the columns of a table, each a row of numbers, in the order of the first.

    Parameters
    ----------
    key : str
        Name the user knows the table by.
    columns : mapping
        Rows of numbers by name; labels of the others are values or labels of the first.
    """
    first, *others = columns
    column = as_1d_array(f"{key}.{first}", columns[first])
    own = find_labels(columns[first])
    rows = [
        as_1d_array(f"{key}.{name}", align_to_labels(f"{key}.{name}", columns[name], column, own))
        for name in others
    ]
    return [column, *rows]


def check_increasing(key: str, values: np.ndarray) -> np.ndarray:
    """Return numbers that rise strictly, or refuse the first two that do not."""
    falls = np.flatnonzero(np.diff(values) <= 0.0)
    if falls.size:
        pair = values[falls[0] : falls[0] + 2].tolist()
        where = f"numbers {falls[0] + 1} and {falls[0] + 2} of {values.size}"
        raise invalid(key, pair, "strictly increasing", where)
    return values


def check_array_range(
    key: str, values: np.ndarray, low: float, high: float, unit: str = "", **how: Any
) -> np.ndarray:
    """Return numbers that all are in a range, see `splits.core.validation.check_range`, or refuse the first."""
    found = snap_to_limits(values, low, high)
    open_low, open_high = how.get("open_low", False), how.get("open_high", False)
    outside = (found < low) | (found > high) | (open_low & (found == low))
    outside |= open_high & (found == high)
    if outside.any():
        check_range(key, found[outside][0], low, high, unit, **how)
    return found


def check_no_gaps(key: str, data: xr.Dataset | xr.DataArray) -> None:
    """Refuse a dataset with a gap in what it holds."""
    variables = data.data_vars.values() if isinstance(data, xr.Dataset) else [data]
    for one in variables:
        if pd.isna(one.values).any():
            raise invalid(key, f"gaps in {one.name}", "numbers", "masked, NaN or missing")


def find_labels(values: Any, axis: int = 0) -> pd.Index | None:
    """Return the labels that values have along an axis, None where they have none."""
    if isinstance(values, pd.Series | pd.DataFrame):
        return values.axes[axis]
    if isinstance(values, xr.DataArray) and axis < values.ndim:
        return values.indexes.get(values.dims[axis])
    return None


def align_to_labels(
    key: str,
    values: Any,
    *labels: Any,
    allowed: str = "numbers",
    allow_gaps: bool = False,
    ignore_default_labels: bool = True,
) -> np.ndarray:
    """Return numbers in the order of labels along every axis, or refuse those with other labels.

    Parameters
    ----------
    key : str
    values : array_like
    *labels : sequence or None
        What the labels of the values may be; the first that they are decides.
    allowed, gaps
        As for `as_float_array`.
    ignore_default_labels : bool
        Whether labels that only count, 0, 1, 2 …, are none.
    """
    found = as_float_array(key, values, allowed, allow_gaps=allow_gaps)
    for axis in range(found.ndim):
        places = match_labels(
            key, find_labels(values, axis), labels, ignore_default_labels=ignore_default_labels
        )
        found = found[(slice(None),) * axis + (places,)]
    return found


def match_labels(
    key: str,
    own_labels: pd.Index | None,
    labels: Sequence[Any],
    *,
    ignore_default_labels: bool = True,
) -> Any:
    """Return where values with labels of their own stand among them, or refuse other labels.

    Parameters
    ----------
    key : str
    own_labels : pandas.ComplexIndex or None
        None where places count.
    labels, counted
        As for `align_to_labels`.
    """
    if own_labels is None:
        return slice(None)
    wanted = [row for row in labels if row is not None]
    for row in wanted:
        found = _find_positions(own_labels, row)
        if found is not None:
            return found
    if ignore_default_labels and own_labels.equals(pd.RangeIndex(own_labels.size)):
        return slice(None)
    there, least = own_labels.tolist(), np.asarray(wanted[0]).tolist()
    raise invalid(
        key, f"values at {short_repr(there)}", f"values at {short_repr(least)}", UNLABELLED_HINT
    )


def _find_positions(own_labels: pd.Index, labels: Any) -> np.ndarray | None:
    """Return where each label stands among one's own, None if they are not the same."""
    wanted: Any = np.asarray(labels)
    there: Any = np.asarray(own_labels.tolist())
    if there.shape != wanted.shape:
        return None
    numeric = wanted.dtype.kind in "fiu"
    if not numeric:
        wanted, there = wanted.astype(str), there.astype(str)
    elif there.dtype.kind not in "fiu":
        return None
    before, after = np.argsort(there, kind="stable"), np.argsort(wanted, kind="stable")
    if numeric:
        same = np.allclose(there[before], wanted[after], rtol=ROUNDING_TOLERANCE, atol=0.0)
    else:
        same = bool((there[before] == wanted[after]).all())
    once = bool((there[before][1:] != there[before][:-1]).all())
    if not same or not (once or np.array_equal(there, wanted)):
        return None
    places = np.empty(there.size, dtype=np.int64)
    places[after] = before
    return places


def check_named_numbers(
    key: str,
    value: object,
    names: tuple[str, ...],
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> tuple[float, ...]:
    """Return a sequence of ``len(names)`` floats, by its labels where it has some, or refuse it.

    What rounding has taken beyond one of the `limits` is that end; what is beyond is not refused.
    """
    allowed = f"{len(names)} numbers ({', '.join(names)})"
    value = as_scalar(value)
    if isinstance(value, (str, bytes, Set, Mapping)) or not isinstance(value, Iterable):
        raise invalid(key, value, allowed)
    values = tuple(itertools.islice(value, len(names) + 1))
    if len(values) != len(names):
        raise invalid(key, value, allowed)
    places = np.arange(len(names))[match_labels(key, find_labels(value), [names])]
    found = [check_number(f"{key} ({n})", values[i]) for n, i in zip(names, places, strict=True)]
    return tuple(snap_to_limits(found, *limits).tolist())
