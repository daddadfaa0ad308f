"""Selection of principal planes, and axes of figures over directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from splits.analysis.directions import select_principal_plane
from splits.io.netcdf import select_points
from splits.plotting.lines import PlotLines
from splits.plotting.style import SMALL_FONT_PT

MAX_POLAR_DEG = 82.5
"""Largest angle from the normal at which directions are drawn and errors are controlled."""

QUANTITY_LABELS = {
    "brdf": "BRDF (sr⁻¹)",
    "btdf": "BTDF (sr⁻¹)",
    "reflectance_factor": "bidirectional reflectance factor",
    "anisotropy_factor": "anisotropy factor",
    "brdf_dolp": "degree of linear polarization",
}
VIEWING_ANGLE_LABEL = "viewing angle, forward positive (°)"
SHORT_ANGLE_LABEL = "viewing angle (°)"
"""Labels of the axis of angles, for large and small panels."""
MAX_INSET_LINES = 4
"""Largest number of lines with a legend inside the axes."""


def select_point(dataset: xr.Dataset, select: Mapping[str, float | str] | None) -> xr.Dataset:
    """Return the dataset at labels of its grid, with the incidence kept as an attribute."""
    select = select or {}
    attributes = {key: float(select[key]) for key in ("incidence_deg",) if key in select}
    return select_points(dataset, select).assign_attrs(attributes)


def extract_plane(dataset: xr.Dataset) -> xr.Dataset:
    """Return the principal plane up to `MAX_POLAR_DEG`, with a gap where bins have no value."""
    plane = select_principal_plane(dataset)
    plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_POLAR_DEG)
    return insert_zenith_gap(plane) if dataset.attrs.get("estimator") == "bins" else plane


def describe_bins(dataset: xr.Dataset) -> str:
    """Return the note that explains the gap around the normal; empty without angular bins."""
    if dataset.attrs.get("estimator") != "bins":
        return ""
    first = f"{float(dataset.polar.min()):.3g}°"
    return f"Lines join the centres of angular bins; the first are at {first} from the normal."


def insert_zenith_gap(plane: xr.Dataset) -> xr.Dataset:
    """Return a plane with a missing value at the zenith, so that its halves are not joined."""
    if 0.0 in plane.angle.values:
        return plane
    return plane.reindex(angle=np.sort(np.append(plane.angle.values, 0.0)))


def make_lines(dataset: xr.Dataset, quantity: str) -> PlotLines:
    """Return the lines of a quantity over directions; a single wavelength has no label."""
    directions = ("angle", "polar", "azimuth")
    dims = [str(d) for d in dataset[quantity].dims if d not in directions]
    dims = [d for d in dims if d != "wavelength" or dataset.sizes[d] > 1]
    return PlotLines(dataset, dims, use_dashes=True)


def select_line(dataset: xr.Dataset, labels: Mapping[str, float | str]) -> xr.Dataset:
    """Return the data of one line."""
    dataset = dataset.sel(labels)
    return dataset.isel(wavelength=0) if "wavelength" in dataset.dims else dataset


def to_plot_angle(angle_deg: np.ndarray, downward: bool = False) -> np.ndarray:
    """Return the angles of a polar plot (radians) for viewing angles, upward or downward."""
    angle = np.radians(angle_deg)
    return np.pi - angle if downward else angle


def get_incidence_deg(line: xr.Dataset) -> float:
    """Return the angle of incidence (degrees) of a line."""
    coordinate = line.coords.get("incidence_deg")
    return float(line.attrs["incidence_deg"] if coordinate is None else coordinate)


def format_half_circle(axes: Axes, top: float | None, downward: bool = False) -> None:
    """Format polar axes as a half circle of viewing angles, above or below the surface."""
    ticks = np.arange(-90, 91, 30)
    axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
    axes.set_theta_direction(-1)  # type: ignore[attr-defined]
    axes.set_thetalim(*np.sort(to_plot_angle(np.array([-90.0, 90.0]), downward)))  # type: ignore[attr-defined]
    axes.set_ylim(0.0, top)
    axes.set_thetagrids(  # type: ignore[attr-defined]
        np.degrees(to_plot_angle(ticks, downward)), [f"{t}°".replace("-", "−") for t in ticks]
    )
    axes.tick_params(labelsize=SMALL_FONT_PT, pad=1.0)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.grid(color=".85", lw=0.5)
