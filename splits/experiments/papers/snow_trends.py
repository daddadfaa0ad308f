"""Qualitative trends in the SPLITSnow paper, as differences with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_band_error, make_band_weights

UNRESOLVED_VERDICT = "not resolved at this accuracy"
"""Verdict on a number whose error is too large for a decision."""
MIN_TREND_SIGMA = 3.0
"""Significance (standard errors) that the smallest step of a trend must exceed."""


def compute_band_mean(dataset: xr.Dataset, quantity: str, low: float, high: float) -> xr.DataArray:
    """Return the mean of a quantity over a band (nm), NaN if any of its values is."""
    inside = make_band_weights(dataset, low, high).values > 0.0
    return dataset[quantity].isel(wavelength=inside).mean("wavelength", skipna=False)


def compute_steps(
    dataset: xr.Dataset, quantity: str, dimension: str, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of a band mean along a grid dimension and their standard errors.

    Points of the grid are assumed independent, which overestimates the error where they share
    random numbers.
    """
    means = compute_band_mean(dataset, quantity, low, high)
    mean = means.values
    error = compute_band_error(dataset, quantity, low, high).transpose(*means.dims).values
    return compute_differences(mean, error, means.dims.index(dimension))


def compute_differences(
    value: np.ndarray, error: np.ndarray, axis: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences of successive independent values along an axis, and their errors."""
    before, after = np.delete(error, -1, axis=axis), np.delete(error, 0, axis=axis)
    return np.diff(value, axis=axis), np.hypot(after, before)


def make_snow_trend_rows(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Parameters
    ----------
    datasets : mapping
        By name, see `splits.experiments.studies.agreement.AgreementStudy`.
    """
    saturations, quantity = datasets["saturation_transmittance"], "transmittance"
    ends = saturations.isel(saturation=[0, -1])
    rows = [
        make_monotone_row(datasets["grain_size"], "reflectance", "grain_size_um", -1, (700, 1300),
            "reflectance falls with grain size, 700-1300 nm", "Fig 8"),
        make_monotone_row(datasets["depth"], quantity, "depth_m", -1, (400, 700),
            "transmittance falls with depth, 400-700 nm", "Fig 11"),
        make_monotone_row(datasets["grain_size_transmittance"], quantity, "grain_size_um", +1,
            (400, 700), "transmittance rises with grain size, 400-700 nm", "Fig 12"),
        make_monotone_row(saturations, quantity, "saturation", +1, (400, 700),
            "transmittance rises with saturation, 400-700 nm", "Fig 13"),
        make_monotone_row(saturations, quantity, "saturation", -1, (800, 1450),
            "transmittance falls with every step of saturation, mean over 800-1450 nm", "Fig 13"),
        make_monotone_row(ends, quantity, "saturation", -1, (800, 1450),
            "transmittance falls from 0 to 30 % saturation, mean over 800-1450 nm", "Fig 13"),
        make_monotone_row(saturations, quantity, "saturation", -1, (940, 1450),
            "transmittance falls with saturation, 940-1450 nm", "Fig 13"),
        make_monotone_row(datasets["density_transmittance"], quantity, "density_kg_m3", -1,
            (400, 700), "transmittance falls with density, 400-700 nm", "Fig 14"),
    ]  # fmt: skip
    sizes = datasets["grain_size"]
    rows += [
        *_make_facetness_rows(datasets["facetness"]),
        _make_band_comparison_row(sizes),
        *(_make_peak_row(sizes, peak, *valleys) for peak, valleys in REFLECTANCE_PEAKS_NM.items()),
        *_make_depth_rows(datasets["depth"]),
    ]
    return rows


def make_ranking_rows(sensitivities: xr.Dataset) -> list[dict[str, object]]:
    """Return one row per step of the ranking of sensitivities of reflectance (Table 2)."""
    reflectance = sensitivities.sel(quantity="reflectance")
    rows = []
    for stronger, weaker in (
        ("grain_size", "facetness"), ("grain_size", "density"), ("saturation", "density"),
        ("facetness", "density"),
    ):  # fmt: skip
        a, b = (reflectance.sel(parameter=p) for p in (stronger, weaker))
        statement = f"MSI of reflectance: {stronger} above {weaker}".replace("_", " ")
        error = np.hypot(a.msi_stderr, b.msi_stderr)
        rows.append(make_significance_row(statement, "Table 2", a.msi - b.msi, error))
    return rows


REFLECTANCE_PEAKS_NM = {1800.0: (1500.0, 2000.0), 2250.0: (2000.0, 2500.0)}
"""Wavelengths (nm) of reflectance maxima, and of the absorption bands on both sides."""


def _make_row(
    quantity: str, place: str, value: float, error: float, within: bool, bar: str
) -> dict[str, object]:
    row = {"id": "trend", "quantity": quantity, "place": place, "ours": value, "stderr": error}
    return {**row, "bar": bar, "verdict": "agrees" if within else "outside"}


def make_significance_row(quantity: str, place: str, value: Any, error: Any) -> dict[str, object]:
    """Return the row of the least significant of some values expected to be positive.

    Columns are id, quantity, place, ours, stderr, bar, verdict.  The trend agrees if the value
    exceeds `MIN_TREND_SIGMA` standard errors.
    """
    value, error = np.ravel(value), np.ravel(error)
    worst = int(np.argmin(value / error))
    v, e = float(value[worst]), float(error[worst])
    bar = f"above {MIN_TREND_SIGMA:g} standard errors"
    row = _make_row(quantity, place, v, e, v > MIN_TREND_SIGMA * e, bar)
    if not abs(v) > MIN_TREND_SIGMA * e:
        row["verdict"] = UNRESOLVED_VERDICT
    return row


def make_monotone_row(
    dataset: xr.Dataset, quantity: str, dimension: str, sign: int,
    band_nm: tuple[float, float], statement: str, place: str,
) -> dict[str, object]:  # fmt: skip
    """Return the row of a band mean (nm) that rises (+1) or falls (-1) along a grid's dimension."""
    step, error = compute_steps(dataset, quantity, dimension, *band_nm)
    return make_significance_row(f"{statement}: smallest step", place, sign * step, error)


def _make_facetness_rows(dataset: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on the rise of reflectance with facetness: whole range and smallest step.

    The rise flattens, so that neighbouring values may agree within their errors; the second row
    only requires that no step is significantly negative.
    """
    step, error = compute_steps(dataset, "reflectance", "facetness", 700, 1300)
    ends = dataset.isel(facetness=[0, -1])
    rise, rise_error = compute_steps(ends, "reflectance", "facetness", 700, 1300)
    worst = int(np.argmin(step / error))
    value, stderr = float(step[worst]), float(error[worst])
    rises = "reflectance rises from least to most facetness, 700-1300 nm"
    never_falls = "reflectance never falls with facetness, 700-1300 nm: smallest step"
    is_met, bar = value > -MIN_TREND_SIGMA * stderr, f"above -{MIN_TREND_SIGMA:g} standard errors"
    return [
        make_significance_row(rises, "Fig 9", rise, rise_error),
        _make_row(never_falls, "Fig 9", value, stderr, is_met, bar),
    ]


def _make_band_comparison_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of the decrease with grain size in 700-1300 nm and in 400-700 nm."""
    ends = dataset.isel(grain_size_um=[0, -1])
    infrared, infrared_error = compute_steps(ends, "reflectance", "grain_size_um", 700, 1300)
    visible, visible_error = compute_steps(ends, "reflectance", "grain_size_um", 400, 700)
    statement = "reflectance falls more with grain size in 700-1300 nm than in 400-700 nm"
    error = np.hypot(infrared_error, visible_error)
    return make_significance_row(statement, "Fig 8", visible - infrared, error)


def _make_peak_row(
    dataset: xr.Dataset, peak: float, left: float, right: float
) -> dict[str, object]:
    part = dataset.sel(wavelength=[left, peak, right])
    r, e = part.reflectance.values, part.reflectance_stderr.values
    height = np.minimum(r[..., 1] - r[..., 0], r[..., 1] - r[..., 2])
    statement = f"reflectance peaks at {peak:g} nm between {left:g} and {right:g} nm"
    error = np.linalg.norm(e, axis=-1)
    return make_significance_row(f"{statement}: smallest height", "Fig 8", height, error)


def _make_depth_rows(dataset: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on transmittance at twice the depth, in the visible and at 1030 nm."""
    t = compute_band_mean(dataset, "transmittance", 400, 700).values
    e = compute_band_error(dataset, "transmittance", 400, 700).values
    rows = []
    ratio_errors = []
    for i, depth in enumerate(dataset.depth_m.values[:-1]):
        ratio = t[i + 1] / t[i]
        error = ratio * np.hypot(e[i + 1] / t[i + 1], e[i] / t[i])
        ratio_errors.append(error)
        depths = f"{2e3 * depth:g} mm over {1e3 * depth:g} mm"
        statement = f"transmittance, 400-700 nm, {depths}: approximately half"
        is_met, bar = 0.35 <= ratio <= 0.65, "0.35 to 0.65"
        rows.append(_make_row(statement, "Fig 11", float(ratio), float(error), is_met, bar))
    infrared = dataset.isel(depth_m=[0, 1]).sel(wavelength=1030)
    (shallow, deep), (e0, e1) = infrared.transmittance.values, infrared.transmittance_stderr.values
    drop = deep / shallow
    error = np.hypot(np.hypot(e1, drop * e0) / shallow, ratio_errors[0])
    statement = "doubling the depth cuts transmittance more at 1030 nm than in 400-700 nm"
    return [*rows, make_significance_row(statement, "Fig 11", t[1] / t[0] - drop, error)]
