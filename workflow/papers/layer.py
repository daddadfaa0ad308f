"""Statements of Budak & Grimailo (2020) on rough layers, as numbers with standard errors."""

from __future__ import annotations

import pandas as pd
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.core.validation import invalid
from workflow.papers.angles import Trend
from workflow.papers.statements import Estimate, make_significance_row, require

MAX_ANGLE_DEG = 75.0
"""Largest viewing angle (degrees) at which curves are compared."""
CHANGES = {
    "slope_correlation": (
        "surface", "same slopes correlated over 3 m instead of 0.01 m, free path 1 m: largest "
        "relative change of the BRDF",
    ),
    "polarization": (
        "polarized", "Rayleigh layer under smooth glass, with or without polarization: largest "
        "relative change of the radiance factor",
    ),
    "multiple_reflection": (
        "polarized", "multiple reflections in rough glass, with or without polarization: largest "
        "relative change of the BRDF (up to 30 % in the paper's reference 6)",
    ),
}  # fmt: skip
"""Dimension of the dataset between whose ends the BRDF changes, and the statement (section 1)."""


def make_layer_trend_table(
    *,
    lens: xr.Dataset | None = None,
    volume: xr.Dataset | None = None,
    slope_correlation: xr.Dataset | None = None,
    polarization: xr.Dataset | None = None,
    multiple_reflection: xr.Dataset | None = None,
    band_limit: xr.Dataset | None = None,
) -> pd.DataFrame:
    """Return one row per statement on some or all of the runs."""
    changes = {
        "slope_correlation": slope_correlation,
        "polarization": polarization,
        "multiple_reflection": multiple_reflection,
    }
    trends: list[Trend] = []
    if lens is not None:
        require("lens", lens, "concentration")
        best = lens.isel(screen_depth=lens.concentration.argmax("screen_depth"))
        place = f"{float(best.screen_depth):g} m below a crest"
        text = f"statistical lens: inverse mean square size of a ring's image {place}, above 1 by"
        trends.append((text, "Fig 2", Estimate.from_dataset(best, "concentration") - 1.0))
    if volume is not None:
        media = ("surface only", "surface and volume")
        brdf = _select_plane("volume", volume, "medium", media)
        text = "very rough glass: BRDF (1/sr) that the volume adds, where least significant"
        trends.append((text, "Fig 3", brdf.sel(medium=media[1]) - brdf.sel(medium=media[0])))
    for key, run in changes.items():
        if run is not None:
            dimension, text = CHANGES[key]
            brdf = _select_plane(key, run, dimension)
            change = brdf.isel(**{dimension: -1}) / brdf.isel(**{dimension: 0}) - 1.0
            most = change.isel(angle=(abs(change.value) - 2.0 * change.stderr).argmax("angle"))
            sign = "" if most.value > 0.0 else "less, "
            text = f"{text} ({sign}at {float(most.value.angle):g}°)"
            trends.append((text, "section 1", Estimate(abs(most.value), most.stderr)))
    if band_limit is not None:
        require("band_limit", band_limit, "reflectance", ("surface",))
        reflectance = Estimate.from_dataset(band_limit.isel(wavelength=0), "reflectance")
        text = "exponential correlation: reflectance falls as the band limit rises: smallest step"
        trends.append((text, "Eq 3", -reflectance.diff("surface")))
    if not trends:
        raise invalid("inputs", {}, f"with one of lens, volume, {', '.join(changes)}, band_limit")
    return pd.DataFrame([make_significance_row(*trend[:2], *trend[2]) for trend in trends])


def _select_plane(
    key: str, dataset: xr.Dataset, axis: str, labels: tuple[str, ...] = ()
) -> Estimate:
    """Return the BRDF in the principal plane up to the largest angle."""
    require(key, dataset, "brdf", (axis,), values={axis: labels})
    plane = select_principal_plane(dataset).isel(wavelength=0)
    return Estimate.from_dataset(plane.sel(angle=slice(-MAX_ANGLE_DEG, MAX_ANGLE_DEG)), "brdf")
