"""Statements of SPLITSnow (section 5.3) and SPLITS (Fig 11) in words on their BRDFs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import pandas as pd
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.core.validation import invalid, unknown_key
from workflow.papers.statements import Estimate, make_significance_row, require

FORWARD_PEAK_ANGLES_DEG = (45.0, 82.5)
"""Range of viewing angles (degrees) in which the forward peak is searched."""

COMPARED_ANGLES_DEG = {-60.0, 0.0, 60.0, 75.0}
"""Viewing angles (degrees) of the BRDFs that are compared."""
MAX_LAMBERTIAN_RANGE = 0.2
"""Largest relative range within 60° of the normal of a nearly Lambertian BRDF; chosen after
inspecting the figures."""


Trend = tuple[str, str, Estimate]
"""Statement, its place in the paper, and a number that is positive if the statement holds."""


def get_brdf(plane: xr.Dataset, angle: float | list[float]) -> Estimate:
    """Return the BRDF at angles (degrees) of a principal plane."""
    return Estimate.from_dataset(plane.sel(angle=angle), "brdf")


def compute_forward_peak(plane: xr.Dataset) -> Estimate:
    """Return the height of the forward peak above the nadir, relative to the nadir, and its error.

    Parameters
    ----------
    plane : xarray.Dataset
        From `splits.analysis.directions.select_principal_plane`, of one wavelength.
    """
    return _find_maximum(plane) / get_brdf(plane, 0.0) - 1.0


def compute_relative_range(plane: xr.Dataset, max_angle_deg: float) -> Estimate:
    """Return the range of the BRDF up to an angle, relative to its mean, and its error."""
    part = plane.sel(angle=slice(-max_angle_deg, max_angle_deg))
    brdf = Estimate.from_dataset(part, "brdf")
    high, low = (brdf.isel(angle=find("angle")) for find in (part.brdf.argmax, part.brdf.argmin))
    return (high - low) / part.brdf.mean("angle")


STUDY_INPUTS = {
    "incidence": ("incidence_deg", (600.0,)),
    "grazing": ("incidence_deg", (600.0,)),
    "wavelength": ("", (600.0, 1800.0)),
    "grain_size": ("grain_size_um", (600.0,)),
    "grain_size_uniform": ("grain_size_um", (600.0,)),
    "grain_size_infrared": ("grain_size_um", (1450.0,)),
    "facetness": ("facetness", (600.0,)),
    "sand": ("incidence_deg", (600.0,)),
}
"""Parameter of the grid, and wavelengths (nm), of each run."""
INCIDENCES_DEG = {"incidence": 0.0, "sand": 60.0}
"""Incidence (degrees) that the grids of these runs contain."""


def make_brdf_trend_table(**runs: xr.Dataset) -> pd.DataFrame:
    """Return one row per goniometric trend of SPLITSnow section 5.3 and SPLITS Fig 11.

    Parameters
    ----------
    **runs : xarray.Dataset
        Some or all of `STUDY_INPUTS`.
    """
    if not runs:
        raise invalid("inputs", {}, f"with one of {', '.join(STUDY_INPUTS)}")
    planes = {}
    for key, run in runs.items():
        if key not in STUDY_INPUTS:
            raise unknown_key(f"inputs.{key}", STUDY_INPUTS)
        axis, at_nm = STUDY_INPUTS[key]
        values = {axis: (INCIDENCES_DEG[key],)} if key in INCIDENCES_DEG else None
        run = require(key, run, "brdf", (axis,) if axis else (), values=values, at_nm=at_nm)
        planes[key] = select_principal_plane(run.sel(wavelength=list(at_nm), method="nearest"))
        if not set(planes[key].angle.values) >= COMPARED_ANGLES_DEG:
            name = run.attrs.get("experiment", "")
            raise invalid(f"inputs.{key}", name, "an experiment with the usual polar_deg")
    return pd.DataFrame(make_brdf_trend_rows(planes))


def make_brdf_trend_rows(planes: Mapping[str, xr.Dataset]) -> list[dict[str, object]]:
    """Return the rows of trends for principal planes by study input."""
    # At 600 nm the heights above the nadir are compared as well: coarse grains transmit more light.
    uniform, smallest = "Fig 20, size_sampling: uniform", "fine grains have the smallest peak"
    least = "fine grains' peak is least above the nadir"
    largest = "fine grains have the largest peak"
    trends: tuple[tuple[str, Callable[[xr.Dataset], Iterator[Trend]]], ...] = (
        ("incidence", _list_incidence_trends),
        ("grazing", _list_grazing_trends),
        ("wavelength", _list_wavelength_trends),
        ("grain_size", partial(_compare_grains, -1, smallest, "Fig 20", _find_maximum)),
        ("grain_size_uniform", partial(_compare_grains, -1, smallest, uniform, _find_maximum)),
        ("grain_size", partial(_compare_grains, -1, least, "Fig 20", compute_forward_peak)),
        ("grain_size_uniform", partial(_compare_grains, -1, least, uniform, compute_forward_peak)),
        ("grain_size_infrared", partial(_compare_grains, +1, largest, "Fig 21", _find_maximum)),
        ("facetness", _list_facetness_trends),
        ("sand", _list_sand_trends),
    )
    return [
        make_significance_row(text, place, *estimate)
        for key, list_trends in trends
        if key in planes
        for text, place, estimate in list_trends(planes[key])
    ]


def _list_incidence_trends(plane: xr.Dataset) -> Iterator[Trend]:
    plane = plane.isel(wavelength=0)
    wavelength = _format_wavelength(plane)
    angles = [f"{angle:g}°" for angle in plane.incidence_deg.values]
    text = (
        f"nearly Lambertian at 0°, {wavelength}: {MAX_LAMBERTIAN_RANGE:g} less the relative range"
    )
    spread = compute_relative_range(plane.sel(incidence_deg=0.0), 60.0)
    yield f"{text} within 60°", "Fig 19", -(spread - MAX_LAMBERTIAN_RANGE)
    height = compute_forward_peak(plane)
    for i, angle in enumerate(angles[1:], start=1):
        text = f"forward peak above the nadir at {angle}, {wavelength}"
        yield text, "Fig 19", height.isel(incidence_deg=i)
    text = f"forward side (60°) over the nadir rises with incidence, {', '.join(angles)}"
    side = get_brdf(plane, 60.0) / get_brdf(plane, 0.0)
    yield f"{text}: smallest step", "Fig 19", side.diff("incidence_deg")
    steps = height.diff("incidence_deg")
    for i, (before, after) in enumerate(itertools.pairwise(angles[1:]), start=1):
        text = f"forward peak higher at {after} than at {before}, {wavelength}"
        yield text, "Fig 19", steps.isel(incidence_deg=i)


def _list_grazing_trends(plane: xr.Dataset) -> Iterator[Trend]:
    """Yield the comparison of the brighter limb with the nadir."""
    plane = plane.isel(wavelength=0)
    ratio = _find_maximum(plane, both_sides=True) / get_brdf(plane, 0.0)
    *all_but_last, last = (f"{angle:g}" for angle in plane.incidence_deg.values)
    angles = " and ".join(filter(None, [", ".join(all_but_last), last]))
    text = f"nadir darker than the limb at {angles}°, {_format_wavelength(plane)}: smallest"
    yield text, "Fig 16", ratio - 1.0
    text = "the more so the larger the incidence: smallest step"
    yield text, "Fig 16", ratio.diff("incidence_deg")


def _list_wavelength_trends(plane: xr.Dataset) -> Iterator[Trend]:
    infrared = plane.sel(wavelength=1800.0)
    excess = get_brdf(infrared, [-60.0, 60.0]) - get_brdf(infrared, 0.0)
    yield "nadir darkening at 1800 nm: below both sides at 60°", "Fig 17", excess
    spread = compute_relative_range(plane.sel(wavelength=[600.0, 1800.0]), 82.5)
    yield "relative range larger at 1800 nm than at 600 nm", "Fig 18", spread.diff("wavelength")


def _compare_grains(
    sign: int, statement: str, place: str, measure: Callable[[xr.Dataset], Estimate],
    plane: xr.Dataset,
) -> Iterator[Trend]:  # fmt: skip
    """Yield the comparison of the forward peaks of fine grains, the first, and of coarser ones."""
    plane = plane.isel(wavelength=0)
    peak = measure(plane)
    excess = peak.isel(grain_size_um=0) - peak.isel(grain_size_um=slice(1, None))
    text = f"forward, {_format_wavelength(plane)}: {statement}"
    yield text, place, excess if sign > 0 else -excess


def _list_facetness_trends(plane: xr.Dataset) -> Iterator[Trend]:
    plane = plane.isel(wavelength=0)
    spread = compute_relative_range(plane, 75.0)
    incidence = f"{float(plane.attrs['incidence_deg']):g}°"
    text = f"low facetness varies most with the angle, {incidence}, {_format_wavelength(plane)}"
    yield text, "Fig 22", spread.isel(facetness=0) - spread.isel(facetness=slice(1, None))


def _list_sand_trends(plane: xr.Dataset) -> Iterator[Trend]:
    """Yield forward scattering and retro-reflection of sand at 60 degrees."""
    plane = plane.isel(wavelength=0).sel(incidence_deg=60.0)
    for statement, angle in (("forward scattering", 75.0), ("retro-reflection", -60.0)):
        text = f"sand, {statement} at 60° incidence, {_format_wavelength(plane)}"
        excess = get_brdf(plane, angle) - get_brdf(plane, 0.0)
        yield f"{text}: {angle:g}° above the nadir", "SPLITS Fig 11", excess


def _format_wavelength(plane: xr.Dataset) -> str:
    return f"{float(plane.wavelength):g} nm"


def _find_maximum(plane: xr.Dataset, both_sides: bool = False) -> Estimate:
    """Return the BRDF at the forward peak, or that at the brighter limb, and its error."""
    low, high = FORWARD_PEAK_ANGLES_DEG
    angle = abs(plane.angle.values) if both_sides else plane.angle.values
    part = plane.isel(angle=(angle >= low) & (angle <= high))
    return Estimate.from_dataset(part, "brdf").isel(angle=part.brdf.argmax("angle"))
