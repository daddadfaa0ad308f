"""Axes of a table: parameters, directions of observation, their order and complete values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import replace
from numbers import Real
from typing import Annotated, Any, TypeVar

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, check_axis, check_no_gaps
from splits.core.declarations import Quantity
from splits.core.inputs import (
    AZIMUTH_ANGLE,
    INCIDENCE_ANGLE,
    POLAR_ANGLE,
    check_incidence,
    check_polar_angles,
)
from splits.core.validation import as_scalar, format_key, has_surrogates, invalid, unknown_key
from splits.io.netcdf import NETCDF_LOCK
from splits.media.medium import Medium
from splits.media.parameters import describe_parameter
from splits.simulation.spectral_tally import SIDE_QUANTITIES

INCIDENCE = "incidence_deg"
DELAY = "delay_s"
TRAILING_DIMS = ("wavelength", DELAY, "band", "bounds")
"""Dimensions of tables after their axes."""
RETURN_QUANTITIES = ("return_rate", "fraction", "mean_delay")
"""Quantities of a table of returns."""
RESULT_NAMES = (
    "batch", *TRAILING_DIMS, "reflectance", "transmittance", "absorptance",
    "reflectance_factor", "anisotropy_factor", *RETURN_QUANTITIES,
)  # fmt: skip
"""Dimensions and quantities of tables, which no parameter may be named after."""
AXIS_ALIASES = {"sza": INCIDENCE}
"""Short names of axes."""
MAX_SPECTRA = 100_000_000


class ParameterGrid(dict[str, tuple[Any, ...]]):
    """Grid of parameters: increasing numbers, or texts, by the name of each axis."""

    @classmethod
    def from_mapping(cls, grid: Any) -> ParameterGrid:
        """Return the grid of a user's mapping, see `check_grid`."""
        return cls(check_grid("grid", grid))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis."""
        return tuple(map(len, self.values()))

    @property
    def size(self) -> int:
        """Number of points of the grid."""
        return math.prod(self.shape)

    def drop(self, *names: str) -> ParameterGrid:
        """Return the grid without some axes, which need not exist."""
        return ParameterGrid({name: row for name, row in self.items() if name not in names})

    def get_incidences(self, incidence_deg: float | str) -> list[float | str]:
        """Return the angles of the axis of incidence, or that of all points without this axis."""
        if INCIDENCE not in self:
            return [incidence_deg]
        if incidence_deg != 0.0:
            allowed = f"left out, because grid.{INCIDENCE} sets it"
            raise invalid(INCIDENCE, incidence_deg, allowed)
        return [check_incidence(INCIDENCE, angle) for angle in self[INCIDENCE]]

    def iterate_points(self) -> Iterator[dict[str, Any]]:
        """Yield the parameters of every point; the last axis varies fastest."""
        for values in itertools.product(*self.values()):
            yield dict(zip(self, values, strict=True))

    def to_coordinates(self) -> dict[str, Any]:
        """Return the axes as dataset coordinates with long names and units."""
        coordinates = {}
        for name, row in self.items():
            values, (long_name, units) = np.array(row), describe_parameter(name)
            attributes = {"long_name": long_name, "units": units}
            if values.dtype.kind != "f":
                # Texts have no units, but may stand for values of a parameter that has.
                unit = f" ({units})" if units != "1" else ""
                attributes = {"long_name": long_name + unit}
            coordinates[name] = (name, values, attributes)
        return coordinates


def check_grid(key: str, grid: Any) -> dict[str, tuple[Any, ...]]:
    """Return the values of a grid by parameter, after checking them.

    Parameters
    ----------
    key : str
        Key named in error messages.
    grid : mapping
        Sequence of distinct values by parameter: numbers, or text such as "diffuse" and the names
        of soils.

    Raises
    ------
    ValueError
        For an empty axis, duplicate values, mixed numbers and text, or unordered numbers.
    """
    if not isinstance(grid, Mapping) or not grid:
        raise invalid(key, grid, "a mapping from parameters to lists of values")
    axes = {str(name): _check_grid_axis(str(name), values) for name, values in grid.items()}
    for name in axes:
        if not name or has_surrogates(name) or name.removesuffix("_stderr") in RESULT_NAMES:
            allowed = "names that no quantity and no dimension of the result has"
            raise invalid(key, name, allowed)
    size = math.prod(map(len, axes.values()))
    if size > MAX_SPECTRA:
        raise invalid(key, f"{size} spectra", f"at most {MAX_SPECTRA}")
    return axes


def check_single_incidence(key: str, incidence_deg: Any) -> float | str:
    """Return the incidence of all points of a grid, after checking that it is a single one."""
    is_several = isinstance(incidence_deg, Iterable) and np.ndim(incidence_deg) > 0  # type: ignore[arg-type]
    if is_several and not isinstance(incidence_deg, str):
        angles = [as_scalar(value) for value in incidence_deg]
        hint = f"the grid takes the axis '{INCIDENCE}': {angles}"
        raise invalid(key, angles, "one angle in degrees, or diffuse", hint)
    return check_incidence(key, incidence_deg)


def _check_function(key: str, make: Any) -> Callable[..., Any]:
    if not callable(make):
        raise invalid(key, make, "a function that returns a medium", "such as Snow.natural")
    return make


MakeMedium = Annotated[
    Callable[..., Medium],
    Quantity("function of the parameters that returns a medium", check=_check_function),
]
Grid = Annotated[
    Mapping[str, Any],
    Quantity("values by parameter", check=check_grid, schema={"type": "object"}),
]
GridIncidence = Annotated[
    float | str,
    replace(INCIDENCE_ANGLE, check=check_single_incidence),
]


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
    axis_names, values, reasons = list(axes), {}, dict.fromkeys(free_axes, "as it is free")
    for name, value in (at or {}).items():
        axis = name if name in axis_names else AXIS_ALIASES.get(name, name)
        if axis not in axis_names:
            raise unknown_key(f"{prefix}{name}", axis_names)
        if axis in reasons:
            raise invalid(f"{prefix}{name}", value, f"left out, {reasons[axis]}")
        values[axis], reasons[axis] = value, f"because {prefix}{name} sets it"
    return values


def _check_grid_axis(name: str, values_given: Any) -> tuple[Any, ...]:
    """Return the validated values of an axis."""
    key, values = f"grid.{format_key(name)}", as_scalar(values_given)
    is_list = isinstance(values, Iterable) and not isinstance(values, str | Mapping | Set)
    hint = f"write [{values!r}]" if isinstance(values, str | Real) else ""
    if hint and name == INCIDENCE:
        hint += f", or give the argument {name}={values!r} and leave it out of the grid"
    values = [as_scalar(value) for value in values] if is_list else values
    are_texts = {isinstance(value, str) for value in values} if is_list else set()
    if len(are_texts) > 1:
        hint = "not both in one axis: only numbers are interpolated"
    is_repeated = are_texts == {True} and len(set(values)) < len(values)
    if len(are_texts) != 1 or is_repeated:
        raise invalid(key, values, "a list of different values, numbers or text", hint)
    if are_texts == {True}:
        return tuple(values)
    allowed = "different, increasing numbers"
    numbers = as_1d_array(key, values, allowed)
    if (np.diff(numbers) <= 0.0).any():
        raise invalid(key, numbers.tolist(), allowed)
    return tuple(numbers.tolist())


POLAR, AZIMUTH = "polar_deg", "azimuth_deg"
VIEW_AXES = (POLAR, AZIMUTH)
ANGLES = (INCIDENCE, *VIEW_AXES)
DIFFUSE_PREFIX = "diffuse_"
VIEW_QUANTITIES = ("reflectance_factor", "anisotropy_factor")
MIXED_QUANTITIES = ("reflectance", *VIEW_QUANTITIES)
"""Quantities of a beam, which isotropic light may be mixed with."""
DIFFUSE_QUANTITIES = tuple(DIFFUSE_PREFIX + name for name in MIXED_QUANTITIES)
"""Quantities under isotropic light, in a table whose other quantities are under beams."""
ALL_QUANTITIES = (*SIDE_QUANTITIES, *VIEW_QUANTITIES, *DIFFUSE_QUANTITIES)


Views = tuple[np.ndarray, np.ndarray]
"""Polar angles (degrees, 0 to below 90) and azimuths (0 to 180) of observation."""


def read_views(grid: ParameterGrid, prefix: str = "grid.") -> Views | None:
    """Return the directions among the axes of a grid, None without them.

    Names in messages begin with the prefix.

    Raises
    ------
    ValueError
        For one axis without the other, or angles outside their range.
    """
    given = [name for name in VIEW_AXES if name in grid]
    if not given:
        return None
    for name in VIEW_AXES:
        if name not in given:
            raise invalid(f"{prefix}{name}", None, "given", f"{given[0]} needs it")
    polar = check_polar_angles(f"{prefix}{POLAR}", grid[POLAR])
    key, hint = f"{prefix}{AZIMUTH}", "both sides of the plane of incidence are the same"
    azimuth = as_1d_array(key, grid[AZIMUTH], "numbers")
    return polar, check_axis(key, azimuth, 0.0, 180.0, "degrees", hint=hint)


def make_view_coordinates(views: Views) -> dict[str, Any]:
    """Return directions of observation as dataset coordinates."""
    quantities = (POLAR_ANGLE, AZIMUTH_ANGLE)
    return {
        name: (name, angles, one.attributes)
        for name, angles, one in zip(VIEW_AXES, views, quantities, strict=True)
    }


def fold_azimuths(azimuth_deg: Any) -> Any:
    """Return azimuths from 0 to 180 degrees on the same cones around the beam."""
    turned = np.mod(azimuth_deg, 360.0)
    return np.minimum(turned, 360.0 - turned)


def list_view_axes(quantity: str) -> tuple[str, ...]:
    """Return the axes of a quantity that are directions of observation."""
    name = quantity.removesuffix("_stderr")
    if name.removeprefix(DIFFUSE_PREFIX) not in VIEW_QUANTITIES:
        return ()
    return (POLAR,) if name.startswith(DIFFUSE_PREFIX) else VIEW_AXES


def has_diffuse(quantities: Iterable[str]) -> bool:
    """Return whether any quantity is that under isotropic light beside beams."""
    return any(name.startswith(DIFFUSE_PREFIX) for name in quantities)


def check_quantities(quantities: Any, views: Views | None, covariance: bool) -> tuple[str, ...]:
    """Return the validated quantities of a table; by default those of its axes.

    Raises
    ------
    ValueError
        For unknown quantities, or directional ones without directions.
    """
    allowed = SIDE_QUANTITIES if views is None else (*MIXED_QUANTITIES, *DIFFUSE_QUANTITIES)
    if quantities is None:
        quantities = ("reflectance",) if views is None else MIXED_QUANTITIES
    is_list = isinstance(quantities, list | tuple) and len(quantities) > 0
    if not is_list or len(set(quantities)) < len(quantities):
        raise invalid("quantities", quantities, f"a list of different {' or '.join(allowed)}")
    for name in quantities:
        if name not in allowed:
            hint = "it needs" if views is None else "leave out"
            hint = f"{hint} polar_deg and azimuth_deg" if name in ALL_QUANTITIES else ""
            raise invalid("quantities", name, " or ".join(allowed), hint)
    if covariance and views is not None:
        raise invalid("covariance", covariance, "False for a table with directions")
    return tuple(quantities)


ALONG = "_along_"
"""Between a name and the axis of a table along which it has more positions than the nodes, see
`splits.tables.comparison`."""
Part = TypeVar("Part", xr.Dataset, xr.DataArray)


def sort_axes(dataset: Any) -> xr.Dataset:
    """Return a table with ascending numeric axes and the wavelength as the last axis.

    Tables that were sliced, sorted, transposed or converted with xarray are accepted.

    Raises
    ------
    ValueError
        If the dataset is not a table, or an axis is missing or invalid.
    """
    allowed = "what splits.build_table returned, or wrote"
    if not isinstance(dataset, xr.Dataset) or "path_sharing_axes" not in dataset.attrs:
        is_dataset = isinstance(dataset, xr.Dataset)
        found = dataset.attrs.get("title", "a dataset") if is_dataset else type(dataset).__name__
        raise invalid("table", found, allowed)
    find_variables(dataset, list_quantities(dataset), "with a quantity and its error")
    axes = list_axes(dataset)
    if "wavelength" not in axes:
        hint = "select a list: sel(wavelength=[500]), which keeps the axis"
        raise invalid("table", f"over {', '.join(axes) or 'nothing'}", "over wavelength", hint)
    for name in axes:
        dataset = _sort_axis(dataset, name)
    return dataset.transpose(..., *axes[:-1], *TRAILING_DIMS, missing_dims="ignore")


def find_variables(
    dataset: xr.Dataset, names: Iterable[str], allowed: str, hint: str = ""
) -> list[str]:
    """Return the names of the variables that a table has; reject one that has none of them."""
    found = [name for name in names if name in dataset]
    if not found:
        raise invalid("table", list(map(str, dataset.data_vars)), allowed, hint)
    return found


def list_quantities(dataset: xr.Dataset) -> list[str]:
    """Return the quantities of a table, without standard errors."""
    # Means over bands follow from the spectra, also between the nodes.
    return [
        str(name) for name in dataset.data_vars
        if f"{name}_stderr" in dataset.data_vars and "band" not in dataset[name].dims
    ]  # fmt: skip


def list_axes(dataset: xr.Dataset) -> list[str]:
    """Return the axes of the quantities of a table, the wavelength last where it is an axis."""
    axes: list[str] = []
    for name in list_quantities(dataset):
        axes += [str(dim) for dim in dataset[name].dims if dim not in (*axes, DELAY)]
    return sorted(axes, key=lambda axis: (axis == "wavelength", axis in VIEW_AXES))


def _sort_axis(dataset: xr.Dataset, name: str) -> xr.Dataset:
    """Return a table with one axis sorted and its numbers as floats."""
    if name not in dataset.coords:
        raise invalid(f"table.{name}", None, "given: the values of the axis")
    # Axes converted by pandas may have the dtype object.
    values = np.array(dataset[name].values.tolist())
    text = values.dtype.kind in "OUS"
    is_valid = text or (values.dtype.kind in "iuf" and np.isfinite(values).all())
    if not is_valid or len(set(values.tolist())) < values.size:
        allowed = "different values" if is_valid else "numbers, or texts"
        raise invalid(f"table.{name}", values.tolist(), allowed)
    if dataset[name].dtype.kind not in "fUS":
        axis = (name, values if text else values.astype(float), dataset[name].attrs)
        dataset = dataset.assign_coords({name: axis})
    return dataset if text or (np.diff(values) > 0.0).all() else dataset.sortby(name)


def check_complete(dataset: xr.Dataset) -> None:
    """Check that a table has a value at every node."""
    for name, variable in dataset.data_vars.items():
        # Comparisons with gaps, such as those of joined tables, are not used.  Moments of returns
        # have a flag where there is no light.
        is_flagged = str(name).startswith("mean_delay")
        is_checked = variable.dtype.kind == "f" and ALONG not in str(name) and not is_flagged
        if is_checked and not np.isfinite(variable).all():
            hint = "aligning or reindexing leaves gaps: select existing nodes"
            raise invalid(f"table.{name}", np.nan, "a number at every node", hint)


def load_selection(selection: Part) -> Part:
    """Load a part of a table into memory and check it for gaps."""
    # The HDF5 library is not thread-safe.
    with NETCDF_LOCK:
        selection = selection.load()
    check_no_gaps("table", selection)
    return selection
