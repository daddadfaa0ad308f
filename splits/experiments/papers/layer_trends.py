"""Statements of Budak & Grimailo (2020) on rough layers, as numbers with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.experiments.papers.snow_trends import compute_differences, make_significance_row

MAX_ANGLE_DEG = 75.0
"""Largest viewing angle (degrees) at which curves are compared."""


def make_layer_trend_rows(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return one row per statement, from `splits.experiments.papers.snow_trends`.

    Parameters
    ----------
    datasets : mapping
        By name, some or all of `splits.experiments.studies.trends.LayerTrendsStudy`.
    """
    rows: dict[str, Callable[[xr.Dataset], dict[str, object]]] = {
        "lens": _make_lens_row,
        "volume": lambda d: _make_volume_row(_select_plane(d)),
        "slope_correlation": lambda d: _make_change_row(
            _select_plane(d), "surface",
            "same slopes correlated over 3 m instead of 0.01 m, free path 1 m: largest relative "
            "change of the BRDF", "section 1",
        ),
        "polarization": lambda d: _make_change_row(
            _select_plane(d), "polarized",
            "Rayleigh layer under smooth glass, with or without polarization: largest relative "
            "change of the radiance factor", "section 1",
        ),
        "multiple_reflection": lambda d: _make_change_row(
            _select_plane(d), "polarized",
            "multiple reflections in rough glass, with or without polarization: largest relative "
            "change of the BRDF (up to 30 % in the paper's reference 6)", "section 1",
        ),
        "band_limit": _make_band_limit_row,
    }  # fmt: skip
    return [make_row(datasets[role]) for role, make_row in rows.items() if role in datasets]


def _select_plane(dataset: xr.Dataset) -> xr.Dataset:
    plane = select_principal_plane(dataset).isel(wavelength=0)
    return plane.isel(angle=np.abs(plane.angle.values) <= MAX_ANGLE_DEG)


def _make_lens_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of the densest image of a ring above a crest with the ring."""
    best = dataset.isel(screen_depth=dataset.concentration.argmax("screen_depth"))
    place = f"{float(best.screen_depth):g} m below a crest"
    statement = f"statistical lens: inverse mean square size of a ring's image {place}, above 1 by"
    excess, error = best.concentration - 1.0, best.concentration_stderr
    return make_significance_row(statement, "Fig 2", excess, error)


def _make_volume_row(plane: xr.Dataset) -> dict[str, object]:
    """Return the comparison of a surface above a volume with the surface only."""
    both, surface = (plane.sel(medium=name) for name in ("surface and volume", "surface only"))
    statement = "very rough glass: BRDF (1/sr) that the volume adds, where least significant"
    error = np.hypot(both.brdf_stderr, surface.brdf_stderr)
    return make_significance_row(statement, "Fig 3", both.brdf - surface.brdf, error)


def _make_change_row(
    plane: xr.Dataset, dimension: str, statement: str, place: str
) -> dict[str, object]:
    """Return the most significant relative change between the ends of a grid's dimension."""
    first, last = plane.isel({dimension: 0}), plane.isel({dimension: -1})
    change = (last.brdf / first.brdf - 1.0).values
    error = np.hypot(last.brdf_stderr / first.brdf, last.brdf * first.brdf_stderr / first.brdf**2)
    index = int(np.argmax(np.abs(change) - 2.0 * error.values))
    angle = float(plane.angle.values[index])
    sign = "" if change[index] > 0.0 else "less, "
    return make_significance_row(
        f"{statement} ({sign}at {angle:g}°)", place, np.abs(change[index]), error.values[index]
    )


def _make_band_limit_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the smallest decrease of reflectance with the band limit."""
    part = dataset.isel(wavelength=0)
    steps = compute_differences(-part.reflectance.values, part.reflectance_stderr.values)
    statement = "exponential correlation: reflectance falls as the band limit rises: smallest step"
    return make_significance_row(statement, "Eq 3", *steps)
