"""Numbers of retrievals in documents: water in sand, surface area of snow, directions."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from _numbers.formatting import QuotedNumber, QuotedValue, select_cell
from splits.analysis.measured import fit_proportional
from workflow.papers.wet_sand import ALL_DIRECTIONS, NADIR_RATIO, REFLECTANCE_FACTOR

WET_SAND_FILE, LETCHER_FILE = (
    "tables/retrieved_wet_sand_retrieved.csv",
    "tables/retrieved_letcher_retrieved.csv",
)
WET_SAND_BY_VOLUME_FILE = "tables/retrieved_wet_sand_by_volume_retrieved.csv"
DOZIER_FILE = "tables/retrieved_dozier_retrieved.csv"
ANISOTROPY_FILE = "tables/wet_sand_anisotropy_by_angle.csv"
PORE_MODELS = {"narrow": "narrow_pores", "whole": "whole_pores", "film": "film"}
DIRECTIONAL_NUMBERS = {
    "directions.{}.narrow": (NADIR_RATIO, "narrow pores", "rmse"),
    "directions.{}.whole": (NADIR_RATIO, "whole pores", "rmse"),
    "directions.{}.isotropic": (NADIR_RATIO, "whole pores", "isotropic_rmse"),
    "level.{}.narrow": (REFLECTANCE_FACTOR, "narrow pores", "rmse"),
    "level.{}.whole": (REFLECTANCE_FACTOR, "whole pores", "rmse"),
    "level.{}.narrow_isotropic": (REFLECTANCE_FACTOR, "narrow pores", "isotropic_rmse"),
    "level.{}.whole_isotropic": (REFLECTANCE_FACTOR, "whole pores", "isotropic_rmse"),
}
SAND_LABELS = {"algodones": "Algodones", "nevada": "Nevada"}
SNOW_LABELS = {
    "natural": "natural grains",
    "paper": "grains of the paper",
    "law": "kokhanovsky_zege_2004",
}
Selector = Callable[[pd.DataFrame], QuotedValue]


def _filter_water_rows(table: pd.DataFrame, model: str, sand: str) -> pd.DataFrame:
    """Return the rows of the water of one sand retrieved with one model."""
    rows = table[(table.model == model) & (table.parameter == "saturation")]
    return rows[rows["sample"].str.startswith(sand)]


def _select_slope(model: str, sand: str) -> Selector:
    """Return a selector of the slope of retrieved over weighed water, with its error."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = _filter_water_rows(table, model, sand)
        line = fit_proportional(rows["reference value"].to_numpy(), rows["median"].to_numpy())
        return line.slope, line.stderr, ""

    return select


def _select_scatter(model: str, sand: str) -> Selector:
    """Return a selector of the scatter of retrieved water about that line."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = _filter_water_rows(table, model, sand)
        line = fit_proportional(rows["reference value"].to_numpy(), rows["median"].to_numpy())
        return line.scatter, None, ""

    return select


def _select_misfit_ratio(model: str, sand: str, column: str) -> Selector:
    """Return a selector of the ratio of the misfits of all spectra to their expectation."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = _filter_water_rows(table, model, sand)
        return float(rows[column].sum() / rows["chi2 expected"].sum()), None, ""

    return select


def _select_directional_rms(
    saturation: float, quantity: str, interpretation: str, column: str
) -> Selector:
    """Return a selector of the root mean square over wavelengths for all directions."""

    def select(table: pd.DataFrame) -> QuotedValue:
        rows = table[(table.interpretation == interpretation) & (table.saturation == saturation)]
        rows = rows[(rows.quantity == quantity) & (rows.polar_deg.astype(str) == ALL_DIRECTIONS)]
        mean = np.average(rows[column] ** 2, weights=rows.directions)
        return float(np.sqrt(mean)), None, ""

    return select


def _list_retrieval_numbers() -> dict[str, QuotedNumber]:
    """Return all numbers of retrievals by key."""
    numbers = {}
    for prefix, table in (("wet", WET_SAND_FILE), ("volume", WET_SAND_BY_VOLUME_FILE)):
        for (model, label), (sand, name) in itertools.product(
            PORE_MODELS.items(), SAND_LABELS.items()
        ):
            key = f"{prefix}.{sand}.{model}"
            numbers[f"{key}.slope"] = QuotedNumber(table, _select_slope(label, name), ".2f")
            numbers[f"{key}.scatter"] = QuotedNumber(table, _select_scatter(label, name), ".2f")
            numbers[f"{key}.best"] = QuotedNumber(
                table, _select_misfit_ratio(label, name, "chi2"), ".1f"
            )
            numbers[f"{key}.known"] = QuotedNumber(
                table, _select_misfit_ratio(label, name, "chi2 at reference"), ".1f"
            )
    for snow, label in SNOW_LABELS.items():
        area = select_cell("median", "standard deviation", model=label,
                    parameter="specific_surface_area_m2_kg")  # fmt: skip
        numbers[f"letcher.{snow}.area"] = QuotedNumber(LETCHER_FILE, area, ".1f")
    for sample in ("ID2081@47.66", "ID462@66.04", "ID1746@58.98"):
        key = sample.partition("@")[0].lower()
        for model in ("splits", "kokhanovsky_zege_2004"):
            where: dict[str, Any] = {
                "model": model,
                "sample": sample,
                "parameter": "optical_radius_um",
            }
            short = "ours" if model == "splits" else "law"
            radius = select_cell("median", "standard deviation", **where)
            numbers[f"dozier.{key}.{short}.radius"] = QuotedNumber(DOZIER_FILE, radius, ".0f")
            numbers[f"dozier.{key}.{short}.chi2"] = QuotedNumber(
                DOZIER_FILE, select_cell("chi2", **where), ".0f"
            )
    for saturation, sample in ((0.0, "dry"), (0.412, "wet"), (0.962, "full")):
        for key, arguments in DIRECTIONAL_NUMBERS.items():
            rmse = _select_directional_rms(saturation, *arguments)
            numbers[key.format(sample)] = QuotedNumber(ANISOTROPY_FILE, rmse, ".3f")
    return numbers


RETRIEVAL_NUMBERS = _list_retrieval_numbers()
"""Numbers of `_numbers.values`."""
