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
from splits.experiments.papers.estimate import Estimate
from splits.experiments.papers.snow_trends import (
    UNRESOLVED_VERDICT,
    make_ranking_rows,
    make_snow_trend_rows,
)

MIN_VERDICT_SIGMA = 2.0
"""Smallest distance to a tolerance limit, in standard errors, that permits a verdict."""
AT_BAR_VERDICT = "at the bar"
"""Verdict on a number whose distance to a tolerance limit and whose error are both less than one
unit of the last printed digit of the published number, so that a smaller error decides nothing.
The tolerance is larger than that unit."""
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
    name: object, row: pd.Series, value: Estimate | None
) -> dict[str, object]:
    """Return the verdict on one published number."""
    fixed = {"id": name, "quantity": row.quantity, "place": row.place, "published": row.published}
    if value is None:
        verdict = "not reproducible: the measured curve is not published as numbers"
        return {**fixed, "verdict": verdict}
    ours, stderr = value
    if isinstance(row.bar, str):
        relative = row.bar.endswith("%")
        allowed = float(row.bar.rstrip("%")) * (abs(row.published) / 100 if relative else 1.0)
        low, high = row.published - allowed, row.published + allowed
        bar = f"±{row.bar}".replace("%", " %")
    else:
        low = -np.inf if pd.isna(row.low) else row.low
        high = np.inf if pd.isna(row.high) else row.high
        bar = f"{low:g} to {high:g}" if np.isfinite(low) else f"at most {high:g}"
    verdict = "agrees" if low <= ours <= high else "outside"
    distance = min(abs(ours - low), abs(ours - high))
    if distance < MIN_VERDICT_SIGMA * stderr:
        tolerance = min(row.published - low, high - row.published)
        is_at_bar = max(distance, stderr) < row.resolution < tolerance
        verdict = AT_BAR_VERDICT if is_at_bar else UNRESOLVED_VERDICT
    numbers = {"ours": ours, "stderr": stderr, "difference": ours - row.published}
    return {**fixed, **numbers, "bar": bar, "verdict": verdict}


def _compute_values(
    datasets: Mapping[str, xr.Dataset], sensitivities: xr.Dataset, aviris: pd.DataFrame
) -> dict[str, Estimate]:
    distance = datasets["sample"].mean_grain_distance.sel(density_kg_m3=450)
    values = {"grain_distance": Estimate(distance, 0.0)}
    model = compare_with_spectrum(datasets["aviris"], aviris)
    scene = Estimate.from_dataset(datasets["aviris"], "reflectance")
    for label, wavelength in AVIRIS_BANDS_NM.items():
        value = scene.sel(wavelength=wavelength)
        values[f"table3_{label}"] = values[f"aviris_{label}"] = value
    extremes = aviris[["reflectance_min", "reflectance_max"]].to_numpy()
    ours, error = (model[[name]].to_numpy() for name in ("model", "stderr"))
    percent = 100 * np.abs(ours - extremes) / extremes
    values["aviris_extremes"] = Estimate(percent.mean(), 100 * (error / extremes).mean())
    thick = datasets["thick_transmittance"]
    values["transmittance_max"] = _find_max_transmittance(thick, 400, 500)
    values["transmittance_950"] = _find_max_transmittance(thick, 960, 1000)
    thin = datasets["density_transmittance"].isel(density_kg_m3=0).sel(wavelength=1420)
    values["transmittance_1420"] = Estimate.from_dataset(thin, "transmittance")
    values |= _compute_density_effect(datasets["density"])
    index = Estimate.from_dataset(sensitivities, "msi")
    for quantity, parameter in itertools.product(
        sensitivities.quantity.values, sensitivities.parameter.values
    ):
        value = index.sel(quantity=quantity, parameter=parameter)
        values[f"msi_{quantity[0]}_{parameter}"] = value
    return {name: value.to_floats() for name, value in values.items()}


def _find_max_transmittance(dataset: xr.Dataset, low: float, high: float) -> Estimate:
    """Return the largest transmittance in a band (nm)."""
    part = dataset.sel(wavelength=slice(low, high))
    transmittance = Estimate.from_dataset(part, "transmittance")
    return transmittance.isel(wavelength=part.transmittance.argmax("wavelength"))


def _compute_density_effect(dataset: xr.Dataset) -> dict[str, Estimate]:
    spectra = [dataset.sel(density_kg_m3=density) for density in (300, 450)]
    loose, dense = (Estimate.from_dataset(part, "reflectance") for part in spectra)
    difference, error = (part.values for part in dense - loose)
    percent = 100 * np.abs(difference) / loose.value.values

    def compute_stderr(weights: np.ndarray) -> float:
        weight = xr.DataArray(weights, dims="wavelength")
        return math.hypot(*(compute_weighted_error(s, "reflectance", weight) for s in spectra))

    weights = np.sign(difference) / (loose.value.values * difference.size)
    return {
        "density_rmse": Estimate(*compute_rmse(difference, error, compute_stderr)),
        "density_percent": Estimate(percent.mean(), 100 * compute_stderr(weights)),
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
    return [
        {
            "id": "measured", "quantity": f"RMSE to measured reflectance: {description}",
            "place": place, "ours": value, "stderr": error, "bar": "at most 0.03",
            "verdict": "agrees" if value <= 0.03 else "outside",
        }
        for description, place, (value, error) in results
    ]  # fmt: skip
