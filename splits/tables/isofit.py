"""Conversion of tables to the look-up tables of isofit's surface model."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.validation import invalid
from splits.tables.axes import INCIDENCE
from splits.tables.export import RADIUS, select_at_fixed_axes
from splits.tables.interpolation import compute_interpolation_weights

ISOFIT_DIMS = ("solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl")


def convert_to_isofit(
    dataset: xr.Dataset, directions: xr.Dataset | None = None, **at: Any
) -> xr.Dataset:
    """Convert a table to the format of isofit's surface model.

    By reciprocity, the reflectance of diffuse light into a direction equals that of a beam from
    that direction into all directions.  Snow of the interpretation ``radiative_transfer`` is
    reciprocal.

    Parameters
    ----------
    dataset : xarray.Dataset
        Reflectance over ``incidence_deg`` and ``optical_radius_um``.
    directions : xarray.Dataset, optional
        Results of `splits.goniophotometer`, combined over ``optical_radius_um`` and
        ``incidence_deg`` (see `xarray.combine_nested`), at sizes and wavelengths of the table.
        With them the result includes ``rho_dir_dir`` at their angles and wavelengths.
    **at
        Node of each other axis of the table.

    Returns
    -------
    xarray.Dataset
        Variables over ``solar_zenith``, ``observer_zenith``, ``relative_azimuth`` (degrees; 180
        minus the azimuth of this package, so that 0 is the side of the sun), ``grain_radius`` (µm)
        and ``wl`` (nm): the hemispherical-directional reflectance factor
        ``rho_dif_dir``, which does not depend on the solar zenith angle, and the bidirectional
        reflectance factor ``rho_dir_dir`` of scattered light.  ``statevec_names`` names the
        retrieved parameters, as isofit requires.

    Raises
    ------
    ValueError
        For a missing axis, or directions outside the table.
    """
    subset = select_at_fixed_axes(dataset, ("reflectance",), [INCIDENCE, RADIUS], at).reflectance
    subset = subset.transpose(INCIDENCE, RADIUS, "wavelength")
    if directions is None:
        zenith = subset[INCIDENCE].values
        axes = dict(zip(ISOFIT_DIMS, (zenith, zenith, np.array([0.0, 180.0]), subset[RADIUS].values,
                               subset.wavelength.values), strict=True))  # fmt: skip
        return _make_isofit_dataset(
            {"rho_dif_dir": _broadcast_over_axes(subset.values, axes)}, axes, dataset
        )
    factor = _order_reflectance_factor(directions)
    axes = {
        "solar_zenith": factor[INCIDENCE].values,
        "observer_zenith": factor.polar.values,
        "relative_azimuth": 180.0 - factor.azimuth.values,
        "grain_radius": _match_nodes(factor, subset, RADIUS),
        "wl": _match_nodes(factor, subset, "wavelength"),
    }
    subset = subset.sel({RADIUS: axes["grain_radius"], "wavelength": axes["wl"]})
    observer_weights = [
        compute_interpolation_weights(INCIDENCE, subset[INCIDENCE].values, x)
        for x in axes["observer_zenith"]
    ]
    diffuse = np.stack(
        [np.tensordot(w.weights, subset.values[w.nodes], 1) for w in observer_weights]
    )
    variables = {"rho_dif_dir": _broadcast_over_axes(diffuse, axes), "rho_dir_dir": factor.values}
    return _make_isofit_dataset(variables, axes, dataset)


def _order_reflectance_factor(directions: xr.Dataset) -> xr.DataArray:
    """Return reflectance factors over the axes of the format, by increasing relative azimuth."""
    dims = (INCIDENCE, "polar", "azimuth", RADIUS, "wavelength")
    if "reflectance_factor" not in directions or set(directions.reflectance_factor.dims) != {*dims}:
        sizes = list(directions.sizes)
        raise invalid("directions", sizes, f"reflectance_factor over {', '.join(dims)}")
    check_no_gaps("directions", directions.reflectance_factor)
    factor = directions.reflectance_factor.transpose(*dims)
    half = factor.sel(azimuth=factor.azimuth.values <= 180.0)
    # Azimuths in descending order, so that relative azimuths increase.
    return half.sortby([*dims]).isel(azimuth=slice(None, None, -1))


def _match_nodes(factor: xr.DataArray, table_part: xr.DataArray, name: str) -> np.ndarray:
    """Return the nodes of the table that match the coordinates of directions."""
    target, table_nodes = factor[name].values, table_part[name].values
    nearest = np.abs(table_nodes[:, np.newaxis] - target).argmin(axis=0)
    if not np.allclose(table_nodes[nearest], target, rtol=1e-9, atol=0.0):
        raise invalid(
            f"directions.{name}", target.tolist(), f"among the table's, {table_nodes.tolist()}"
        )
    nodes: np.ndarray = table_nodes[nearest]
    return nodes


def _broadcast_over_axes(values: np.ndarray, axes: dict[str, np.ndarray]) -> np.ndarray:
    """Return values over observer angle, size and wavelength broadcast over all axes."""
    shape = tuple(axis.size for axis in axes.values())
    return np.broadcast_to(values[np.newaxis, :, np.newaxis], shape)


def _make_isofit_dataset(
    values: dict[str, np.ndarray], axes: dict[str, np.ndarray], dataset: xr.Dataset
) -> xr.Dataset:
    """Return the dataset with the names, units and attributes of the format."""
    long_names = {
        "rho_dif_dir": "hemispherical-directional reflectance factor",
        "rho_dir_dir": "bidirectional reflectance factor",
    }
    azimuth_comment = "0 is the side of the sun, i.e. backscattering"
    units = {
        "solar_zenith": {"units": "degree"},
        "observer_zenith": {"units": "degree"},
        "relative_azimuth": {"units": "degree", "comment": azimuth_comment},
        "grain_radius": {"units": "um"},
        "wl": {"units": "nm"},
    }
    state = {"statevec_names": ("n_state", ["GRAIN_RADIUS"])}
    return xr.Dataset(
        state
        | {
            name: (ISOFIT_DIMS, v, {"long_name": long_names[name], "units": "1"})
            for name, v in values.items()
        },
        {name: (name, axis, units[name]) for name, axis in axes.items()},
        {"title": "Surface table for isofit", "source": dataset.attrs.get("source", "splits")},
    )
