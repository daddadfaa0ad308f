"""Numbers of retrievals that documents quote: water in sand, surface area of snow, directions."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from _numbers.formatting import QuotedNumber, QuotedValue, select_cell
from splits.analysis.anisotropy import ALL_DIRECTIONS, fit_proportional

WET_SAND_FILE, LETCHER_FILE = (
    "tables/retrieved_wet_sand_retrieved.csv",
    "tables/retrieved_letcher_retrieved.csv",
)
WET_SAND_BY_VOLUME_FILE = "tables/retrieved_wet_sand_by_volume_retrieved.csv"
DOZIER_FILE = "tables/retrieved_dozier_retrieved.csv"
ANISOTROPY_FILE = "tables/wet_sand_anisotropy_by_angle.csv"
PORE_MODELS = {"narrow": "narrow_pores", "whole": "whole_pores", "film": "film"}
SAND_LABELS = {"algodones": "Algodones", "nevada": "Nevada"}
SNOW_LABELS = {
    "natural": "natural grains",
    "paper": "grains of the paper",
    "law": "kokhanovsky_zege_2004",
}
Selector = Callable[[pd.DataFrame], QuotedValue]


def _filter_water_rows(table: pd.DataFrame, model: str, sand: str) -> pd.DataFrame:
    """Return the rows of the water of one sand, read with one model."""
    own = table[(table.model == model) & (table.parameter == "saturation")]
    return own[own["sample"].str.startswith(sand)]


def _select_slope(model: str, sand: str) -> Selector:
    """Select the slope of water retrieved over water weighed, with its error."""

    def select(table: pd.DataFrame) -> QuotedValue:
        own = _filter_water_rows(table, model, sand)
        line = fit_proportional(own["reference value"].to_numpy(), own["median"].to_numpy())
        return line.slope, line.stderr, ""

    return select


def _select_scatter(model: str, sand: str) -> Selector:
    """Select the scatter of water retrieved about that line."""

    def select(table: pd.DataFrame) -> QuotedValue:
        own = _filter_water_rows(table, model, sand)
        line = fit_proportional(own["reference value"].to_numpy(), own["median"].to_numpy())
        return line.scatter, None, ""

    return select


def _select_misfit_ratio(model: str, sand: str, column: str) -> Selector:
    """Select the sum of misfits over all spectra, over that of what to expect."""

    def select(table: pd.DataFrame) -> QuotedValue:
        own = _filter_water_rows(table, model, sand)
        return float(own[column].sum() / own["chi2 expected"].sum()), None, ""

    return select


def _select_directional_rms(interpretation: str, saturation: float, column: str) -> Selector:
    """Select the root mean square over wavelengths of what is off, from every angle of view."""

    def select(table: pd.DataFrame) -> QuotedValue:
        own = table[(table.interpretation == interpretation) & (table.saturation == saturation)]
        own = own[own.polar_deg.astype(str) == ALL_DIRECTIONS]
        mean = np.average(own[column] ** 2, weights=own.directions)
        return float(np.sqrt(mean)), None, ""

    return select


def _list_retrieval_numbers() -> dict[str, QuotedNumber]:
    """Return all of them by their keys."""
    found = {}
    for first, table in (("wet", WET_SAND_FILE), ("volume", WET_SAND_BY_VOLUME_FILE)):
        for (model, label), (sand, name) in itertools.product(
            PORE_MODELS.items(), SAND_LABELS.items()
        ):
            key = f"{first}.{sand}.{model}"
            found[f"{key}.slope"] = QuotedNumber(table, _select_slope(label, name), ".2f")
            found[f"{key}.scatter"] = QuotedNumber(table, _select_scatter(label, name), ".2f")
            found[f"{key}.best"] = QuotedNumber(
                table, _select_misfit_ratio(label, name, "chi2"), ".1f"
            )
            found[f"{key}.known"] = QuotedNumber(
                table, _select_misfit_ratio(label, name, "chi2 at reference"), ".1f"
            )
    for snow, label in SNOW_LABELS.items():
        area = select_cell("median", "standard deviation", model=label,
                    parameter="specific_surface_area_m2_kg")  # fmt: skip
        found[f"letcher.{snow}.area"] = QuotedNumber(LETCHER_FILE, area, ".1f")
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
            found[f"dozier.{key}.{short}.radius"] = QuotedNumber(DOZIER_FILE, radius, ".0f")
            found[f"dozier.{key}.{short}.chi2"] = QuotedNumber(
                DOZIER_FILE, select_cell("chi2", **where), ".0f"
            )
    for saturation, key in ((0.0, "dry"), (0.412, "wet"), (0.962, "full")):
        for interpretation, short in (("narrow pores", "narrow"), ("whole pores", "whole")):
            rmse = _select_directional_rms(interpretation, saturation, "rmse")
            found[f"directions.{key}.{short}"] = QuotedNumber(ANISOTROPY_FILE, rmse, ".3f")
        spread = _select_directional_rms("whole pores", saturation, "spread")
        found[f"directions.{key}.spread"] = QuotedNumber(ANISOTROPY_FILE, spread, ".3f")
    return found


RETRIEVAL_NUMBERS = _list_retrieval_numbers()
"""Numbers of `_numbers.values`."""
