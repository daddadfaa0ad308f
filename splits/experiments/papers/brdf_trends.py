"""Qualitative trends of BRDFs in the papers, as differences with standard errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.experiments.papers.snow_trends import compute_differences, make_significance_row

FORWARD_PEAK_ANGLES_DEG = (45.0, 82.5)
"""Range of viewing angles (degrees) in which the forward peak is searched."""

MAX_LAMBERTIAN_RANGE = 0.2
"""Largest relative range within 60° of the normal of a nearly Lambertian BRDF; chosen after
inspecting the figures."""


def compute_forward_peak(plane: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the height of the forward peak above the nadir, relative to the nadir, and its error.

    Parameters
    ----------
    plane : xarray.Dataset
        From `splits.analysis.directions.select_principal_plane`, of one wavelength.
    """
    ratio, error = _normalize_by_nadir(*_find_forward_maximum(plane), plane)
    return ratio - 1.0, error


def compute_relative_range(
    plane: xr.Dataset, max_angle_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of the BRDF up to an angle, relative to its mean, and its error."""
    part = plane.sel(angle=slice(-max_angle_deg, max_angle_deg))
    high, low = part.brdf.argmax("angle"), part.brdf.argmin("angle")
    mean = part.brdf.mean("angle")
    value = (part.brdf.isel(angle=high) - part.brdf.isel(angle=low)) / mean
    error = np.hypot(part.brdf_stderr.isel(angle=high), part.brdf_stderr.isel(angle=low)) / mean
    return np.asarray(value.values), np.asarray(error.values)


def make_brdf_trend_rows(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return one row per goniometric trend of SPLITSnow section 5.3 and SPLITS Fig 11.

    Parameters
    ----------
    datasets : mapping
        By name, some or all of `splits.experiments.studies.trends.AngularTrendsStudy`.
    """
    planes = {role: select_principal_plane(dataset) for role, dataset in datasets.items()}
    rows: list[dict[str, object]] = []
    for role, make_rows in (("incidence", _make_incidence_rows), ("grazing", _make_grazing_rows)):
        if role in planes:
            rows += make_rows(planes[role].isel(wavelength=0))
    if "wavelength" in planes:
        rows += _make_wavelength_rows(planes["wavelength"])
    rows += _make_grain_size_rows(planes)
    for role, make_rows in (("facetness", _make_facetness_rows), ("sand", _make_sand_rows)):
        if role in planes:
            rows += make_rows(planes[role].isel(wavelength=0))
    return rows


def _make_incidence_rows(plane: xr.Dataset) -> list[dict[str, object]]:
    value, error = compute_relative_range(plane.sel(incidence_deg=0.0), 60.0)
    height, height_error = compute_forward_peak(plane)
    wavelength, limit = _format_wavelength(plane), MAX_LAMBERTIAN_RANGE
    statement = f"nearly Lambertian at 0°, {wavelength}: {limit:g} less the relative range"
    rows = [make_significance_row(f"{statement} within 60°", "Fig 19", limit - value, error)]
    angles = [f"{angle:g}°" for angle in plane.incidence_deg.values]
    for i, angle in enumerate(angles[1:], start=1):
        statement = f"forward peak above the nadir at {angle}, {wavelength}"
        rows.append(make_significance_row(statement, "Fig 19", height[i], height_error[i]))
    side = plane.sel(angle=60.0)
    ratios = _normalize_by_nadir(side.brdf.values, side.brdf_stderr.values, plane)
    statement = f"forward side (60°) over the nadir rises with incidence, {', '.join(angles)}"
    steps = compute_differences(*ratios)
    rows.append(make_significance_row(f"{statement}: smallest step", "Fig 19", *steps))
    for i, (step, step_error) in enumerate(
        zip(*compute_differences(height, height_error), strict=True)
    ):
        if i:
            statement = f"forward peak higher at {angles[i + 1]} than at {angles[i]}, {wavelength}"
            rows.append(make_significance_row(statement, "Fig 19", step, step_error))
    return rows


def _make_grazing_rows(plane: xr.Dataset) -> list[dict[str, object]]:
    """Return the comparison of the brighter limb with the nadir."""
    tilt = np.abs(plane.angle)
    limb = plane.where(
        (tilt >= FORWARD_PEAK_ANGLES_DEG[0]) & (tilt <= FORWARD_PEAK_ANGLES_DEG[1]), drop=True
    )
    top = limb.isel(angle=limb.brdf.argmax("angle"))
    ratio, error = _normalize_by_nadir(top.brdf.values, top.brdf_stderr.values, plane)
    *all_but_last, last = (f"{angle:g}" for angle in plane.incidence_deg.values)
    angles = " and ".join(filter(None, [", ".join(all_but_last), last]))
    darker = f"nadir darker than the limb at {angles}°, {_format_wavelength(plane)}: smallest"
    more = "the more so the larger the incidence: smallest step"
    return [
        make_significance_row(darker, "Fig 16", ratio - 1.0, error),
        make_significance_row(more, "Fig 16", *compute_differences(ratio, error)),
    ]


def _make_wavelength_rows(plane: xr.Dataset) -> list[dict[str, object]]:
    infrared = plane.sel(wavelength=1800.0)
    nadir = infrared.sel(angle=0.0)
    sides = [infrared.sel(angle=angle) for angle in (-60.0, 60.0)]
    excess = np.array([float(s.brdf - nadir.brdf) for s in sides])
    errors = np.array([float(np.hypot(s.brdf_stderr, nadir.brdf_stderr)) for s in sides])
    value, error = compute_relative_range(plane.sel(wavelength=[600.0, 1800.0]), 82.5)
    darker = "nadir darkening at 1800 nm: below both sides at 60°"
    larger = "relative range larger at 1800 nm than at 600 nm"
    return [
        make_significance_row(darker, "Fig 17", excess, errors),
        make_significance_row(larger, "Fig 18", value[1] - value[0], np.hypot(*error)),
    ]


def _make_grain_size_rows(planes: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return the comparison of the forward peaks of fine and coarser grains.

    At 600 nm the heights above the nadir are compared as well: coarse grains transmit more light.
    """
    uniform = "Fig 20, size_sampling: uniform"
    smallest, largest = "fine grains have the smallest peak", "fine grains have the largest peak"
    least = "fine grains' peak is least above the nadir"
    rows = []
    for role, sign, place, statement, measure in (
        ("grain_size", -1.0, "Fig 20", smallest, _find_forward_maximum),
        ("grain_size_uniform", -1.0, uniform, smallest, _find_forward_maximum),
        ("grain_size", -1.0, "Fig 20", least, compute_forward_peak),
        ("grain_size_uniform", -1.0, uniform, least, compute_forward_peak),
        ("grain_size_infrared", +1.0, "Fig 21", largest, _find_forward_maximum),
    ):
        if role in planes:
            plane = planes[role].isel(wavelength=0)
            value, error = measure(plane)
            excess, excess_error = sign * (value[-1] - value[:-1]), np.hypot(error[-1], error[:-1])
            statement = f"forward, {_format_wavelength(plane)}: {statement}"
            rows.append(make_significance_row(statement, place, excess, excess_error))
    return rows


def _format_wavelength(plane: xr.Dataset) -> str:
    return f"{float(plane.wavelength):g} nm"


def _normalize_by_nadir(
    value: np.ndarray, stderr: np.ndarray, plane: xr.Dataset
) -> tuple[np.ndarray, np.ndarray]:
    """Return a BRDF relative to the nadir, and its error."""
    nadir = plane.sel(angle=0.0)
    ratio = value / nadir.brdf.values
    relative = np.hypot(stderr / value, (nadir.brdf_stderr / nadir.brdf).values)
    return np.asarray(ratio), np.asarray(ratio * relative)


def _find_forward_maximum(plane: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the BRDF at the forward peak and its error."""
    forward = plane.sel(angle=slice(*FORWARD_PEAK_ANGLES_DEG))
    top = forward.isel(angle=forward.brdf.argmax("angle"))
    return top.brdf.values, top.brdf_stderr.values


def _make_facetness_rows(plane: xr.Dataset) -> list[dict[str, object]]:
    value, error = compute_relative_range(plane, 75.0)
    incidence = f"{float(plane.attrs['incidence_deg']):g}°"
    statement = (
        f"low facetness varies most with the angle, {incidence}, {_format_wavelength(plane)}"
    )
    excess, excess_error = value[0] - value[1:], np.hypot(error[0], error[1:])
    return [make_significance_row(statement, "Fig 22", excess, excess_error)]


def _make_sand_rows(plane: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on forward scattering and retro-reflection of sand at 60 degrees."""
    part = plane.sel(incidence_deg=60.0)
    nadir = part.sel(angle=0.0)
    rows = []
    for statement, angle in (("forward scattering", 75.0), ("retro-reflection", -60.0)):
        side = part.sel(angle=angle)
        statement = f"sand, {statement} at 60° incidence, {_format_wavelength(plane)}"
        excess, error = side.brdf - nadir.brdf, np.hypot(side.brdf_stderr, nadir.brdf_stderr)
        text = f"{statement}: {angle:g}° above the nadir"
        rows.append(make_significance_row(text, "SPLITS Fig 11", excess, error))
    return rows
