"""Qualitative trends in the SPLITSnow paper, as differences with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_band_error, make_band_weights
from splits.experiments.papers.estimate import Estimate

UNRESOLVED_VERDICT = "not resolved at this accuracy"
"""Verdict on a number whose error is too large for a decision."""
MIN_TREND_SIGMA = 3.0
"""Significance (standard errors) that the smallest step of a trend must exceed."""
REFLECTANCE_PEAKS_NM = {1800.0: (1500.0, 2000.0), 2250.0: (2000.0, 2500.0)}
"""Wavelengths (nm) of reflectance maxima, and of the absorption bands on both sides."""


def compute_band_mean(dataset: xr.Dataset, quantity: str, low: float, high: float) -> xr.DataArray:
    """Return the mean of a quantity over a band (nm), NaN if any of its values is."""
    inside = make_band_weights(dataset, low, high).values > 0.0
    return dataset[quantity].isel(wavelength=inside).mean("wavelength", skipna=False)


def estimate_band(dataset: xr.Dataset, quantity: str, low: float, high: float) -> Estimate:
    """Return the mean of a quantity over a band (nm) and its standard error."""
    mean = compute_band_mean(dataset, quantity, low, high)
    return Estimate(mean, compute_band_error(dataset, quantity, low, high).transpose(*mean.dims))


def compute_steps(
    dataset: xr.Dataset, quantity: str, dimension: str, low: float, high: float
) -> Estimate:
    """Return the steps of a band mean along a grid dimension and their standard errors.

    Points of the grid are assumed independent, which overestimates the error where they share
    random numbers.
    """
    return estimate_band(dataset, quantity, low, high).diff(dimension)


def _make_row(
    quantity: str, place: str, value: Any, error: Any, within: bool, bar: str
) -> dict[str, object]:
    """Return the row of a number with its criterion and verdict."""
    return {
        "id": "trend", "quantity": quantity, "place": place, "ours": float(value),
        "stderr": float(error), "bar": bar, "verdict": "agrees" if within else "outside",
    }  # fmt: skip


def select_least_significant(value: Any, error: Any) -> tuple[float, float]:
    """Return the value that exceeds 0 by the fewest standard errors, and its error."""
    value, error = np.ravel(value), np.ravel(error)
    worst = int(np.argmin(value / error))
    return float(value[worst]), float(error[worst])


def make_significance_row(quantity: str, place: str, value: Any, error: Any) -> dict[str, object]:
    """Return the row of the least significant of some values expected to be positive.

    Columns are id, quantity, place, ours, stderr, bar, verdict.  The trend agrees if the value
    exceeds `MIN_TREND_SIGMA` standard errors.
    """
    value, error = select_least_significant(value, error)
    bar = f"above {MIN_TREND_SIGMA:g} standard errors"
    row = _make_row(quantity, place, value, error, value > MIN_TREND_SIGMA * error, bar)
    is_resolved = abs(value) > MIN_TREND_SIGMA * error
    return row if is_resolved else row | {"verdict": UNRESOLVED_VERDICT}


def make_monotone_row(
    dataset: xr.Dataset, quantity: str, dimension: str, sign: int,
    band_nm: tuple[float, float], statement: str, place: str,
) -> dict[str, object]:  # fmt: skip
    """Return the row of a band mean (nm) that rises (+1) or falls (-1) along a grid's dimension."""
    steps = compute_steps(dataset, quantity, dimension, *band_nm)
    steps = steps if sign > 0 else -steps
    return make_significance_row(f"{statement}: smallest step", place, *steps)


def make_snow_trend_rows(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Parameters
    ----------
    datasets : mapping
        By name, see `splits.experiments.studies.agreement.AgreementStudy`.
    """
    saturations, quantity = datasets["saturation_transmittance"], "transmittance"
    ends = saturations.isel(saturation=[0, -1])
    sizes = datasets["grain_size"]
    return [
        make_monotone_row(sizes, "reflectance", "grain_size_um", -1, (700, 1300),
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
        *_make_facetness_rows(datasets["facetness"]),
        _make_band_comparison_row(sizes),
        *(_make_peak_row(sizes, peak, *valleys) for peak, valleys in REFLECTANCE_PEAKS_NM.items()),
        *_make_depth_rows(datasets["depth"]),
    ]  # fmt: skip


def make_ranking_rows(sensitivities: xr.Dataset) -> list[dict[str, object]]:
    """Return one row per step of the ranking of sensitivities of reflectance (Table 2)."""
    index = Estimate.from_dataset(sensitivities.sel(quantity="reflectance"), "msi")
    rows = []
    for stronger, weaker in (
        ("grain_size", "facetness"), ("grain_size", "density"), ("saturation", "density"),
        ("facetness", "density"),
    ):  # fmt: skip
        statement = f"MSI of reflectance: {stronger} above {weaker}".replace("_", " ")
        difference = index.sel(parameter=stronger) - index.sel(parameter=weaker)
        rows.append(make_significance_row(statement, "Table 2", *difference))
    return rows


def _make_facetness_rows(dataset: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on the rise of reflectance with facetness: whole range and smallest step.

    The rise flattens, so that neighbouring values may agree within their errors; the second row
    only requires that no step is significantly negative.
    """
    mean = estimate_band(dataset, "reflectance", 700, 1300)
    value, error = select_least_significant(*mean.diff("facetness"))
    rises = "reflectance rises from least to most facetness, 700-1300 nm"
    never_falls = "reflectance never falls with facetness, 700-1300 nm: smallest step"
    is_met, bar = value > -MIN_TREND_SIGMA * error, f"above -{MIN_TREND_SIGMA:g} standard errors"
    rise = mean.isel(facetness=[0, -1]).diff("facetness")
    return [
        make_significance_row(rises, "Fig 9", *rise),
        _make_row(never_falls, "Fig 9", value, error, is_met, bar),
    ]


def _make_band_comparison_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of the decrease with grain size in 700-1300 nm and in 400-700 nm."""
    ends = dataset.isel(grain_size_um=[0, -1])
    infrared, visible = (
        compute_steps(ends, "reflectance", "grain_size_um", *band)
        for band in ((700, 1300), (400, 700))
    )
    statement = "reflectance falls more with grain size in 700-1300 nm than in 400-700 nm"
    return make_significance_row(statement, "Fig 8", *visible - infrared)


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
    visible = estimate_band(dataset, "transmittance", 400, 700).divide_neighbours("depth_m")
    infrared = Estimate.from_dataset(dataset.sel(wavelength=1030), "transmittance")
    rows = []
    for depth, ratio, error in zip(dataset.depth_m.values, *visible, strict=False):
        depths = f"{2e3 * depth:g} mm over {1e3 * depth:g} mm"
        statement = f"transmittance, 400-700 nm, {depths}: approximately half"
        is_met, bar = bool(0.35 <= ratio <= 0.65), "0.35 to 0.65"
        rows.append(_make_row(statement, "Fig 11", ratio, error, is_met, bar))
    excess = (visible - infrared.divide_neighbours("depth_m")).isel(depth_m=0)
    statement = "doubling the depth cuts transmittance more at 1030 nm than in 400-700 nm"
    return [*rows, make_significance_row(statement, "Fig 11", *excess)]
