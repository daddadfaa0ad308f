"""Selection of the part of a table that another program takes, and checks of its angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_choice,
    check_number,
    invalid,
    snap_to_limits,
)
from splits.tables.axes import check_axis_values
from splits.tables.views import ANGLES, AZIMUTH

RADIUS, SURFACE_AREA = "optical_radius_um", "specific_surface_area_m2_kg"
REFLECTANCE_FACTOR = "reflectance_factor"
DIFFUSE_REFLECTANCE_FACTOR = "diffuse_reflectance_factor"


def select_at_fixed_axes(
    dataset: xr.Dataset, quantities: tuple[str, ...], free_axes: list[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the part of a table over the free axes, with the other axes at a node."""
    axes = [str(d) for d in dataset[quantities[0]].dims if d != "wavelength"]
    for name in free_axes:
        if name == RADIUS and RADIUS not in axes and SURFACE_AREA in axes:
            hint = f"give {RADIUS} = 3e6/(917 {SURFACE_AREA}) in the grid of splits.build_table"
            raise invalid("table", f"over {', '.join(axes)}", f"over {RADIUS}", hint)
        check_choice("axis", name, axes)
    at = check_axis_values(at, axes, free_axes=free_axes)
    subset = dataset[list(quantities)]
    for name in axes:
        values = dataset[name].values
        if name in free_axes:
            continue
        if name not in at and values.size > 1:
            raise invalid(name, None, "given", "one of " + ", ".join(map(str, values)))
        coordinate = as_scalar(at.get(name, values[0]))
        if values.dtype.kind == "f":
            matches = np.isclose(
                values, check_number(name, coordinate), rtol=ROUNDING_TOLERANCE, atol=0.0
            )
        else:
            matches = values == str(coordinate)
        indices = np.flatnonzero(matches)
        if not indices.size:
            raise invalid(name, coordinate, "one of " + ", ".join(map(str, values)))
        subset = subset.isel({name: int(indices[0])})
    check_no_gaps("table", subset)
    return subset


def select_reflectance_factor(
    dataset: xr.Dataset, at: Mapping[str, Any], free_axes: Sequence[str] = ()
) -> xr.Dataset:
    """Return the bidirectional reflectance factor of a table, with other axes at a node.

    Parameters
    ----------
    dataset : xarray.Dataset
        Table with ``reflectance_factor`` over ``incidence_deg``, ``polar_deg`` and
        ``azimuth_deg``.
    at : mapping
        Node of each axis that is neither an angle nor free.
    free_axes : sequence of str
        Axes to keep in addition to the angles and the wavelength.

    Returns
    -------
    xarray.Dataset
        ``reflectance_factor``, and its standard error if the table has one, over the angles, the
        free axes and the wavelength.  Angles ascend.

    Raises
    ------
    ValueError
        For a table without directions, an angle with too few nodes, with text, or outside its
        range, azimuths that do not extend from 0° to 180°, a missing axis, or gaps.
    """
    allowed = f"with {REFLECTANCE_FACTOR} over {', '.join(ANGLES)}"
    if REFLECTANCE_FACTOR not in dataset:
        raise invalid("table", list(map(str, dataset.data_vars)), allowed)
    dims = list(map(str, dataset[REFLECTANCE_FACTOR].dims))
    missing = [name for name in ANGLES if name not in dims]
    if missing:
        hint = f"give {', '.join(missing)} in the grid of splits.build_table"
        raise invalid("table", f"{REFLECTANCE_FACTOR} over {', '.join(dims)}", allowed, hint)
    for name in ANGLES:
        check_angle_nodes(name, dataset[name].values)
    names = [REFLECTANCE_FACTOR]
    if f"{REFLECTANCE_FACTOR}_stderr" in dataset:
        names.append(f"{REFLECTANCE_FACTOR}_stderr")
    subset = select_at_fixed_axes(dataset, tuple(names), [*ANGLES, *free_axes], at)
    return subset.sortby([*ANGLES]).transpose(*ANGLES, *free_axes, "wavelength")


def check_angle_nodes(name: str, nodes: np.ndarray) -> None:
    """Check that the nodes of an angle suffice for a conversion.

    Raises
    ------
    ValueError
        For text, too few nodes, nodes outside the range of the angle, or azimuths that do
        not extend from 0° to 180°.
    """
    if nodes.dtype.kind not in "iuf" or nodes.size < 2:
        raise invalid(name, nodes.tolist(), "at least two angles")
    first, last = snap_to_limits(np.sort(nodes.astype(float)), 0.0, 180.0)[[0, -1]].tolist()
    if name == AZIMUTH and (first, last) != (0.0, 180.0):
        raise invalid(name, nodes.tolist(), "from 0 to 180")
    if name != AZIMUTH and not 0.0 <= first <= last < 90.0:
        raise invalid(name, nodes.tolist(), "at least 0, and less than 90")
