"""Specific surface area of snow from measured spectra, and from reflectance at 1310 nm.

The near-infrared reflectance of clean, deep snow depends mainly on the surface area.  Simulated
reflectance is interpolated between surface areas and fitted to a measured spectrum together with a
scale factor, which accounts for slopes, roughness and the calibration of the sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import snowoptics
import xarray as xr
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from splits.core.escaping import escape_mathtext
from splits.core.uncertainty import compute_remaining_error
from splits.core.validation import invalid
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    annotate_figure,
    describe_conditions,
    make_subplots,
    pick_colours,
    start_at_zero,
    use_style,
)
from workflow.papers.statements import require, require_columns

AREA = "specific_surface_area_m2_kg"
SHORT_WINDOWS_NM = ((700.0, 900.0), (990.0, 1090.0), (1220.0, 1300.0))
LONG_WINDOWS_NM = ((1500.0, 1750.0), (2060.0, 2350.0))
FIT_WINDOWS_NM = {
    "all": (*SHORT_WINDOWS_NM, *LONG_WINDOWS_NM),
    "below 1300 nm": SHORT_WINDOWS_NM,
    "above 1500 nm": LONG_WINDOWS_NM,
}
"""Fitted wavelengths (nm), without the range of impurities and the bands of water vapour."""
FIELD_WAVELENGTH_NM = 1310.0
"""Wavelength of field instruments for the surface area (Gallet et al. 2009)."""
PUBLISHED_ALBEDO_LAWS: dict[str, Callable[..., np.ndarray]] = {
    "Kokhanovsky & Zege (2004)": snowoptics.albedo_direct_KZ04,
    "Malinka et al. (2016)": snowoptics.albedo_direct_M16,
}
"""Published laws for a beam, with the default shape factors of snowoptics."""


def make_surface_areas(*, modelled: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return the surface areas of measured snow, see `retrieve_surface_areas`."""
    return retrieve_surface_areas(*_require_spectra(modelled, measured))


def draw_surface_areas(*, modelled: xr.Dataset, measured: pd.DataFrame) -> Figure:
    """Draw measured spectra and those of modelled snow with the retrieved surface areas."""
    modelled, measured = _require_spectra(modelled, measured)
    areas = retrieve_surface_areas(modelled, measured)
    table = make_overlay_table(modelled, measured, areas)
    return draw_fitted_spectra(table, describe_conditions(modelled))


def _require_spectra(
    modelled: xr.Dataset, measured: pd.DataFrame
) -> tuple[xr.Dataset, pd.DataFrame]:
    """Return modelled and measured spectra; reject unsuitable ones."""
    axes, band_nm = (AREA, "incidence_deg"), (700.0, 2400.0)
    modelled = require("modelled", modelled, "reflectance", axes, band_nm=band_nm)
    return modelled, require_columns("measured.measured", measured, ("wavelength_nm",))


def make_area_law(*, natural: xr.Dataset, spheres: xr.Dataset) -> tuple[pd.DataFrame, Figure]:
    """Return the table and the figure of reflectance at 1310 nm against surface area."""
    runs = {"natural snow": ("natural", natural), "smooth spheres": ("spheres", spheres)}
    table = make_field_table(
        {
            name: require(key, run, "reflectance", (AREA,), at_nm=(FIELD_WAVELENGTH_NM,))
            for name, (key, run) in runs.items()
        }
    )
    return table, draw_area_law(table, describe_conditions(natural, band="bars"))


class SurfaceAreaFit(NamedTuple):
    """Fit of the surface area of modelled snow to a spectrum.

    Attributes
    ----------
    area, scale : float
        Surface area (m²/kg), and ratio of measured to modelled reflectance.
    rmse : float
        Root-mean-square difference between the measured and the scaled modelled spectrum.
    """

    area: float
    scale: float
    rmse: float


def fit_surface_area(
    areas: np.ndarray, modelled: np.ndarray, measured: np.ndarray, scale: float | None = None
) -> SurfaceAreaFit:
    """Return the least-squares surface area and scale of modelled to measured reflectance.

    Parameters
    ----------
    areas : float, shape (areas,)
        Surface areas (m²/kg) in ascending order, four or more.
    modelled : float, shape (areas, wavelengths)
    measured : float, shape (wavelengths,)
    scale : float, optional
        Fixed scale; by default it is fitted.
    """
    model = CubicSpline(np.log(areas), modelled)

    def evaluate(log_area: float) -> tuple[float, float]:
        """Return the scale and the root-mean-square difference."""
        shape = model(log_area)
        best = float(measured @ shape / (shape @ shape)) if scale is None else scale
        return best, float(np.sqrt(np.mean((measured - best * shape) ** 2)))

    bounds = np.log(areas[[0, -1]])
    # Start from the nearest node, since the difference may have several minima.
    best = int(np.argmin([evaluate(node)[1] for node in np.log(areas)]))
    bracket = np.log(areas[[max(best - 1, 0), min(best + 1, len(areas) - 1)]])
    optimum = minimize_scalar(lambda x: evaluate(x)[1], bounds=bracket, method="bounded",
                            options={"xatol": 1e-7})  # fmt: skip
    log_area = min((float(optimum.x), *bounds), key=lambda x: evaluate(x)[1])
    return SurfaceAreaFit(float(np.exp(log_area)), *evaluate(log_area))


def bound_fit_errors(
    areas: np.ndarray, modelled: np.ndarray, errors: np.ndarray, fit: SurfaceAreaFit,
    scale_bound: float | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Return bounds on the errors of area and scale for modelled errors of any correlation.

    Parameters
    ----------
    areas : float, shape (areas,)
        Surface areas (m²/kg).
    modelled, errors : float, shape (areas, wavelengths)
        Reflectance and its errors.
    fit : SurfaceAreaFit
    scale_bound : float, optional
        Bound on the error of a fixed scale; by default, the scale is fitted, too.
    """
    model, log_area = CubicSpline(np.log(areas), modelled), np.log(fit.area)
    shape, slope = model(log_area), fit.scale * model(log_area, 1)
    nearest = int(np.argmin(np.abs(np.log(areas) - log_area)))
    changes = fit.scale * errors[nearest]
    if scale_bound is None:
        area_change, scale_bound = (
            np.abs(np.linalg.pinv(np.stack([slope, shape], axis=1))) @ changes
        )
        return fit.area * float(area_change), float(scale_bound)
    response = np.abs(slope) @ changes + abs(slope @ shape) * scale_bound
    return fit.area * float(response / (slope @ slope)), scale_bound


def retrieve_surface_areas(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return the surface areas of snow from measured spectra.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` with its error and batches over surface area, ``incidence_deg`` and
        ``wavelength``.
    measured : pandas.DataFrame
        ``wavelength_nm`` and a column of reflectance for each spectrum.  Its name contains the
        incidence, a value of the dataset: ``ID2081@47.66``.

    Returns
    -------
    pandas.DataFrame
        Per spectrum and window: ``area`` (m²/kg) and ``scale`` with their errors from
        those of the model, ``rmse``, and ``at_the_end``, whether the area is at the end of the
        grid.  The scale is that of all windows, since strongly absorbed wavelengths alone do not
        separate it from the area.
    """
    rows = []
    for column in measured.columns[1:]:
        snow, values = _match_spectrum(dataset, measured, column)
        areas = snow[AREA].values.astype(float)
        # Discrete ordinates have no batches.
        none = snow.reflectance.expand_dims(batch=0)
        deviations = snow.get("reflectance_batches", none).astype(float)
        batches = deviations.transpose("batch", AREA, "wavelength").values
        modelled = snow.reflectance.transpose(AREA, "wavelength").values
        remaining = compute_remaining_error(snow.reflectance_stderr, deviations)
        bounds = remaining.transpose(AREA, "wavelength").values
        nodes = [modelled, *(modelled + batch for batch in batches)]
        scales: list[float | None] = [None] * len(nodes)
        scale_bound: float | None = None
        for name, window in FIT_WINDOWS_NM.items():
            is_fitted = is_in_windows(snow.wavelength.values, window)
            fits = [
                fit_surface_area(areas, node[:, is_fitted], values[is_fitted], scale)
                for node, scale in zip(nodes, scales, strict=True)
            ]
            scales = [fit.scale for fit in fits]
            # Batch deviations, whose squares add up to the variance.
            changes = np.array([fit[:2] for fit in fits])[1:] - fits[0][:2]
            area_bound, scale_bound = bound_fit_errors(
                areas, modelled[:, is_fitted], bounds[:, is_fitted], fits[0], scale_bound
            )
            area_error, scale_error = np.sqrt(
                (changes**2).sum(axis=0) + np.square([area_bound, scale_bound])
            )
            area, scale, rmse = fits[0]
            is_at_end = bool(np.isclose(area, areas[[0, -1]], rtol=1e-6).any())
            rows.append((column, name, area, area_error, scale, scale_error, rmse, is_at_end))
    names = ["spectrum", "window", "area", "area_stderr", "scale", "scale_stderr", "rmse",
               "at_the_end"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def make_overlay_table(
    dataset: xr.Dataset, measured: pd.DataFrame, areas: pd.DataFrame
) -> pd.DataFrame:
    """Return measured and modelled spectra at the surface area and scale from all windows.

    Parameters
    ----------
    dataset, measured
        As for `retrieve_surface_areas`.
    areas : pandas.DataFrame
        Output of `retrieve_surface_areas`.

    Returns
    -------
    pandas.DataFrame
        ``spectrum``, ``area``, ``wavelength_nm``, ``measured``, ``model`` with ``stderr`` (of the
        modelled reflectance at the nearest node), ``difference`` and ``fitted``.
    """
    tables = []
    for row in areas[areas.window == "all"].itertuples():
        snow, values = _match_spectrum(dataset, measured, str(row.spectrum))
        nodes = snow[AREA].values.astype(float)
        modelled = snow.reflectance.transpose(AREA, "wavelength").values
        model = row.scale * CubicSpline(np.log(nodes), modelled)(np.log(row.area))
        nearest = int(np.argmin(np.abs(np.log(nodes / row.area))))
        stderr = row.scale * snow.reflectance_stderr.transpose(AREA, "wavelength").values[nearest]
        tables.append(pd.DataFrame({
            "spectrum": row.spectrum, "area": row.area, "wavelength_nm": snow.wavelength.values,
            "measured": values, "model": model, "stderr": stderr, "difference": model - values,
            "fitted": is_in_windows(snow.wavelength.values, FIT_WINDOWS_NM["all"]),
        }))  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def make_field_table(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return reflectance at 1310 nm against surface area, simulated and by published laws.

    Parameters
    ----------
    datasets : mapping of str to xarray.Dataset
        ``reflectance`` over surface area at `FIELD_WAVELENGTH_NM`, for normal incidence, by the
        name of the snow.  The laws are at the surface areas of the first.

    Returns
    -------
    pandas.DataFrame
        ``snow`` (or the law's name), ``area``, ``reflectance``, ``stderr`` (none for laws).
    """
    tables = []
    for name, dataset in datasets.items():
        snow = dataset.sel(wavelength=FIELD_WAVELENGTH_NM, method="nearest")
        tables.append((name, snow[AREA].values, snow.reflectance.values,
                       snow.reflectance_stderr.values))  # fmt: skip
    areas = tables[0][1].astype(float)
    for name, law in PUBLISHED_ALBEDO_LAWS.items():
        values = [
            float(law(np.array([1e-9 * FIELD_WAVELENGTH_NM]), 0.0, area)[0]) for area in areas
        ]
        tables.append((name, areas, np.array(values), np.full(len(areas), np.nan)))
    columns = ("snow", "area", "reflectance", "stderr")
    return pd.concat(
        [pd.DataFrame(dict(zip(columns, table, strict=True))) for table in tables],
        ignore_index=True,
    )


def is_in_windows(wavelength_nm: np.ndarray, windows: Sequence[tuple[float, float]]) -> np.ndarray:
    """Return which wavelengths are in any of several windows (nm)."""
    return np.any(
        [(wavelength_nm >= low) & (wavelength_nm <= high) for low, high in windows], axis=0
    )


def _match_spectrum(
    dataset: xr.Dataset, measured: pd.DataFrame, column: str
) -> tuple[xr.Dataset, np.ndarray]:
    """Return the dataset at the incidence of a spectrum, and the spectrum at its wavelengths."""
    angles = dataset.incidence_deg.values
    matches = [i for i, angle in enumerate(angles) if column.endswith(f"@{angle:g}")]
    if not matches:
        suffixes = " or ".join(f"@{angle:g}" for angle in angles)
        raise invalid("column", column, f"a name that ends with {suffixes}, an incidence")
    snow = dataset.isel(incidence_deg=matches[0])
    spectrum = measured.dropna(subset=[column])
    return snow, np.interp(snow.wavelength.values, spectrum.wavelength_nm, spectrum[column])


_LAW_DASHES = ("--", ":", "-.")
GALLET_2009_RANGE = (0.15, 0.50)
"""Reflectances at 1310 nm that Gallet et al. (2009) give for surface areas below 60 m²/kg."""


def draw_fitted_spectra(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw measured and fitted spectra of snow, and their differences.

    Parameters
    ----------
    table : pandas.DataFrame
        See `make_overlay_table`.
    note : str
        Note for the foot, see `splits.plotting.grammar.describe_conditions`.
    """
    groups = list(table.groupby("spectrum", sort=False))
    with use_style():
        figure, panels = make_subplots(
            2, 1, height=4.0, sharex=True, gridspec_kw={"height_ratios": [2.2, 1]}
        )
        top, bottom = panels
        for (spectrum, rows), colour in zip(groups, pick_colours(len(groups)), strict=True):
            x = rows.wavelength_nm
            top.plot(x, rows.measured, ".", ms=2.5, color=colour)
            top.plot(x, rows.model, color=colour,
                     label=_format_spectrum_name(spectrum, rows.area.iloc[0]))  # fmt: skip
            low, high = rows.model - BAND_SIGMA * rows.stderr, rows.model + BAND_SIGMA * rows.stderr
            top.fill_between(x, low, high, color=colour, alpha=0.3, lw=0)
            bottom.plot(x, rows.difference.where(rows.fitted), color=colour)
            bottom.plot(x, rows.difference, color=colour, lw=0.6, ls=":")
        top.plot([], [], ".", ms=2.5, color="0.4", label="measured")
        start_at_zero(top, "reflectance")
        top.set_ylabel("reflectance")
        top.legend(frameon=False)
        bottom.axhline(0, color="black", lw=0.6)
        bottom.set_ylabel("model − measured")
        bottom.set_xlabel("wavelength (nm); dotted: not fitted")
        return annotate_figure(figure, panels, note)


def _format_spectrum_name(column: str, area: float) -> str:
    """Return the legend entry of a spectrum, such as ``ID2081@47.66``."""
    name, _, angle = column.partition("@")
    return f"{escape_mathtext(f'{name}, {angle}')}°: {area:.1f} m²/kg"


def draw_area_law(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw modelled and published reflectance at 1310 nm against surface area.

    Parameters
    ----------
    table : pandas.DataFrame
        See `make_field_table`.
    note : str
        Note for the foot, see `splits.plotting.grammar.describe_conditions`.
    """
    ours = table[table.stderr.notna()]
    groups = list(ours.groupby("snow", sort=False))
    laws = list(table[table.stderr.isna()].groupby("snow", sort=False))
    with use_style():
        figure, axes = make_subplots(height=2.9)
        for (snow, rows), colour in zip(groups, pick_colours(len(groups)), strict=True):
            axes.errorbar(rows.area, rows.reflectance, BAND_SIGMA * rows.stderr, color=colour,
                          marker="o", ms=2.5, label=escape_mathtext(str(snow)))  # fmt: skip
        for (law, rows), dashes in zip(laws, _LAW_DASHES, strict=False):
            axes.plot(
                rows.area,
                rows.reflectance,
                ls=dashes,
                color="0.35",
                label=escape_mathtext(str(law)),
            )
        axes.axhspan(*GALLET_2009_RANGE, color="0.92", zorder=0,
                     label="below 60 m²/kg (Gallet et al. 2009)")  # fmt: skip
        axes.set_xlim(left=0)
        axes.set_ylim(0, 0.8)
        axes.set_xlabel("specific surface area (m²/kg)")
        axes.set_ylabel("reflectance at 1310 nm")
        axes.legend(frameon=False, loc="upper left", fontsize=SMALL_FONT_PT)
        return annotate_figure(figure, [axes], note)
