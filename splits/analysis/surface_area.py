"""Specific surface area of snow from measured spectra, and from one wavelength.

Where snow is clean and deep, its near-infrared reflectance depends on the surface area above all.
Reflectance that an experiment has over surface areas is interpolated between them, and the area is
sought at which a measured spectrum comes nearest.  Its level is fitted besides: slopes, roughness
and the calibration of a sensor scale a spectrum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import snowoptics
import xarray as xr
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from splits.core.validation import invalid

AREA = "specific_surface_area_m2_kg"
SHORT_WINDOWS_NM = ((700.0, 900.0), (990.0, 1090.0), (1220.0, 1300.0))
LONG_WINDOWS_NM = ((1500.0, 1750.0), (2060.0, 2350.0))
FIT_WINDOWS_NM = {
    "all": (*SHORT_WINDOWS_NM, *LONG_WINDOWS_NM),
    "below 1300 nm": SHORT_WINDOWS_NM,
    "above 1500 nm": LONG_WINDOWS_NM,
}
"""Wavelengths (nm) that are fitted: impurities count below, water vapour of the air in the gaps."""
FIELD_WAVELENGTH_NM = 1310.0
"""Where field instruments take the surface area from one reflectance (Gallet et al. 2009)."""
PUBLISHED_ALBEDO_LAWS: dict[str, Callable[..., np.ndarray]] = {
    "Kokhanovsky & Zege (2004)": snowoptics.albedo_direct_KZ04,
    "Malinka et al. (2016)": snowoptics.albedo_direct_M16,
}
"""Published laws for a beam, with the shape factors that snowoptics takes where they have any."""


class SurfaceAreaFit(NamedTuple):
    """The surface area at which modelled snow comes nearest to a spectrum.

    Attributes
    ----------
    area, scale : float
        Surface area (m²/kg), and measured over modelled reflectance.
    rmse : float
        Root-mean-square difference between the measured spectrum and level times the model.
    """

    area: float
    scale: float
    rmse: float


def fit_surface_area(
    areas: np.ndarray, modelled: np.ndarray, measured: np.ndarray, scale: float | None = None
) -> SurfaceAreaFit:
    """Return the surface area and the level that bring modelled nearest to measured reflectance.

    Parameters
    ----------
    areas : float, shape (areas,)
        Surface areas (m²/kg) in ascending order, four or more.
    modelled : float, shape (areas, wavelengths)
    measured : float, shape (wavelengths,)
    scale : float, optional
        Fitted unless it is given.
    """
    model = CubicSpline(np.log(areas), modelled)

    def at(log_area: float) -> tuple[float, float]:
        """Return the level and the root-mean-square difference."""
        shape = model(log_area)
        best = float(measured @ shape / (shape @ shape)) if scale is None else scale
        return best, float(np.sqrt(np.mean((measured - best * shape) ** 2)))

    ends = np.log(areas[[0, -1]])
    # The nearest node first: differences need not fall all the way to their least.
    best = int(np.argmin([at(node)[1] for node in np.log(areas)]))
    near = np.log(areas[[max(best - 1, 0), min(best + 1, len(areas) - 1)]])
    found = minimize_scalar(lambda x: at(x)[1], bounds=near, method="bounded",
                            options={"xatol": 1e-7})  # fmt: skip
    log_area = min((float(found.x), *ends), key=lambda x: at(x)[1])
    return SurfaceAreaFit(float(np.exp(log_area)), *at(log_area))


def retrieve_surface_areas(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return the surface area of snow from measured spectra.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` with its error and groups over surface area, ``incidence_deg`` and
        ``wavelength``.
    measured : pandas.DataFrame
        ``wavelength_nm`` and a column of reflectance for each spectrum, named by it and by the
        angle of illumination, which the dataset holds: ``ID2081@47.66``.

    Returns
    -------
    pandas.DataFrame
        Per spectrum and window: ``area`` (m²/kg) and ``level`` with the error that the model's rays
        give them, ``rmse``, and ``at_the_end``, whether it stopped at the end of the grid.  The
        level is that of all windows together: dark wavelengths alone do not tell it from the area.
    """
    rows = []
    for column in measured.columns[1:]:
        snow, values = _match_spectrum(dataset, measured, column)
        areas = snow[AREA].values.astype(float)
        groups = snow.reflectance_batches.transpose("batch", AREA, "wavelength").values
        modelled = snow.reflectance.transpose(AREA, "wavelength").values
        nodes = [modelled, *(modelled + group for group in groups)]
        levels: list[float | None] = [None] * len(nodes)
        for name, window in FIT_WINDOWS_NM.items():
            use = is_in_windows(snow.wavelength.values, window)
            fits = [
                fit_surface_area(areas, node[:, use], values[use], level)
                for node, level in zip(nodes, levels, strict=True)
            ]
            levels = [fit.scale for fit in fits]
            # What each group of rays takes off; the squares of these add up to the variance.
            off = np.subtract([fit[:2] for fit in fits[1:]], fits[0][:2])
            area_error, level_error = np.sqrt((off**2).sum(axis=0))
            area, level, rmse = fits[0]
            ends = bool(np.isclose(area, areas[[0, -1]], rtol=1e-6).any())
            rows.append((column, name, area, area_error, level, level_error, rmse, ends))
    names = ["spectrum", "window", "area", "area_stderr", "level", "level_stderr", "rmse",
               "at_the_end"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def make_overlay_table(
    dataset: xr.Dataset, measured: pd.DataFrame, areas: pd.DataFrame
) -> pd.DataFrame:
    """Return measured and modelled spectra at the surface area and level found from all windows.

    Parameters
    ----------
    dataset, measured
        As for `retrieve_surface_areas`.
    areas : pandas.DataFrame
        What it returns.

    Returns
    -------
    pandas.DataFrame
        ``spectrum``, ``area``, ``wavelength_nm``, ``measured``, ``model`` with ``stderr`` (of the
        modelled reflectance nearest in area), ``difference`` and ``fitted``, whether it was used.
    """
    tables = []
    for row in areas[areas.window == "all"].itertuples():
        snow, values = _match_spectrum(dataset, measured, str(row.spectrum))
        nodes = snow[AREA].values.astype(float)
        modelled = snow.reflectance.transpose(AREA, "wavelength").values
        model = row.level * CubicSpline(np.log(nodes), modelled)(np.log(row.area))
        nearest = int(np.argmin(np.abs(np.log(nodes / row.area))))
        stderr = row.level * snow.reflectance_stderr.transpose(AREA, "wavelength").values[nearest]
        tables.append(pd.DataFrame({
            "spectrum": row.spectrum, "area": row.area, "wavelength_nm": snow.wavelength.values,
            "measured": values, "model": model, "stderr": stderr, "difference": model - values,
            "fitted": is_in_windows(snow.wavelength.values, FIT_WINDOWS_NM["all"]),
        }))  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def make_field_table(dataset: xr.Dataset) -> pd.DataFrame:
    """Return reflectance at 1310 nm against surface area, ours and by published laws.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over ``medium`` and surface area, holding `FIELD_WAVELENGTH_NM`, under a
        beam from above.

    Returns
    -------
    pandas.DataFrame
        ``snow`` (or the law's name), ``area``, ``reflectance``, ``stderr`` (none for laws).
    """
    areas = dataset[AREA].values.astype(float)
    part = dataset.sel(wavelength=FIELD_WAVELENGTH_NM, method="nearest")
    tables = []
    for medium in dataset.medium.values:
        one = part.sel(medium=medium)
        tables.append((str(medium), one.reflectance.values, one.reflectance_stderr.values))
    for name, law in PUBLISHED_ALBEDO_LAWS.items():
        values = [
            float(law(np.array([1e-9 * FIELD_WAVELENGTH_NM]), 0.0, area)[0]) for area in areas
        ]
        tables.append((name, np.array(values), np.full(len(areas), np.nan)))
    return pd.concat(
        [pd.DataFrame({"snow": name, "area": areas, "reflectance": value, "stderr": error})
         for name, value, error in tables],
        ignore_index=True,
    )  # fmt: skip


def is_in_windows(wavelength_nm: np.ndarray, windows: Sequence[tuple[float, float]]) -> np.ndarray:
    """Tell which wavelengths lie in any of several windows (nm)."""
    return np.any([(wavelength_nm >= a) & (wavelength_nm <= b) for a, b in windows], axis=0)


def _match_spectrum(
    dataset: xr.Dataset, measured: pd.DataFrame, column: str
) -> tuple[xr.Dataset, np.ndarray]:
    """Return the part of a dataset for a spectrum's angle, and the spectrum at its wavelengths."""
    angles = dataset.incidence_deg.values
    at = [i for i, angle in enumerate(angles) if column.endswith(f"@{angle:g}")]
    if not at:
        known = " or ".join(f"@{angle:g}" for angle in angles)
        raise invalid("column", column, f"a name that ends with {known}, an angle of illumination")
    snow = dataset.isel(incidence_deg=at[0])
    given = measured.dropna(subset=[column])
    return snow, np.interp(snow.wavelength.values, given.wavelength_nm, given[column])
