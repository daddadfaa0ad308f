"""Statements of Budak & Grimailo (2020) on rough layers, as numbers with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import xarray as xr

from splits.analysis.directions import select_principal_plane
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
    makers: dict[str, Callable[[xr.Dataset], dict[str, object]]] = {
        "lens": _make_lens_row,
        "volume": _make_volume_row,
        **{role: partial(_make_change_row, *change) for role, change in CHANGES.items()},
        "band_limit": _make_band_limit_row,
    }
    return [make_row(datasets[role]) for role, make_row in makers.items() if role in datasets]


def _select_plane(dataset: xr.Dataset) -> Estimate:
    """Return the BRDF in the principal plane up to the largest angle."""
    plane = select_principal_plane(dataset).isel(wavelength=0)
    return Estimate.from_dataset(plane.sel(angle=slice(-MAX_ANGLE_DEG, MAX_ANGLE_DEG)), "brdf")


def _make_lens_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of the densest image of a ring above a crest with the ring."""
    best = dataset.isel(screen_depth=dataset.concentration.argmax("screen_depth"))
    place = f"{float(best.screen_depth):g} m below a crest"
    statement = f"statistical lens: inverse mean square size of a ring's image {place}, above 1 by"
    excess = Estimate.from_dataset(best, "concentration") - 1.0
    return make_significance_row(statement, "Fig 2", *excess)


def _make_volume_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of a surface above a volume with the surface only."""
    brdf = _select_plane(dataset)
    statement = "very rough glass: BRDF (1/sr) that the volume adds, where least significant"
    added = brdf.sel(medium="surface and volume") - brdf.sel(medium="surface only")
    return make_significance_row(statement, "Fig 3", *added)


def _make_change_row(dimension: str, statement: str, dataset: xr.Dataset) -> dict[str, object]:
    """Return the most significant relative change between the ends of a grid's dimension."""
    brdf = _select_plane(dataset)
    change = brdf.isel(**{dimension: -1}) / brdf.isel(**{dimension: 0}) - 1.0
    most = change.isel(angle=int((abs(change.value) - 2.0 * change.stderr).argmax("angle")))
    sign = "" if most.value > 0.0 else "less, "
    text = f"{statement} ({sign}at {float(most.value.angle):g}°)"
    return make_significance_row(text, "section 1", abs(most.value), most.stderr)


def _make_band_limit_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the smallest decrease of reflectance with the band limit."""
    steps = Estimate.from_dataset(dataset.isel(wavelength=0), "reflectance").diff("surface")
    statement = "exponential correlation: reflectance falls as the band limit rises: smallest step"
    return make_significance_row(statement, "Eq 3", *-steps)
