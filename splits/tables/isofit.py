"""Tables as isofit's surface model looks them up."""

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
    """Return a table as isofit's surface model looks it up.

    The reflectance of diffuse light into a direction is, by reciprocity, that of a beam from there
    to all directions.  Snow whose readings are ``radiative_transfer`` is reciprocal.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of reflectance over ``incidence_deg`` and ``optical_radius_um``.
    directions : xarray.Dataset, optional
        Runs of `splits.goniophotometer`, joined over ``optical_radius_um`` and ``incidence_deg``
        (see `xarray.combine_nested`), at sizes and wavelengths of the table: with them the result
        has ``rho_dir_dir``, at their angles and wavelengths.
    **at
        Where other axes of the table are held, at one of their nodes each.

    Returns
    -------
    xarray.Dataset
        Over ``solar_zenith``, ``observer_zenith``, ``relative_azimuth`` (degrees, 0 where the
        observer stands on the sun's side: 180 less our azimuth), ``grain_radius`` (µm) and ``wl``
        (nm): ``rho_dif_dir``, alike for every sun, as no beam is in it; and ``rho_dir_dir``, the
        bidirectional reflectance factor, of light that met a grain; ``statevec_names``, which
        isofit asks for: what is retrieved.

    Raises
    ------
    ValueError
        For an axis that is missing, or directions that the table does not reach.
    """
    part = select_at_fixed_axes(dataset, ("reflectance",), [INCIDENCE, RADIUS], at).reflectance
    part = part.transpose(INCIDENCE, RADIUS, "wavelength")
    if directions is None:
        zenith = part[INCIDENCE].values
        axes = dict(zip(ISOFIT_DIMS, (zenith, zenith, np.array([0.0, 180.0]), part[RADIUS].values,
                               part.wavelength.values), strict=True))  # fmt: skip
        return _make_isofit_dataset(
            {"rho_dif_dir": _broadcast_over_axes(part.values, axes)}, axes, dataset
        )
    factor = _order_reflectance_factor(directions)
    axes = {
        "solar_zenith": factor[INCIDENCE].values,
        "observer_zenith": factor.polar.values,
        "relative_azimuth": 180.0 - factor.azimuth.values,
        "grain_radius": _match_nodes(factor, part, RADIUS),
        "wl": _match_nodes(factor, part, "wavelength"),
    }
    part = part.sel({RADIUS: axes["grain_radius"], "wavelength": axes["wl"]})
    seen = [
        compute_interpolation_weights(INCIDENCE, part[INCIDENCE].values, x)
        for x in axes["observer_zenith"]
    ]
    diffuse = np.stack([np.tensordot(w.weights, part.values[w.nodes], 1) for w in seen])
    both = {"rho_dif_dir": _broadcast_over_axes(diffuse, axes), "rho_dir_dir": factor.values}
    return _make_isofit_dataset(both, axes, dataset)


def _order_reflectance_factor(directions: xr.Dataset) -> xr.DataArray:
    """Return reflectance factors over the axes of the format: half a turn, backwards first."""
    dims = (INCIDENCE, "polar", "azimuth", RADIUS, "wavelength")
    if "reflectance_factor" not in directions or set(directions.reflectance_factor.dims) != {*dims}:
        found = list(directions.sizes)
        raise invalid("directions", found, f"reflectance_factor over {', '.join(dims)}")
    check_no_gaps("directions", directions.reflectance_factor)
    factor = directions.reflectance_factor.transpose(*dims)
    half = factor.sel(azimuth=factor.azimuth.values <= 180.0)
    # Backwards first, whose relative azimuth is the least.
    return half.sortby([*dims]).isel(azimuth=slice(None, None, -1))


def _match_nodes(factor: xr.DataArray, table_part: xr.DataArray, name: str) -> np.ndarray:
    """Return the nodes of the table that directions were measured at, or refuse others."""
    wanted, there = factor[name].values, table_part[name].values
    near = np.abs(there[:, np.newaxis] - wanted).argmin(axis=0)
    if not np.allclose(there[near], wanted, rtol=1e-9, atol=0.0):
        raise invalid(f"directions.{name}", wanted.tolist(), f"among the table's, {there.tolist()}")
    nodes: np.ndarray = there[near]
    return nodes


def _broadcast_over_axes(values: np.ndarray, axes: dict[str, np.ndarray]) -> np.ndarray:
    """Return what depends on the observer's angle, size and wavelength, over all axes."""
    shape = tuple(axis.size for axis in axes.values())
    return np.broadcast_to(values[np.newaxis, :, np.newaxis], shape)


def _make_isofit_dataset(
    values: dict[str, np.ndarray], axes: dict[str, np.ndarray], dataset: xr.Dataset
) -> xr.Dataset:
    """Return variables with the names, units and texts of the format."""
    about = {
        "rho_dif_dir": "hemispherical-directional reflectance factor",
        "rho_dir_dir": "bidirectional reflectance factor",
    }
    turned = "0 is towards the sun's own side: backscattering"
    units = {
        "solar_zenith": {"units": "degree"},
        "observer_zenith": {"units": "degree"},
        "relative_azimuth": {"units": "degree", "comment": turned},
        "grain_radius": {"units": "um"},
        "wl": {"units": "nm"},
    }
    state = {"statevec_names": ("n_state", ["GRAIN_RADIUS"])}
    return xr.Dataset(
        state
        | {
            name: (ISOFIT_DIMS, v, {"long_name": about[name], "units": "1"})
            for name, v in values.items()
        },
        {name: (name, axis, units[name]) for name, axis in axes.items()},
        {"title": "Surface table for isofit", "source": dataset.attrs.get("source", "splits")},
    )
