"""Tables 1 and 3 of SPLITSnow."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.measured import compare_with_spectrum

TABLE1_LABELS = {
    "snow_grain_size_um": "grain size min, max (µm)",
    "snow_saturation": "water saturation",
    "snow_facetness": "facetness min, max, mean, sd",
    "snow_sphericity": "sphericity min, max, mean, sd",
    "snow_temperature_c": "temperature (°C)",
    "snow_depth_m": "depth (m)",
    "incidence_deg": "angle of incidence (°)",
}


def make_table1(sample: xr.Dataset) -> pd.DataFrame:
    """Return the inputs and derived quantities of the representative sample (Table 1)."""
    rows = [
        (label, ", ".join(f"{v:g}" for v in np.atleast_1d(sample.attrs[key])))
        for key, label in TABLE1_LABELS.items()
    ]
    for density in sample.density_kg_m3.values:
        part = sample.sel(density_kg_m3=density)
        distance = 1e3 * float(part.mean_grain_distance)
        rows.append((f"mean grain distance at {density:g} kg m⁻³ (mm)", f"{distance:.4f}"))
    area = float(sample.specific_surface_area.isel(density_kg_m3=0))
    rows.append(("specific surface area (m² kg⁻¹)", f"{area:.2f}"))
    return pd.DataFrame(rows, columns=["quantity", "value"])


def make_table3(
    interpretations: xr.Dataset, aviris: pd.DataFrame, published: pd.DataFrame
) -> pd.DataFrame:
    """Return measured, published and our reflectance in the AVIRIS-NG bands (Table 3).

    Parameters
    ----------
    interpretations : xarray.Dataset
        Reflectance over ``wavelength`` and ``interpretation``.
    aviris : pandas.DataFrame
        Measured bands.
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    """
    names = [name for name in published.index if str(name).startswith("table3_")]
    tables = []
    for name in interpretations.interpretation.values:
        table = compare_with_spectrum(interpretations.sel(interpretation=name), aviris)
        table.insert(0, "interpretation", name)
        table["relative_difference_percent"] = 100 * table.difference / table.measured
        table["published_model"] = published.loc[names].published.to_numpy()
        table["difference_to_published"] = table.model - table.published_model
        tables.append(table)
    return pd.concat(tables, ignore_index=True)
