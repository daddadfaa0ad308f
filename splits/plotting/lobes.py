"""Figure of BRDFs as three-dimensional surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.direction_axes import (
    MAX_POLAR_DEG,
    QUANTITY_LABELS,
    extract_plane,
    format_half_circle,
    get_incidence_deg,
    make_lines,
    select_line,
    select_point,
    to_plot_angle,
)
from splits.plotting.panels import MAX_PANELS, check_count
from splits.plotting.style import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    TWO_COLUMNS_INCHES,
    Colour,
    OffscreenFigure,
    make_panel_title,
    use_style,
)

MAX_LOBE_COLUMNS = 3
_SURFACE_STYLE: dict[str, Any] = {
    "rcount": 40, "ccount": 80, "lw": 0, "ec": "none", "antialiased": False,
}  # fmt: skip


def _lighten(colour: Colour) -> Colour:
    """Return a lighter colour, which remains visible when shaded."""
    red, green, blue = (0.6 * c + 0.4 for c in to_rgb(colour))
    return red, green, blue


def draw_lobes(dataset: xr.Dataset, select: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the BRDF of every point of a grid as a surface, and its principal plane below.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment with a goniophotometer.
    select : mapping, optional
        Grid labels to select.
    """
    dataset = select_point(dataset, select)
    dataset = dataset.isel(polar=dataset.polar.values <= MAX_POLAR_DEG)
    periodic = dataset.pad(azimuth=(0, 1), mode="wrap")
    azimuth = np.radians(np.append(dataset.azimuth.values, dataset.azimuth.values[0] + 360.0))
    plane = extract_plane(dataset)
    lines = make_lines(plane, "brdf").lines
    check_count("surfaces", len(lines), MAX_PANELS, select)
    # Axes need a finite range even for a BRDF of 0.
    top = 1.05 * float(dataset.brdf.max()) or 1.0
    columns = min(MAX_LOBE_COLUMNS, len(lines))
    rows = -(-len(lines) // columns)
    with use_style():
        figure = OffscreenFigure(
            ONE_COLUMN_INCHES if columns == 1 else TWO_COLUMNS_INCHES, 0.3 + 2.8 * rows
        )
        surfaces, planes = [], []
        for number, grid_line in enumerate(lines):
            row, column = divmod(number, columns)
            position = 2 * row * columns + column + 1
            axes = figure.add_subplot(2 * rows, columns, position, projection="3d")
            lobe = select_line(periodic, grid_line.labels)
            polar = np.radians(lobe.polar.values)[:, np.newaxis]
            radius = lobe.brdf.transpose("polar", "azimuth").values
            axes.plot_surface(
                radius * np.sin(polar) * np.cos(azimuth),
                radius * np.sin(polar) * np.sin(azimuth),
                radius * np.cos(polar) * np.ones_like(azimuth),
                color=_lighten(grid_line.colour), **_SURFACE_STYLE,
            )  # fmt: skip
            axes.set(xlim=(-top, top), ylim=(-top, top), zlim=(0.0, top))
            axes.set_box_aspect((2, 2, 1), zoom=1.5)
            axes.set_axis_off()
            axes.view_init(elev=20, azim=-70)
            line = select_line(plane, grid_line.labels)
            incidence = np.radians(get_incidence_deg(line))
            arrow = 1.1 * top * np.array([-np.sin(incidence), 0.0, np.cos(incidence)])
            axes.plot(*np.stack([arrow, np.zeros(3)], axis=1), color="black", lw=0.7, ls="--")
            axes.set_title(make_panel_title(grid_line.labels))
            flat = figure.add_subplot(2 * rows, columns, position + columns, projection="polar")
            angle = to_plot_angle(line.angle.values)
            value, error = line.brdf.values, BAND_SIGMA * line.brdf_stderr.values
            flat.plot(angle, np.maximum(value, 0.0), color=grid_line.colour)
            low = np.maximum(value - error, 0.0)
            flat.fill_between(angle, low, value + error, color=grid_line.colour, alpha=0.3, lw=0)
            flat.plot([-incidence, -incidence], [0.0, top], color="black", lw=0.7, ls="--")
            format_half_circle(flat, top)
            surfaces.append(axes)
            planes.append(flat)
        figure.suptitle(QUANTITY_LABELS["brdf"] + ", dashed: towards the source")
        panels = [
            axes
            for first in range(0, len(lines), columns)
            for row in (surfaces, planes)
            for axes in row[first : first + columns]
        ]
        return annotate_figure(figure, panels, describe_conditions(dataset, select))
