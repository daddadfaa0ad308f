"""Tables as other programs open them."""

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
    """Write a table as CSV: a line for each wavelength of each point, the axes as columns.

    Texts that a spreadsheet would compute begin with an apostrophe.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.build_table` returns it; deviations by group are left out.
    path : path
        The file appears whole or not at all.
    """
    names = [str(name) for name, v in dataset.data_vars.items() if "batch" not in v.dims]
    first, *others = dataset[names[0]].dims
    with atomic_write(path) as aside:
        for number in range(dataset.sizes[first]):
            # A slice at a time, as all lines together take many times the table's memory.
            part = dataset[names].isel({first: [number]}).to_dataframe()
            lines = escape_cells(part.reset_index()[[first, *others, *names]])
            lines.to_csv(aside, mode="a", header=number == 0, index=False, float_format="%.6g")


def convert_to_spires(
    dataset: xr.Dataset,
    impurity: str,
    bands: Mapping[str, Any] | str,
    per_unit: float = 1000.0,
    **at: Any,
) -> xr.DataArray:
    """Return a table as `spires.LutInterpolator` takes it: band, solar angle, dust, grain size.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of reflectance over ``incidence_deg``, ``optical_radius_um`` and an axis of impurities.
    impurity : str
        That axis.
    bands : mapping or str
        As for `splits.albedo`: the mean over each by its response.
    per_unit : float
        What one unit of dust is in the axis's: 1000 makes parts per million of ng/g.
    **at
        Where other axes are held, at one of their nodes each.

    Returns
    -------
    xarray.DataArray
        Over ``band`` (from 1 on, as spires counts them), ``solar_angle`` (degrees),
        ``dust_concentration`` and ``grain_size`` (optical radius, µm).

    Raises
    ------
    ValueError
        For an axis that is missing, or a band outside of the table.

    Examples
    --------
    With the package spires: ``spires.LutInterpolator(reflectances=a.values, bands=a.band.values,
    solar_angles=a.solar_angle.values, dust_concentrations=a.dust_concentration.values,
    grain_sizes=a.grain_size.values)`` for an array ``a``.
    """
    part = select_at_fixed_axes(
        dataset, ("reflectance",), [INCIDENCE, RADIUS, impurity], at
    ).reflectance
    w = dataset.wavelength.values
    named = as_bands(bands)
    if not named:
        raise invalid("bands", bands, "at least one band")
    weights = np.stack([compute_response_weights(name, band, w) for name, band in named.items()])
    mean = np.einsum("bw,irdw->bidr", weights, _order_spires_axes(part, impurity))
    return xr.DataArray(
        mean,
        {
            "band": np.arange(1, len(named) + 1),
            "solar_angle": part[INCIDENCE].values,
            "dust_concentration": part[impurity].values / per_unit,
            "grain_size": part[RADIUS].values,
        },
        ("band", "solar_angle", "dust_concentration", "grain_size"),
        "reflectances",
        {"long_name": "hemispherical reflectance", "units": "1", "bands": ", ".join(named)},
    )


def _order_spires_axes(part: xr.DataArray, impurity: str) -> np.ndarray:
    """Return reflectance over incidence, size, impurity and wavelength."""
    values: np.ndarray = part.transpose(INCIDENCE, RADIUS, impurity, "wavelength").values
    return values.astype(float)


def compute_response_weights(name: str, band: SpectralBand, wavelengths: np.ndarray) -> np.ndarray:
    """Return the weights of wavelengths in the mean over a band."""
    nodes = snap_to_limits(band.wavelength_nm, wavelengths[0], wavelengths[-1])
    low, high = nodes[[0, -1]].tolist()
    if low < wavelengths[0] or high > wavelengths[-1]:
        allowed = f"within the table's {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
        raise invalid(f"bands[{name!r}]", [low, high], allowed)
    inside = wavelengths[(wavelengths > low) & (wavelengths < high)]
    ends = np.unique(np.concatenate([nodes, inside]))
    # Spectrum and response are linear between these: Simpson's rule is exact.
    grid = np.stack([ends[:-1], 0.5 * (ends[:-1] + ends[1:]), ends[1:]])
    simpson = np.array([[1.0], [4.0], [1.0]]) * np.diff(ends) / 6.0
    response = np.interp(grid, nodes, band.response) * simpson
    weights = np.array(
        [(np.interp(grid, wavelengths, unit) * response).sum() for unit in np.eye(wavelengths.size)]
    )
    total: float = weights.sum()
    return weights / total


def select_at_fixed_axes(
    dataset: xr.Dataset, quantities: tuple[str, ...], free_axes: list[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the part of a table over some axes, others held at a node."""
    axes = [str(d) for d in dataset[quantities[0]].dims if d != "wavelength"]
    for name in free_axes:
        check_choice("axis", name, axes)
    at = check_axis_values(at, axes, free_axes=free_axes)
    part = dataset[list(quantities)]
    for name in axes:
        values = dataset[name].values
        if name in free_axes:
            continue
        if name not in at and values.size > 1:
            raise invalid(name, None, "given", "one of " + ", ".join(map(str, values)))
        chosen = as_scalar(at.get(name, values[0]))
        if values.dtype.kind == "f":
            near = np.isclose(values, check_number(name, chosen), rtol=ROUNDING_TOLERANCE, atol=0.0)
        else:
            near = values == str(chosen)
        found = np.flatnonzero(near)
        if not found.size:
            raise invalid(name, chosen, "one of " + ", ".join(map(str, values)))
        part = part.isel({name: int(found[0])})
    check_no_gaps("table", part)
    return part
