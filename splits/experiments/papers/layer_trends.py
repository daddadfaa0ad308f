"""Statements of Budak & Grimailo (2020) on rough layers, as numbers with standard errors."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.experiments.papers.brdf_trends import Trends
from splits.experiments.papers.estimate import Estimate
from splits.experiments.papers.snow_trends import make_significance_row

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


def make_layer_trend_rows(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return one row per statement, from `splits.experiments.papers.snow_trends`.

    Parameters
    ----------
    datasets : mapping
        By name, some or all of `splits.experiments.studies.trends.LayerTrendsStudy`.
    """
    trends = _list_trends(datasets)
    return [make_significance_row(text, place, *estimate) for text, place, estimate in trends]


def _list_trends(datasets: Mapping[str, xr.Dataset]) -> Trends:
    if "lens" in datasets:
        lens = datasets["lens"]
        best = lens.isel(screen_depth=lens.concentration.argmax("screen_depth"))
        place = f"{float(best.screen_depth):g} m below a crest"
        text = f"statistical lens: inverse mean square size of a ring's image {place}, above 1 by"
        yield text, "Fig 2", Estimate.from_dataset(best, "concentration") - 1.0
    if "volume" in datasets:
        brdf = _select_plane(datasets["volume"])
        text = "very rough glass: BRDF (1/sr) that the volume adds, where least significant"
        added = brdf.sel(medium="surface and volume") - brdf.sel(medium="surface only")
        yield text, "Fig 3", added
    for key, (dimension, text) in CHANGES.items():
        if key in datasets:
            brdf = _select_plane(datasets[key])
            change = brdf.isel(**{dimension: -1}) / brdf.isel(**{dimension: 0}) - 1.0
            most = change.isel(angle=(abs(change.value) - 2.0 * change.stderr).argmax("angle"))
            sign = "" if most.value > 0.0 else "less, "
            text = f"{text} ({sign}at {float(most.value.angle):g}°)"
            yield text, "section 1", Estimate(abs(most.value), most.stderr)
    if "band_limit" in datasets:
        spectrum = datasets["band_limit"].isel(wavelength=0)
        reflectance = Estimate.from_dataset(spectrum, "reflectance")
        text = "exponential correlation: reflectance falls as the band limit rises: smallest step"
        yield text, "Eq 3", -reflectance.diff("surface")


def _select_plane(dataset: xr.Dataset) -> Estimate:
    """Return the BRDF in the principal plane up to the largest angle."""
    plane = select_principal_plane(dataset).isel(wavelength=0)
    return Estimate.from_dataset(plane.sel(angle=slice(-MAX_ANGLE_DEG, MAX_ANGLE_DEG)), "brdf")
