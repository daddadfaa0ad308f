"""Numeric arrays given by users: conversion, validation, and equality of inputs that hold them.

Every such array passes through `as_float_array`, directly or through the other functions of this
module.  Masked elements, NaN and missing values of pandas are all treated as gaps.  Values with
labels (pandas, xarray) are matched by label, not by position.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence, Set
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.labels import convert_times
from splits.core.spacing import MAX_NUMBERS
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    SEVERAL_HINTS,
    TEXT_HINT,
    as_scalar,
    check_number,
    check_range,
    invalid,
    is_list,
    short_repr,
    snap_to_limits,
    suggest_number,
)

UNLABELLED_HINT = "values are matched by their labels; .to_numpy() has none"


def as_float_array(
    key: str, values: Any, allowed: str = "numbers", *, allow_gaps: bool = False
) -> np.ndarray:
    """Return numbers of any shape as a new array of doubles.

    Parameters
    ----------
    key : str
        Key named in error messages.
    values : array_like
        Numbers of any type, byte order and memory layout, but not booleans, dates or text.
    allowed : str
        Requirement for error messages, such as "numbers in nanometres".
    allow_gaps : bool
        Whether gaps, returned as NaN, and infinite numbers are allowed.
    """
    numbers = _convert(key, values, allowed)
    bad_positions = np.flatnonzero(~np.isfinite(numbers)) if not allow_gaps else np.empty(0)
    if bad_positions.size:
        value = numbers.flat[bad_positions[0]]
        prefix = f"number {bad_positions[0] + 1} of {numbers.size} is " if numbers.ndim else ""
        hint = f"{prefix}masked, NaN or missing" if np.isnan(value) else ""
        raise invalid(key, float(value), allowed, hint)
    return numbers


def _convert(key: str, values: Any, allowed: str) -> np.ndarray:
    """Return numbers as a new array of doubles, with NaN for gaps."""
    if isinstance(values, (str, bytes)):
        raise invalid(key, values, allowed, suggest_number(values) or TEXT_HINT)
    if isinstance(values, Set | Mapping):
        hint = "a set has no order" if isinstance(values, Set) else ""
        raise invalid(key, values, allowed, hint)
    if hasattr(values, "__array__"):
        return _convert_array(key, values, allowed)
    if not isinstance(values, Iterable):
        if values is pd.NA:
            return np.array(np.nan)
        # Non-finite numbers are checked later.
        return np.array(values if isinstance(values, float) else check_number(key, values, allowed))
    members = list(itertools.islice(values, MAX_NUMBERS + 1))
    if len(members) > MAX_NUMBERS:
        raise invalid(key, f"more than {MAX_NUMBERS} numbers", f"at most {MAX_NUMBERS} numbers")
    rows = [_convert(key, member, allowed) for member in members]
    if len({row.shape for row in rows}) > 1:
        raise invalid(key, members, allowed, "rows differ in length")
    return np.array(rows, dtype=float)


def _convert_array(key: str, values: Any, allowed: str) -> np.ndarray:
    """Return the numbers of an array of any library; see `_convert`."""
    dense = values if isinstance(values, np.ndarray) else np.asarray(values)
    data, kind = np.ma.getdata(dense), dense.dtype.kind
    if kind in "fiu":
        numbers = np.array(data, dtype=float)
    elif kind == "O":
        missing = np.asarray(pd.isna(data))
        # One text among numbers makes all fields of a CSV file texts.
        texts = (item for item in data.ravel() if isinstance(item, str))
        wrong = next((text for text in texts if not suggest_number(text)), None)
        if wrong is not None:
            raise invalid(key, wrong, allowed, TEXT_HINT)
        numbers = np.full(data.shape, np.nan)
        numbers[~missing] = [check_number(key, item, allowed) for item in data[~missing]]
    else:
        example = data.ravel()[0] if kind in "bUS" and data.size else f"of type {dense.dtype}"
        hint = (suggest_number(example) or TEXT_HINT) if kind in "US" else ""
        raise invalid(key, example, allowed, hint)
    if isinstance(dense, np.ma.MaskedArray):
        numbers[np.ma.getmaskarray(dense)] = np.nan
    return numbers


def as_1d_array(key: str, values: Any, allowed: str = "numbers") -> np.ndarray:
    """Return a number or a sequence of numbers as a one-dimensional array of doubles.

    Parameters
    ----------
    key : str
        Key named in error messages.
    values : array_like
        Finite numbers, from 1 to `MAX_NUMBERS` of them.
    allowed : str
        Requirement for error messages, such as "numbers in nanometres".
    """
    numbers = as_float_array(key, values, allowed)
    if numbers.ndim > 1:
        raise invalid(key, np.asarray(values).tolist(), f"one row of {allowed}")
    if not numbers.size:
        raise invalid(key, [], f"{allowed}, at least one")
    if numbers.size > MAX_NUMBERS:
        raise invalid(key, f"{numbers.size} numbers", f"at most {MAX_NUMBERS} numbers")
    return np.atleast_1d(numbers)


def read_columns(key: str, columns: Mapping[str, Any]) -> list[np.ndarray]:
    """Return the columns of a table as arrays, in the order of the first column.

    Parameters
    ----------
    key : str
        Key of the table in error messages.
    columns : mapping
        Sequences of numbers by name; labels of the others are values or labels of the first.
    """
    first, *others = columns
    column = as_1d_array(f"{key}.{first}", columns[first])
    labels = find_labels(columns[first])
    rows = [
        as_1d_array(
            f"{key}.{name}", align_to_labels(f"{key}.{name}", columns[name], column, labels)
        )
        for name in others
    ]
    return [column, *rows]


def check_increasing(key: str, values: np.ndarray) -> np.ndarray:
    """Return numbers after checking that they are strictly increasing."""
    violations = np.flatnonzero(np.diff(values) <= 0.0)
    if violations.size:
        pair = values[violations[0] : violations[0] + 2].tolist()
        detail = f"numbers {violations[0] + 1} and {violations[0] + 2} of {values.size}"
        raise invalid(key, pair, "strictly increasing", suggest_arange(values) or detail)
    return values


def suggest_arange(values: np.ndarray) -> str:
    """Return a hint for a start, a stop and a step in place of numbers, or ""."""
    if values.size != 3 or not 0.0 < values[2] < values[1] - values[0]:
        return ""
    start, stop, step = values.tolist()
    numbers = f"numpy.arange({start:g}, {stop + 0.5 * step:g}, {step:g})"
    return f"start, stop and step? write all numbers, {numbers}"


def check_array_range(
    key: str, values: np.ndarray, low: float, high: float, unit: str = "", **how: Any
) -> np.ndarray:
    """Return numbers after checking that all are in a range; see `check_range`."""
    snapped = snap_to_limits(values, low, high)
    open_low, open_high = how.get("open_low", False), how.get("open_high", False)
    outside = (snapped < low) | (snapped > high) | (open_low & (snapped == low))
    outside |= open_high & (snapped == high)
    if outside.any():
        check_range(key, snapped[outside][0], low, high, unit, **how)
    return snapped


def check_axis(
    key: str, values: np.ndarray, low: float, high: float, unit: str = "", **how: Any
) -> np.ndarray:
    """Return strictly increasing numbers after checking that all are in a range.

    See `check_range`.
    """
    # The step of a start, a stop and a step is often out of range, too.
    in_range = values if suggest_arange(values) else check_array_range(
        key, values, low, high, unit, **how
    )  # fmt: skip
    return check_increasing(key, in_range)


def check_no_gaps(key: str, data: xr.Dataset | xr.DataArray) -> None:
    """Check that a dataset has no gaps."""
    variables = data.data_vars.values() if isinstance(data, xr.Dataset) else [data]
    for variable in variables:
        if pd.isna(variable.values).any():
            raise invalid(key, f"gaps in {variable.name}", "numbers", "masked, NaN or missing")


def find_labels(values: Any, axis: int = 0) -> pd.Index | None:
    """Return the labels of values along an axis, times in UTC, or None."""
    labels = None
    if isinstance(values, pd.Series | pd.DataFrame):
        labels = values.axes[axis]
    if isinstance(values, xr.DataArray) and axis < values.ndim:
        labels = values.indexes.get(values.dims[axis])
    return None if labels is None else convert_times(labels)


def align_to_labels(
    key: str,
    values: Any,
    *labels: Any,
    allowed: str = "numbers",
    allow_gaps: bool = False,
    ignore_default_labels: bool = True,
) -> np.ndarray:
    """Return numbers in the order of given labels along every axis.

    Parameters
    ----------
    key : str
        Key named in error messages.
    values : array_like
    *labels : sequence or None
        Alternative sequences of labels; the first that matches determines the order.
    allowed, allow_gaps
        As for `as_float_array`.
    ignore_default_labels : bool
        Whether default labels 0, 1, 2 … are ignored.
    """
    numbers = as_float_array(key, values, allowed, allow_gaps=allow_gaps)
    for axis in range(numbers.ndim):
        positions = match_labels(
            key, find_labels(values, axis), labels, ignore_default_labels=ignore_default_labels
        )
        numbers = numbers[(slice(None),) * axis + (positions,)]
    return numbers


def match_labels(
    key: str,
    own_labels: pd.Index | None,
    labels: Sequence[Any],
    *,
    ignore_default_labels: bool = True,
) -> Any:
    """Return the indices that bring labelled values into the order of given labels.

    Parameters
    ----------
    key : str
        Key named in error messages.
    own_labels : pandas.Index or None
        Labels of the values; None for values matched by position.
    labels, ignore_default_labels
        As for `align_to_labels`.
    """
    if own_labels is None:
        return slice(None)
    candidates = [candidate for candidate in labels if candidate is not None]
    for candidate in candidates:
        positions = _find_positions(own_labels, candidate)
        if positions is not None:
            return positions
    if ignore_default_labels and own_labels.equals(pd.RangeIndex(own_labels.size)):
        return slice(None)
    own_values, expected = own_labels.tolist(), np.asarray(candidates[0]).tolist()
    raise invalid(
        key,
        f"values at {short_repr(own_values)}",
        f"values at {short_repr(expected)}",
        UNLABELLED_HINT,
    )


def _find_positions(own_labels: pd.Index, labels: Any) -> np.ndarray | None:
    """Return the position of each label among the own labels, or None if the sets differ."""
    target: Any = np.asarray(labels)
    own: Any = np.asarray(own_labels.tolist())
    if own.shape != target.shape:
        return None
    numeric = target.dtype.kind in "fiu"
    if not numeric:
        target, own = target.astype(str), own.astype(str)
    elif own.dtype.kind not in "fiu":
        return None
    own_order, target_order = np.argsort(own, kind="stable"), np.argsort(target, kind="stable")
    if numeric:
        same = np.allclose(own[own_order], target[target_order], rtol=ROUNDING_TOLERANCE, atol=0.0)
    else:
        same = bool((own[own_order] == target[target_order]).all())
    is_unique = bool((own[own_order][1:] != own[own_order][:-1]).all())
    if not same or not (is_unique or np.array_equal(own, target)):
        return None
    positions = np.empty(own.size, dtype=np.int64)
    positions[target_order] = own_order
    return positions


def check_named_numbers(
    key: str,
    value: Any,
    names: tuple[str, ...],
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> tuple[float, ...]:
    """Return a sequence of ``len(names)`` floats, matched by labels if it has any.

    Numbers outside `limits` by rounding only are set to the limit; others are not checked.
    """
    value = as_scalar(value)
    is_other = isinstance(value, (str, bytes, Set, Mapping)) or not isinstance(value, Iterable)
    # A masked scalar has no dimension to iterate over.
    is_other = is_other or getattr(value, "shape", None) == ()
    values = () if is_other else tuple(itertools.islice(value, len(names) + 1))
    if len(values) != len(names):
        hint = SEVERAL_HINTS[1] if any(map(is_list, values)) else ""
        raise invalid(key, value, f"{len(names)} numbers ({', '.join(names)})", hint)
    positions = np.arange(len(names))[match_labels(key, find_labels(value), [names])]
    numbers = [
        check_number(f"{key} ({n})", values[i]) for n, i in zip(names, positions, strict=True)
    ]
    return tuple(snap_to_limits(numbers, *limits).tolist())


class ContentEquality:
    """Base class of frozen dataclasses that compare and hash by the values of their fields.

    Derived classes are made by `splits.core.declarations.declare_class`, or with ``eq=False``: the
    generated equality of dataclasses fails for arrays, and the generated hash fails for arrays and
    mappings.  Arrays, lists and tuples of equal values are equal, and mappings are equal in any
    order.  Copies and unpickled objects are equal.
    """

    ALTERNATIVES: ClassVar[Mapping[str, str]] = {}
    """Inputs that other ones replace, by name."""

    def __eq__(self, other: object) -> bool:
        """Return whether the other is of the same class with equal fields."""
        if type(other) is not type(self):
            return NotImplemented
        return self is other or self._comparison_key() == other._comparison_key()

    def __hash__(self) -> int:
        """Return the hash of the fields."""
        return hash(self._comparison_key())

    def _comparison_key(self) -> tuple[Hashable, ...]:
        """Return the key by which objects compare."""
        instance: Any = self
        return tuple(_to_hashable(getattr(instance, f.name)) for f in fields(instance) if f.compare)


def _to_hashable(value: Any) -> Hashable:
    """Return a hashable equivalent: tuples of sequences and arrays, sets of pairs of mappings."""
    if isinstance(value, Mapping):
        return frozenset((key, _to_hashable(item)) for key, item in value.items())
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return tuple(map(_to_hashable, value))
    return value
