"""Conversion of tables to the look-up tables of spires."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.illumination.bands import BandMatrix, check_bands
from splits.tables.axes import INCIDENCE
from splits.tables.conversions import RADIUS, select_at_fixed_axes


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
    band_by_name = check_bands(bands)
    weights = BandMatrix.from_bands(band_by_name, wavelengths).weights
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
