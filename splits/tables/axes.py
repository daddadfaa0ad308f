"""Axes of a table: parameters and their values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Set
from itertools import pairwise
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array
from splits.core.parameter_names import describe_parameter
from splits.core.validation import as_scalar, format_key, has_surrogates, invalid, unknown_key

INCIDENCE = "incidence_deg"
RESULT_NAMES = (
    "wavelength", "batch", "delay", "bounds", "reflectance", "transmittance", "absorptance",
    "reflectance_factor", "anisotropy_factor", "return_rate", "fraction", "mean_delay",
)  # fmt: skip
"""Dimensions and quantities of tables, which no parameter may be named after."""
AXIS_ALIASES = {"sza": INCIDENCE}
"""Short names of axes."""
MAX_SPECTRA = 100_000_000


class ParameterGrid(NamedTuple):
    """Grid of parameters, each with increasing numbers or text values.

    Attributes
    ----------
    names : tuple of str
    values : tuple of tuple
    """

    names: tuple[str, ...]
    values: tuple[tuple[Any, ...], ...]

    @classmethod
    def from_mapping(cls, grid: Any) -> ParameterGrid:
        """Return the grid for a user's mapping.

        Parameters
        ----------
        grid : mapping
            Sequence of distinct values by parameter: numbers, or text such as "diffuse" and the
            names of soils.

        Raises
        ------
        ValueError
            For an empty axis, duplicate values, mixed numbers and text, or unordered numbers.
        """
        if not isinstance(grid, Mapping) or not grid:
            raise invalid("grid", grid, "a mapping from parameters to lists of values")
        axes = cls(
            tuple(map(str, grid)), tuple(_check_grid_axis(str(k), v) for k, v in grid.items())
        )
        for name in axes.names:
            if not name or has_surrogates(name) or name.removesuffix("_stderr") in RESULT_NAMES:
                allowed = "names that no quantity and no dimension of the result has"
                raise invalid("grid", name, allowed)
        if axes.size > MAX_SPECTRA:
            raise invalid("grid", f"{axes.size} spectra", f"at most {MAX_SPECTRA}")
        return axes

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis."""
        return tuple(len(row) for row in self.values)

    @property
    def size(self) -> int:
        """Number of points of the grid."""
        return math.prod(self.shape)

    def drop(self, name: str) -> ParameterGrid:
        """Return the grid without an axis, which need not exist."""
        kept = [(n, row) for n, row in zip(*self, strict=True) if n != name]
        return ParameterGrid(tuple(n for n, _ in kept), tuple(row for _, row in kept))

    def get_values(self, name: str, default: Any) -> tuple[Any, ...]:
        """Return the values of an axis, or the default if there is no such axis."""
        return self.values[self.names.index(name)] if name in self.names else (default,)

    def check_single_incidence(self, incidence_deg: Any) -> None:
        """Reject several angles, and any but the default where it is an axis of the grid."""
        incidence_deg = as_scalar(incidence_deg)
        if isinstance(incidence_deg, Iterable) and not isinstance(incidence_deg, str):
            incidence_deg = [as_scalar(value) for value in incidence_deg]
        if INCIDENCE in self.names and incidence_deg != 0.0:
            allowed = f"left out, because grid.{INCIDENCE} sets it"
            raise invalid(INCIDENCE, incidence_deg, allowed)
        if isinstance(incidence_deg, list):
            hint = f"the grid takes the axis '{INCIDENCE}': {incidence_deg}"
            raise invalid(INCIDENCE, incidence_deg, "one angle in degrees, or diffuse", hint)

    def iterate_points(self) -> Iterator[dict[str, Any]]:
        """Yield the parameters of every point; the last axis varies fastest."""
        for values in itertools.product(*self.values):
            yield dict(zip(self.names, values, strict=True))

    def to_coordinates(self) -> dict[str, Any]:
        """Return the axes as dataset coordinates with long names and units."""
        return {name: (name, *_make_coordinate(name, row)) for name, row in zip(*self, strict=True)}


def check_axis_values(
    at: Any, axes: Iterable[str], prefix: str = "", *, free_axes: Iterable[str] = ()
) -> dict[str, Any]:
    """Return values by full axis name.

    Parameters
    ----------
    at : mapping or None
        Values by axis; short names are accepted.
    axes : iterable of str
        Axes of the table.
    prefix : str
        Prefix of names in error messages, such as "at.".
    free_axes : iterable of str
        Axes that must not be given a value.

    Raises
    ------
    ValueError
        For an unknown or free axis, or an axis given twice.
    """
    if not isinstance(at, Mapping | None):
        raise invalid(prefix.rstrip("."), at, "a mapping from axes to values")
    axis_names, values = list(axes), {}
    for name, value in (at or {}).items():
        axis = name if name in axis_names else AXIS_ALIASES.get(name, name)
        if axis not in axis_names:
            raise unknown_key(f"{prefix}{name}", axis_names)
        if axis in values:
            other_name = (
                axis
                if name != axis
                else next(alias for alias in AXIS_ALIASES if AXIS_ALIASES[alias] == axis)
            )
            raise invalid(
                f"{prefix}{name}", value, f"left out, because {prefix}{other_name} sets it"
            )
        if axis in free_axes:
            raise invalid(f"{prefix}{name}", value, "left out, as it is free")
        values[axis] = value
    return values


def list_numeric_axes(dataset: Any, names: Iterable[str]) -> list[str]:
    """Return the numeric axes of a table with more than one node."""
    return [n for n in names if dataset[n].dtype.kind == "f" and dataset[n].size > 1]


def _check_grid_axis(name: str, values_given: Any) -> tuple[Any, ...]:
    """Return the validated values of an axis."""
    key = f"grid.{format_key(name)}"
    allowed = "a list of different values, numbers or text"
    values_given = as_scalar(values_given)
    if isinstance(values_given, str | Mapping | Set) or not isinstance(values_given, Iterable):
        hint = f"write [{values_given!r}]" if isinstance(values_given, str | Real) else ""
        if hint and name == INCIDENCE:
            hint += f", or give the argument {name}={values_given!r} and leave it out of the grid"
        raise invalid(key, values_given, allowed, hint)
    values = [as_scalar(value) for value in values_given]
    if not values:
        raise invalid(key, values, allowed)
    if any(isinstance(value, str) for value in values):
        if not all(isinstance(value, str) for value in values):
            hint = "not both in one axis: only numbers are interpolated"
            raise invalid(key, values, allowed, hint)
        if len(set(values)) < len(values):
            raise invalid(key, values, allowed)
        return tuple(values)
    allowed = "different, increasing numbers"
    numbers = as_1d_array(key, values, allowed).tolist()
    if any(lower >= upper for lower, upper in pairwise(numbers)):
        raise invalid(key, numbers, allowed)
    return tuple(numbers)


def _make_coordinate(name: str, axis_values: tuple[Any, ...]) -> tuple[np.ndarray, dict[str, str]]:
    """Return the values of an axis with its long name and units."""
    long_name, units = describe_parameter(name)
    values = np.array(axis_values)
    if values.dtype.kind != "f":
        return values, {"long_name": long_name + (f" ({units})" if units != "1" else "")}
    return values, {"long_name": long_name, "units": units}
