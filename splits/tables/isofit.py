"""Conversion of tables to the look-up tables of isofit's surface model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.tables.axes import INCIDENCE
from splits.tables.interpolation import compute_interpolation_weights
from splits.tables.node_selection import (
    DIFFUSE_REFLECTANCE_FACTOR,
    RADIUS,
    REFLECTANCE_FACTOR,
    select_at_fixed_axes,
    select_reflectance_factor,
)
from splits.tables.views import AZIMUTH, POLAR

ISOFIT_DIMS = ("solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl")
LONG_NAMES = {
    "rho_dif_dir": "hemispherical-directional reflectance factor",
    "rho_dir_dir": "bidirectional reflectance factor",
}
AXIS_ATTRIBUTES = {
    "solar_zenith": {"units": "degree"},
    "observer_zenith": {"units": "degree"},
    "relative_azimuth": {
        "units": "degree",
        "comment": "0 is the side of the sun, i.e. backscattering",
    },
    "grain_radius": {"units": "um"},
    "wl": {"units": "nm"},
}


def convert_to_isofit(dataset: xr.Dataset, **at: Any) -> xr.Dataset:
    """Convert a table to the format of isofit's surface model.

    A table of directions has both reflectances of the format.  The diffuse-directional one is the
    variable ``diffuse_reflectance_factor`` of the table.  If the table does not have this
    variable, it follows by reciprocity: the reflectance of diffuse light into a direction equals
    that of a beam from that direction into all directions.  Snow of the interpretation
    ``radiative_transfer`` is reciprocal.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over ``incidence_deg`` and ``optical_radius_um``, or a table of directions
        with ``reflectance_factor`` over ``incidence_deg``, ``polar_deg``, ``azimuth_deg`` and
        ``optical_radius_um``.
    **at
        Node of each other axis of the table.

    Returns
    -------
    xarray.Dataset
        Variables over ``solar_zenith``, ``observer_zenith``, ``relative_azimuth`` (degrees; 180
        minus the azimuth of this package, so that 0 is the side of the sun), ``grain_radius`` (µm)
        and ``wl`` (nm): the hemispherical-directional reflectance factor ``rho_dif_dir``, which
        does not depend on the solar zenith angle and the azimuth, and for a table of directions
        the bidirectional reflectance factor ``rho_dir_dir`` of scattered light.
        ``statevec_names`` names the retrieved parameters, as isofit requires.

    Raises
    ------
    ValueError
        For a missing axis, an angle with fewer than two nodes, azimuths that do not extend from 0°
        to 180°, gaps, or, by reciprocity, polar angles beyond the angles of incidence.
    """
    if REFLECTANCE_FACTOR in dataset:
        return _convert_directions(dataset, at)
    subset = select_at_fixed_axes(dataset, ("reflectance",), [INCIDENCE, RADIUS], at).reflectance
    subset = subset.transpose(INCIDENCE, RADIUS, "wavelength")
    zenith, sizes = subset[INCIDENCE].values, subset[RADIUS].values
    axes = _make_axes(zenith, zenith, np.array([0.0, 180.0]), sizes, subset.wavelength.values)
    values = {"rho_dif_dir": _broadcast_over_axes(subset.values, axes)}
    return _make_isofit_dataset(values, axes, dataset)


def _convert_directions(dataset: xr.Dataset, at: Mapping[str, Any]) -> xr.Dataset:
    """Return a table of directions in the format of isofit."""
    factor = select_reflectance_factor(dataset, at, [RADIUS])[REFLECTANCE_FACTOR]
    # Azimuths in descending order, so that relative azimuths increase.
    factor = factor.isel({AZIMUTH: slice(None, None, -1)}).sortby(RADIUS)
    axes = _make_axes(
        factor[INCIDENCE].values,
        factor[POLAR].values,
        180.0 - factor[AZIMUTH].values,
        factor[RADIUS].values,
        factor.wavelength.values,
    )
    diffuse = _select_diffuse_factor(dataset, at, axes["observer_zenith"])
    values = {"rho_dif_dir": _broadcast_over_axes(diffuse, axes), "rho_dir_dir": factor.values}
    return _make_isofit_dataset(values, axes, dataset)


def _select_diffuse_factor(
    dataset: xr.Dataset, at: Mapping[str, Any], polar_deg: np.ndarray
) -> np.ndarray:
    """Return the reflectance of diffuse light over polar angle, size and wavelength."""
    if DIFFUSE_REFLECTANCE_FACTOR in dataset:
        name, angle = DIFFUSE_REFLECTANCE_FACTOR, POLAR
    elif "reflectance" in dataset:
        name, angle = "reflectance", INCIDENCE
    else:
        allowed = f"with {DIFFUSE_REFLECTANCE_FACTOR}, or with reflectance"
        raise invalid("table", list(map(str, dataset.data_vars)), allowed)
    subset = select_at_fixed_axes(dataset, (name,), [angle, RADIUS], at)[name]
    subset = subset.sortby([angle, RADIUS]).transpose(angle, RADIUS, "wavelength")
    if angle == POLAR:
        values: np.ndarray = subset.values
        return values
    limits = subset[INCIDENCE].values[[0, -1]]
    if polar_deg[0] < limits[0] or polar_deg[-1] > limits[1]:
        allowed = f"from {limits[0]:g} to {limits[1]:g}, as far as {INCIDENCE} goes"
        hint = f"or a table with {DIFFUSE_REFLECTANCE_FACTOR}"
        raise invalid(POLAR, polar_deg.tolist(), allowed, hint)
    weights = [
        compute_interpolation_weights(INCIDENCE, subset[INCIDENCE].values, x) for x in polar_deg
    ]
    return np.stack([np.tensordot(w.weights, subset.values[w.nodes], 1) for w in weights])


def _make_axes(*values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the axes of the format by name."""
    return dict(zip(ISOFIT_DIMS, values, strict=True))


def _broadcast_over_axes(values: np.ndarray, axes: dict[str, np.ndarray]) -> np.ndarray:
    """Return values over observer angle, size and wavelength broadcast over all axes."""
    shape = tuple(axis.size for axis in axes.values())
    return np.broadcast_to(values[np.newaxis, :, np.newaxis], shape)


def _make_isofit_dataset(
    values: dict[str, np.ndarray], axes: dict[str, np.ndarray], dataset: xr.Dataset
) -> xr.Dataset:
    """Return the dataset with the names, units and attributes of the format."""
    state = {"statevec_names": ("n_state", ["grain_radius"])}
    return xr.Dataset(
        state
        | {
            name: (ISOFIT_DIMS, v.astype(np.float32), {"long_name": LONG_NAMES[name], "units": "1"})
            for name, v in values.items()
        },
        {name: (name, axis, AXIS_ATTRIBUTES[name]) for name, axis in axes.items()},
        {"title": "Surface table for isofit", "source": dataset.attrs.get("source", "splits")},
    )
