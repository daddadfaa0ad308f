"""The axes of a table: parameters, and the values that each of them takes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Set
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array
from splits.core.parameter_names import describe_parameter
from splits.core.validation import as_scalar, format_key, invalid, unknown_key

INCIDENCE = "incidence_deg"
AXIS_ALIASES = {"sza": INCIDENCE}
"""Names that stand for those of axes."""
MAX_SPECTRA = 100_000_000


class ParameterGrid(NamedTuple):
    """Parameters and their values: increasing numbers, or texts.

    Attributes
    ----------
    names : tuple of str
    values : tuple of tuple
    """

    names: tuple[str, ...]
    values: tuple[tuple[Any, ...], ...]

    @classmethod
    def from_mapping(cls, grid: Any) -> ParameterGrid:
        """Return the axes of a user's grid, or refuse it.

        Parameters
        ----------
        grid : mapping
            From parameters to rows of different values: numbers, or texts such as "diffuse" and the
            names of soils.

        Raises
        ------
        ValueError
            For an empty row, values given twice, numbers among texts, or numbers in no order.
        """
        if not isinstance(grid, Mapping) or not grid:
            raise invalid("grid", grid, "a mapping from parameters to rows of values")
        axes = cls(
            tuple(map(str, grid)), tuple(_check_grid_axis(str(k), v) for k, v in grid.items())
        )
        if axes.size > MAX_SPECTRA:
            raise invalid("grid", f"{axes.size} spectra", f"at most {MAX_SPECTRA}")
        return axes

    @property
    def shape(self) -> tuple[int, ...]:
        """How many values each axis has."""
        return tuple(len(row) for row in self.values)

    @property
    def size(self) -> int:
        """How many spectra the table has."""
        return math.prod(self.shape)

    def drop(self, name: str) -> ParameterGrid:
        """Return all axes but one, which need not be there."""
        kept = [(n, row) for n, row in zip(*self, strict=True) if n != name]
        return ParameterGrid(tuple(n for n, _ in kept), tuple(row for _, row in kept))

    def get_values(self, name: str, default: Any) -> tuple[Any, ...]:
        """Return the values of an axis, or one value where there is no such axis."""
        return self.values[self.names.index(name)] if name in self.names else (default,)

    def iterate_points(self) -> Iterator[dict[str, Any]]:
        """Yield the parameters of every point, the last axis running fastest."""
        for values in itertools.product(*self.values):
            yield dict(zip(self.names, values, strict=True))

    def to_coordinates(self) -> dict[str, Any]:
        """Return the axes as coordinates of a dataset, numbers with their units."""
        return {name: (name, *_make_coordinate(name, row)) for name, row in zip(*self, strict=True)}


def check_axis_values(
    at: Any, axes: Iterable[str], prefix: str = "", *, free_axes: Iterable[str] = ()
) -> dict[str, Any]:
    """Return values of axes under the axes' own names, or refuse them.

    Parameters
    ----------
    at : mapping or None
        From axes, or what is short for them, to values.
    axes : iterable of str
        Those that there are.
    prefix : str
        Where the values stand, as messages show it before a name: "at.".
    free_axes : iterable of str
        Axes that have no value.
    """
    if not isinstance(at, Mapping | None):
        raise invalid(prefix.rstrip("."), at, "a mapping from axes to values")
    known, found = list(axes), {}
    for name, value in (at or {}).items():
        own = name if name in known else AXIS_ALIASES.get(name, name)
        if own not in known:
            raise unknown_key(f"{prefix}{name}", known)
        if own in found:
            other = (
                own
                if name != own
                else next(short for short in AXIS_ALIASES if AXIS_ALIASES[short] == own)
            )
            raise invalid(f"{prefix}{name}", value, f"left out beside {prefix}{other}, the same")
        if own in free_axes:
            raise invalid(f"{prefix}{name}", value, "left out, as it is free")
        found[own] = value
    return found


def list_numeric_axes(dataset: Any, names: Iterable[str]) -> list[str]:
    """Return the axes of a table that are of several numbers."""
    return [n for n in names if dataset[n].dtype.kind == "f" and dataset[n].size > 1]


def _check_grid_axis(name: str, values_given: Any) -> tuple[Any, ...]:
    """Return the values of an axis, or refuse them."""
    key = f"grid.{format_key(name)}"
    allowed = "a row of different values, numbers or texts"
    if isinstance(values_given, str | Mapping | Set) or not isinstance(values_given, Iterable):
        raise invalid(key, values_given, allowed)
    values = [as_scalar(value) for value in values_given]
    if not values:
        raise invalid(key, values, allowed)
    if any(isinstance(value, str) for value in values):
        if not all(isinstance(value, str) for value in values):
            hint = "not both in one axis: one reads between numbers"
            raise invalid(key, values, allowed, hint)
        if len(set(values)) < len(values):
            raise invalid(key, values, allowed)
        return tuple(values)
    allowed = "different, increasing numbers"
    numbers = as_1d_array(key, values, allowed).tolist()
    if any(one >= other for one, other in pairwise(numbers)):
        raise invalid(key, numbers, allowed)
    return tuple(numbers)


def _make_coordinate(name: str, axis_values: tuple[Any, ...]) -> tuple[np.ndarray, dict[str, str]]:
    """Return the values of an axis and what they are."""
    long_name, units = describe_parameter(name)
    values = np.array(axis_values)
    if values.dtype.kind != "f":
        return values, {"long_name": long_name + (f" ({units})" if units != "1" else "")}
    return values, {"long_name": long_name, "units": units}
