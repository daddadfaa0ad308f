"""Directions of observation of a table."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from splits.core.arrays import as_1d_array, check_increasing
from splits.core.validation import invalid
from splits.simulation.run_options import check_direction_angles
from splits.simulation.spectral_tally import SIDE_QUANTITIES
from splits.tables.axes import INCIDENCE, ParameterGrid

POLAR, AZIMUTH = "polar_deg", "azimuth_deg"
VIEW_AXES = (POLAR, AZIMUTH)
ANGLES = (INCIDENCE, *VIEW_AXES)
DIFFUSE_PREFIX = "diffuse_"
VIEW_QUANTITIES = ("reflectance_factor", "anisotropy_factor")
MIXED_QUANTITIES = ("reflectance", *VIEW_QUANTITIES)
"""Quantities of a beam, which isotropic light may be mixed with."""
DIFFUSE_QUANTITIES = tuple(DIFFUSE_PREFIX + name for name in ("reflectance", *VIEW_QUANTITIES))
"""Quantities under isotropic light, in a table whose other quantities are under beams."""
ALL_QUANTITIES = (*SIDE_QUANTITIES, *VIEW_QUANTITIES, *DIFFUSE_QUANTITIES)
DIRECTIONAL_QUANTITIES = ("reflectance", *VIEW_QUANTITIES, *DIFFUSE_QUANTITIES)
"""Quantities of a table with directions."""


class ViewGrid(NamedTuple):
    """Directions of observation.

    Attributes
    ----------
    polar : float, shape (polar,)
        Angles from the normal (degrees), 0 to below 90.
    azimuth : float, shape (azimuth,)
        Angles from the direction in which the beam travels (degrees), 0 to 180.
    """

    polar: np.ndarray
    azimuth: np.ndarray

    @classmethod
    def from_grid(cls, grid: ParameterGrid, prefix: str = "grid.") -> ViewGrid | None:
        """Return the directions among the axes of a grid, None without them.

        Names in messages begin with the prefix.

        Raises
        ------
        ValueError
            For one axis without the other, or angles outside their range.
        """
        given = [name for name in VIEW_AXES if name in grid.names]
        if not given:
            return None
        for name in VIEW_AXES:
            if name not in given:
                raise invalid(f"{prefix}{name}", None, "given", f"{given[0]} needs it")
        polar = check_direction_angles(f"{prefix}{POLAR}", grid.get_values(POLAR, 0.0), 90.0)
        azimuth = as_1d_array(f"{prefix}{AZIMUTH}", grid.get_values(AZIMUTH, 0.0), "numbers")
        check_increasing(f"{prefix}{AZIMUTH}", azimuth)
        if azimuth[0] < 0.0 or azimuth[-1] > 180.0:
            hint = "both sides of the plane of incidence are the same"
            raise invalid(f"{prefix}{AZIMUTH}", azimuth.tolist(), "0 to 180", hint)
        return cls(polar, azimuth)

    def to_coordinates(self) -> dict[str, Any]:
        """Return the angles as dataset coordinates."""
        labels = ("angle from the normal", "angle from the direction in which the beam travels")
        return {
            name: (name, angles, {"long_name": label, "units": "degree"})
            for name, angles, label in zip(VIEW_AXES, self, labels, strict=True)
        }

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of polar angles and azimuths."""
        return self.polar.size, self.azimuth.size


def fold_azimuths(azimuth_deg: Any) -> Any:
    """Return azimuths from 0 to 180 degrees on the same cones around the beam."""
    turned = np.mod(azimuth_deg, 360.0)
    return np.minimum(turned, 360.0 - turned)


def drop_view_axes(grid: ParameterGrid) -> ParameterGrid:
    """Return the grid of the media and beams."""
    return grid.drop(POLAR).drop(AZIMUTH)


def list_view_axes(quantity: str) -> tuple[str, ...]:
    """Return the axes of a quantity that are directions of observation."""
    name = quantity.removesuffix("_stderr")
    if name.removeprefix(DIFFUSE_PREFIX) not in VIEW_QUANTITIES:
        return ()
    return (POLAR,) if name.startswith(DIFFUSE_PREFIX) else VIEW_AXES


def has_diffuse(quantities: Iterable[str]) -> bool:
    """Return whether any quantity is that under isotropic light beside beams."""
    return any(name.startswith(DIFFUSE_PREFIX) for name in quantities)


def check_quantities(quantities: Any, views: ViewGrid | None, covariance: bool) -> tuple[str, ...]:
    """Return the validated quantities of a table; by default those of its axes.

    Raises
    ------
    ValueError
        For unknown quantities, or directional ones without directions.
    """
    allowed = SIDE_QUANTITIES if views is None else DIRECTIONAL_QUANTITIES
    if quantities is None:
        quantities = ("reflectance",) if views is None else ("reflectance", *VIEW_QUANTITIES)
    is_list = isinstance(quantities, list | tuple) and len(quantities) > 0
    if not is_list or len(set(quantities)) < len(quantities):
        raise invalid("quantities", quantities, f"a list of different {' or '.join(allowed)}")
    for name in quantities:
        if name not in allowed:
            hint = "it needs polar_deg and azimuth_deg"
            if views is not None:
                hint = "leave out polar_deg and azimuth_deg"
            hint = hint if name in ALL_QUANTITIES else ""
            raise invalid("quantities", name, " or ".join(allowed), hint)
    if covariance and views is not None:
        raise invalid("covariance", covariance, "False for a table with directions")
    return tuple(quantities)
