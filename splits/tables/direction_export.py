"""Selection of bidirectional reflectance from tables of directions, and checks of their angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import invalid, snap_to_limits
from splits.tables.axes import INCIDENCE
from splits.tables.export import select_at_fixed_axes
from splits.tables.views import AZIMUTH, VIEW_AXES

ANGLES = (INCIDENCE, *VIEW_AXES)
REFLECTANCE_FACTOR = "reflectance_factor"
DIFFUSE_REFLECTANCE_FACTOR = "diffuse_reflectance_factor"


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
        For a table without directions, an angle with fewer than two nodes, with text, or outside
        its range, azimuths that do not extend from 0° to 180°, a missing axis, or gaps.
    """
    if REFLECTANCE_FACTOR not in dataset or not {*ANGLES} <= {*dataset[REFLECTANCE_FACTOR].dims}:
        allowed = f"with {REFLECTANCE_FACTOR} over {', '.join(ANGLES)}"
        raise invalid("table", list(map(str, dataset.data_vars)), allowed)
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
        For text, fewer than two nodes, nodes outside the range of the angle, or azimuths that do
        not extend from 0° to 180°.
    """
    if nodes.dtype.kind not in "iuf" or nodes.size < 2:
        raise invalid(name, nodes.tolist(), "at least two angles")
    first, last = snap_to_limits(np.sort(nodes.astype(float)), 0.0, 180.0)[[0, -1]].tolist()
    if name == AZIMUTH and (first, last) != (0.0, 180.0):
        raise invalid(name, nodes.tolist(), "from 0 to 180")
    if name != AZIMUTH and not 0.0 <= first < last < 90.0:
        raise invalid(name, nodes.tolist(), "at least 0, and less than 90")
