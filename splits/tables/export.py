"""Export of tables to CSV and to spires."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.atomic import atomic_write
from splits.core.escaping import escape_cells
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_choice,
    check_number,
    invalid,
    snap_to_limits,
)
from splits.illumination.bands import SpectralBand, as_bands
from splits.tables.axes import INCIDENCE, check_axis_values

RADIUS = "optical_radius_um"


def write_csv(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a table as CSV, with one row per wavelength and point and the axes as columns.

    All quantities of a table of directions are in the same file.  A quantity that does not depend
    on an axis, such as ``reflectance`` on the angles of view, is repeated along this axis.  Text
    that a spreadsheet would evaluate as a formula gets an apostrophe in front.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.build_table`; deviations by batch are omitted.
    path : path
        Output file, written atomically.
    """
    names = [str(name) for name, v in dataset.data_vars.items() if "batch" not in v.dims]
    by_number_of_axes = sorted(names, key=lambda name: -dataset[name].ndim)
    dims = [str(dim) for name in by_number_of_axes for dim in dataset[name].dims]
    axes = [*dict.fromkeys(dim for dim in dims if dim != "wavelength"), "wavelength"]
    with atomic_write(path) as temporary:
        for number in range(dataset.sizes[axes[0]]):
            # One slice at a time: all rows together need many times the memory of the table.
            frame = dataset[names].isel({axes[0]: [number]}).to_dataframe(dim_order=axes)
            rows = escape_cells(frame.reset_index()[[*axes, *names]])
            rows.to_csv(temporary, mode="a", header=number == 0, index=False, float_format="%.6g")


def convert_to_spires(
    dataset: xr.Dataset,
    impurity: str,
    bands: Mapping[str, Any] | str,
    per_unit: float = 1000.0,
    **at: Any,
) -> xr.DataArray:
    """Convert a table to the input of `spires.LutInterpolator`.

    Parameters
    ----------
    dataset : xarray.Dataset
        Reflectance over ``incidence_deg``, ``optical_radius_um`` and an axis of impurities.
    impurity : str
        Name of the axis of impurities.
    bands : mapping or str
        Spectral bands as for `splits.albedo`; reflectance is averaged over each response.
    per_unit : float
        Value on the axis of one unit of dust concentration; 1000 converts ng/g to parts per
        million.
    **at
        Node of each other axis of the table.

    Returns
    -------
    xarray.DataArray
        Reflectance over ``band`` (numbered from 1, as in spires), ``solar_angle`` (degrees),
        ``dust_concentration`` and ``grain_size`` (optical radius, µm).

    Raises
    ------
    ValueError
        For a missing axis, or a band outside the table.

    Examples
    --------
    With the package spires: ``spires.LutInterpolator(reflectances=a.values, bands=a.band.values,
    solar_angles=a.solar_angle.values, dust_concentrations=a.dust_concentration.values,
    grain_sizes=a.grain_size.values)`` for an array ``a``.
    """
    subset = select_at_fixed_axes(
        dataset, ("reflectance",), [INCIDENCE, RADIUS, impurity], at
    ).reflectance
    wavelengths = dataset.wavelength.values
    band_by_name = as_bands(bands)
    if not band_by_name:
        raise invalid("bands", bands, "at least one band")
    weights = np.stack(
        [compute_response_weights(name, band, wavelengths) for name, band in band_by_name.items()]
    )
    mean = np.einsum("bw,irdw->bidr", weights, _order_spires_axes(subset, impurity))
    return xr.DataArray(
        mean,
        {
            "band": np.arange(1, len(band_by_name) + 1),
            "solar_angle": subset[INCIDENCE].values,
            "dust_concentration": subset[impurity].values / per_unit,
            "grain_size": subset[RADIUS].values,
        },
        ("band", "solar_angle", "dust_concentration", "grain_size"),
        "reflectances",
        {"long_name": "hemispherical reflectance", "units": "1", "bands": ", ".join(band_by_name)},
    )


def _order_spires_axes(part: xr.DataArray, impurity: str) -> np.ndarray:
    """Return reflectance as an array over incidence, size, impurity and wavelength."""
    values: np.ndarray = part.transpose(INCIDENCE, RADIUS, impurity, "wavelength").values
    return values.astype(float)


def compute_response_weights(name: str, band: SpectralBand, wavelengths: np.ndarray) -> np.ndarray:
    """Return the weights of the wavelengths in the response-weighted mean over a band."""
    nodes = snap_to_limits(band.wavelength_nm, wavelengths[0], wavelengths[-1])
    low, high = nodes[[0, -1]].tolist()
    if low < wavelengths[0] or high > wavelengths[-1]:
        allowed = f"within the table's {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
        raise invalid(f"bands[{name!r}]", [low, high], allowed)
    inside = wavelengths[(wavelengths > low) & (wavelengths < high)]
    breakpoints = np.unique(np.concatenate([nodes, inside]))
    # Spectrum and response are both linear between these points, so Simpson's rule is exact.
    grid = np.stack([breakpoints[:-1], 0.5 * (breakpoints[:-1] + breakpoints[1:]), breakpoints[1:]])
    simpson = np.array([[1.0], [4.0], [1.0]]) * np.diff(breakpoints) / 6.0
    response = np.interp(grid, nodes, band.response) * simpson
    weights = np.array(
        [(np.interp(grid, wavelengths, unit) * response).sum() for unit in np.eye(wavelengths.size)]
    )
    total: float = weights.sum()
    return weights / total


def select_at_fixed_axes(
    dataset: xr.Dataset, quantities: tuple[str, ...], free_axes: list[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the part of a table over the free axes, with the other axes at a node."""
    axes = [str(d) for d in dataset[quantities[0]].dims if d != "wavelength"]
    for name in free_axes:
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
