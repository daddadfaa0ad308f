"""Comparison of simulations with the published numbers and trends of SPLITSnow."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.measured import (
    LETCHER_COLUMNS,
    compare_with_spectrum,
    compute_measured_rmse,
    compute_rmse,
    mix_letcher_illumination,
    select_letcher_column,
)
from splits.core.uncertainty import compute_weighted_error
from splits.experiments.papers.snow_trends import (
    UNRESOLVED_VERDICT,
    make_ranking_rows,
    make_snow_trend_rows,
)

ValueAndStderr = tuple[float, float]
"""A number and its standard error."""

MIN_VERDICT_SIGMA = 2.0
"""Smallest distance to a tolerance limit, in standard errors, that permits a verdict."""
AVIRIS_BANDS_NM = {"842": 842.25, "1074": 1073.76, "1238": 1237.93}


def make_agreement_table(
    datasets: Mapping[str, xr.Dataset],
    published: pd.DataFrame,
    sensitivities: xr.Dataset,
    aviris: pd.DataFrame,
    letcher: pd.DataFrame,
) -> pd.DataFrame:
    """Return one row per published number, trend and measured spectrum.

    Parameters
    ----------
    datasets : mapping
        By name, see `splits.experiments.studies.agreement.AgreementStudy`.
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    sensitivities : xarray.Dataset
        See `splits.experiments.papers.sensitivity_table.select_chosen_sensitivities`.
    aviris, letcher : pandas.DataFrame
        Measured values.

    Returns
    -------
    pandas.DataFrame
        Columns id, quantity, place, published, ours, stderr, difference, bar, verdict.
    """
    values = _compute_values(datasets, sensitivities, aviris)
    rows = [
        _compare_with_published(name, row, values.get(str(name)))
        for name, row in published.iterrows()
    ]
    rows += make_snow_trend_rows(datasets)
    rows += make_ranking_rows(sensitivities)
    rows += _make_measured_rows(datasets, aviris, letcher)
    return pd.DataFrame(rows)


def _compare_with_published(
    name: object, row: pd.Series, value: ValueAndStderr | None
) -> dict[str, object]:
    """Return the verdict on one published number."""
    fixed = {"id": name, "quantity": row.quantity, "place": row.place, "published": row.published}
    if value is None:
        verdict = "not reproducible: the measured curve is not published as numbers"
        return {**fixed, "verdict": verdict}
    ours, stderr = value
    difference = ours - row.published
    if isinstance(row.bar, str):
        relative = row.bar.endswith("%")
        allowed = float(row.bar.rstrip("%")) * (abs(row.published) / 100 if relative else 1.0)
        low, high = row.published - allowed, row.published + allowed
        bar = f"±{row.bar}".replace("%", " %")
    else:
        low = -np.inf if pd.isna(row.low) else row.low
        high = np.inf if pd.isna(row.high) else row.high
        bar = f"{low:g} to {high:g}" if np.isfinite(low) else f"at most {high:g}"
    return {
        **fixed,
        "ours": ours,
        "stderr": stderr,
        "difference": difference,
        "bar": bar,
        "verdict": _judge_range(ours, stderr, low, high),
    }


def _judge_range(value: float, stderr: float, low: float, high: float) -> str:
    """Return the verdict on whether a value lies in a range, if its standard error permits one."""
    if min(abs(value - low), abs(value - high)) < MIN_VERDICT_SIGMA * stderr:
        return UNRESOLVED_VERDICT
    return "agrees" if low <= value <= high else "outside"


def _compute_values(
    datasets: Mapping[str, xr.Dataset], sensitivities: xr.Dataset, aviris: pd.DataFrame
) -> dict[str, ValueAndStderr]:
    values: dict[str, ValueAndStderr] = {}
    sample = datasets["sample"].mean_grain_distance.sel(density_kg_m3=450)
    values["grain_distance"] = float(sample), 0.0
    scene = datasets["aviris"]
    for label, wavelength in AVIRIS_BANDS_NM.items():
        value = _select_value(scene, "reflectance", wavelength)
        values[f"table3_{label}"] = values[f"aviris_{label}"] = value
    extremes = aviris[["reflectance_min", "reflectance_max"]].to_numpy()
    model = compare_with_spectrum(scene, aviris)
    ours = model.model.to_numpy()[:, np.newaxis]
    percent = 100 * np.abs(ours - extremes) / extremes
    error = 100 * (model.stderr.to_numpy()[:, np.newaxis] / extremes).mean()
    values["aviris_extremes"] = float(percent.mean()), float(error)
    thick = datasets["thick_transmittance"]
    values["transmittance_max"] = _find_maximum(thick, "transmittance", 400, 500)
    values["transmittance_950"] = _find_maximum(thick, "transmittance", 960, 1000)
    thin = datasets["density_transmittance"].isel(density_kg_m3=0)
    values["transmittance_1420"] = _select_value(thin, "transmittance", 1420)
    values |= _compute_density_effect(datasets["density"])
    for quantity in sensitivities.quantity.values:
        for parameter in sensitivities.parameter.values:
            index = sensitivities.sel(quantity=quantity, parameter=parameter)
            values[f"msi_{quantity[0]}_{parameter}"] = float(index.msi), float(index.msi_stderr)
    return values


def _select_value(dataset: xr.Dataset, quantity: str, wavelength: float) -> ValueAndStderr:
    part = dataset.sel(wavelength=wavelength)
    return float(part[quantity]), float(part[f"{quantity}_stderr"])


def _find_maximum(dataset: xr.Dataset, quantity: str, low: float, high: float) -> ValueAndStderr:
    part = dataset.sel(wavelength=slice(low, high))
    i = int(np.argmax(part[quantity].values))
    return float(part[quantity][i]), float(part[f"{quantity}_stderr"][i])


def _compute_density_effect(dataset: xr.Dataset) -> dict[str, ValueAndStderr]:
    loose, dense = (dataset.sel(density_kg_m3=d) for d in (300, 450))
    difference = (dense.reflectance - loose.reflectance).values
    error = np.hypot(loose.reflectance_stderr.values, dense.reflectance_stderr.values)
    percent = 100 * np.abs(difference) / loose.reflectance.values

    def compute_stderr(weights: np.ndarray) -> float:
        weight = xr.DataArray(weights, dims="wavelength")
        errors = [
            float(compute_weighted_error(spectrum, "reflectance", weight))
            for spectrum in (loose, dense)
        ]
        return math.hypot(*errors)

    return {
        "density_rmse": compute_rmse(difference, error, compute_stderr),
        "density_percent": (
            float(percent.mean()),
            100
            * compute_stderr(np.sign(difference) / (loose.reflectance.values * difference.size)),
        ),
    }


def _make_measured_rows(
    datasets: Mapping[str, xr.Dataset], aviris: pd.DataFrame, letcher: pd.DataFrame
) -> list[dict[str, object]]:
    """Return the RMSE to measured spectra, to which nothing was fitted."""
    results = [("AVIRIS-NG, 3 bands", "Table 3", compute_measured_rmse(datasets["aviris"], aviris))]
    snows = datasets["letcher"]
    for snow, depth in itertools.product(snows.medium.values, LETCHER_COLUMNS):
        column = select_letcher_column(letcher, depth)
        rmse = compute_measured_rmse(mix_letcher_illumination(snows, snow, depth), column)
        description = f"Letcher et al. (2022), {1e3 * depth:g} mm, {snow}"
        results.append((description, "The Cryosphere 16, 4343", rmse))
    rows: list[dict[str, object]] = []
    for description, place, (value, error) in results:
        rows.append(
            {
                "id": "measured",
                "quantity": f"RMSE to measured reflectance: {description}",
                "place": place,
                "ours": value,
                "stderr": error,
                "bar": "at most 0.03",
                "verdict": "agrees" if value <= 0.03 else "outside",
            }
        )
    return rows
