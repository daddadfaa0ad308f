"""Numbers of retrievals that documents quote: water in sand, surface area of snow, directions."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from splits.analysis.anisotropy import EVERY
from splits.analysis.proportion import proportion
from splits.analysis.quoting import Number, Value, cell

WET, LETCHER = "tables/retrieved_wet_sand_retrieved.csv", "tables/retrieved_letcher_retrieved.csv"
BY_VOLUME = "tables/retrieved_wet_sand_by_volume_retrieved.csv"
DOZIER = "tables/retrieved_dozier_retrieved.csv"
DIRECTIONS = "tables/wet_sand_anisotropy_by_angle.csv"
MODELS = {"narrow": "narrow_pores", "whole": "whole_pores", "film": "film"}
SANDS = {"algodones": "Algodones", "nevada": "Nevada"}
SNOWS = {
    "natural": "natural grains",
    "paper": "grains of the paper",
    "law": "kokhanovsky_zege_2004",
}
Select = Callable[[pd.DataFrame], Value]


def _wet(table: pd.DataFrame, model: str, sand: str) -> pd.DataFrame:
    """Return the rows of the water of one sand, read with one model."""
    own = table[(table.model == model) & (table.parameter == "saturation")]
    return own[own["sample"].str.startswith(sand)]


def _slope(model: str, sand: str) -> Select:
    """Select the slope of water retrieved over water weighed, with its error."""

    def select(table: pd.DataFrame) -> Value:
        own = _wet(table, model, sand)
        line = proportion(own.known.to_numpy(), own["median"].to_numpy())
        return line.slope, line.stderr, ""

    return select


def _scatter(model: str, sand: str) -> Select:
    """Select the scatter of water retrieved about that line."""

    def select(table: pd.DataFrame) -> Value:
        own = _wet(table, model, sand)
        line = proportion(own.known.to_numpy(), own["median"].to_numpy())
        return line.scatter, None, ""

    return select


def _misfit(model: str, sand: str, column: str) -> Select:
    """Select the sum of misfits over all spectra, over that of what to expect."""

    def select(table: pd.DataFrame) -> Value:
        own = _wet(table, model, sand)
        return float(own[column].sum() / own["chi2 expected"].sum()), None, ""

    return select


def _directions(interpretation: str, saturation: float, column: str) -> Select:
    """Select the root mean square over wavelengths of what is off, from every angle of view."""

    def select(table: pd.DataFrame) -> Value:
        own = table[(table.readings == interpretation) & (table.saturation == saturation)]
        own = own[own.polar_deg.astype(str) == EVERY]
        mean = np.average(own[column] ** 2, weights=own.directions)
        return float(np.sqrt(mean)), None, ""

    return select


def _numbers() -> dict[str, Number]:
    """Return all of them by their keys."""
    found = {}
    for first, table in (("wet", WET), ("volume", BY_VOLUME)):
        for (model, label), (sand, name) in itertools.product(MODELS.items(), SANDS.items()):
            key = f"{first}.{sand}.{model}"
            found[f"{key}.slope"] = Number(table, _slope(label, name), ".2f")
            found[f"{key}.scatter"] = Number(table, _scatter(label, name), ".2f")
            found[f"{key}.best"] = Number(table, _misfit(label, name, "chi2"), ".1f")
            found[f"{key}.known"] = Number(table, _misfit(label, name, "chi2 where known"), ".1f")
    for snow, label in SNOWS.items():
        area = cell("median", "standard deviation", model=label,
                    parameter="specific_surface_area_m2_kg")  # fmt: skip
        found[f"letcher.{snow}.area"] = Number(LETCHER, area, ".1f")
    for sample in ("ID2081@47.66", "ID462@66.04", "ID1746@58.98"):
        key = sample.partition("@")[0].lower()
        for model in ("splits", "kokhanovsky_zege_2004"):
            where: dict[str, Any] = {
                "model": model,
                "sample": sample,
                "parameter": "optical_radius_um",
            }
            short = "ours" if model == "splits" else "law"
            radius = cell("median", "standard deviation", **where)
            found[f"dozier.{key}.{short}.radius"] = Number(DOZIER, radius, ".0f")
            found[f"dozier.{key}.{short}.chi2"] = Number(DOZIER, cell("chi2", **where), ".0f")
    for saturation, key in ((0.0, "dry"), (0.412, "wet"), (0.962, "full")):
        for readings, short in (("narrow pores", "narrow"), ("whole pores", "whole")):
            rmse = _directions(readings, saturation, "rmse")
            found[f"directions.{key}.{short}"] = Number(DIRECTIONS, rmse, ".3f")
        spread = _directions("whole pores", saturation, "spread")
        found[f"directions.{key}.spread"] = Number(DIRECTIONS, spread, ".3f")
    return found


RETRIEVALS = _numbers()
"""Numbers of `splits.analysis.quoted`."""
