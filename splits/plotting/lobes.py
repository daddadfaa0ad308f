"""BRDFs as surfaces."""

from __future__ import annotations

from collections.abc import Mapping

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
    make_panel_title,
    select_line,
    select_point,
    to_plot_angle,
)
from splits.plotting.style import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    TWO_COLUMNS_INCHES,
    Colour,
    OffscreenFigure,
    use_style,
)

MAX_LOBE_COLUMNS = 3


def _lighten(colour: Colour) -> Colour:
    """Return a colour that shading leaves visible."""
    red, green, blue = (0.6 * c + 0.4 for c in to_rgb(colour))
    return red, green, blue


def draw_lobes(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the BRDF of every point of a grid as a surface, and its principal plane below.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of an experiment with a goniophotometer.
    at : mapping, optional
        Grid labels to hold fixed.
    """
    dataset = select_point(dataset, at)
    dataset = dataset.isel(polar=dataset.polar.values <= MAX_POLAR_DEG)
    whole = dataset.pad(azimuth=(0, 1), mode="wrap")
    azimuth = np.radians(np.append(dataset.azimuth.values, dataset.azimuth.values[0] + 360.0))
    plane = extract_plane(dataset)
    lines = make_lines(plane, "brdf").lines
    # Where nothing comes back, axes want a range all the same.
    top = 1.05 * float(dataset.brdf.max()) or 1.0
    columns = min(MAX_LOBE_COLUMNS, len(lines))
    rows = -(-len(lines) // columns)
    with use_style():
        figure = OffscreenFigure(
            ONE_COLUMN_INCHES if columns == 1 else TWO_COLUMNS_INCHES, 0.3 + 2.8 * rows
        )
        surfaces, planes = [], []
        for number, one in enumerate(lines):
            row, column = divmod(number, columns)
            place = 2 * row * columns + column + 1
            axes = figure.add_subplot(2 * rows, columns, place, projection="3d")
            lobe = select_line(whole, one.labels)
            tilt = np.radians(lobe.polar.values)[:, np.newaxis]
            radius = lobe.brdf.transpose("polar", "azimuth").values
            axes.plot_surface(
                radius * np.sin(tilt) * np.cos(azimuth),
                radius * np.sin(tilt) * np.sin(azimuth),
                radius * np.cos(tilt) * np.ones_like(azimuth),
                color=_lighten(one.colour),
                rcount=40,
                ccount=80,
                lw=0,
                ec="none",
                antialiased=False,
            )
            axes.set(xlim=(-top, top), ylim=(-top, top), zlim=(0.0, top))
            axes.set_box_aspect((2, 2, 1), zoom=1.5)
            axes.set_axis_off()
            axes.view_init(elev=20, azim=-70)
            line = select_line(plane, one.labels)
            incidence = np.radians(get_incidence_deg(line))
            arrow = 1.1 * top * np.array([-np.sin(incidence), 0.0, np.cos(incidence)])
            axes.plot(*np.stack([arrow, np.zeros(3)], axis=1), color="black", lw=0.7, ls="--")
            axes.set_title(make_panel_title(one.labels))
            flat = figure.add_subplot(2 * rows, columns, place + columns, projection="polar")
            angle = to_plot_angle(line.angle.values)
            value, error = line.brdf.values, BAND_SIGMA * line.brdf_stderr.values
            flat.plot(angle, np.maximum(value, 0.0), color=one.colour)
            low = np.maximum(value - error, 0.0)
            flat.fill_between(angle, low, value + error, color=one.colour, alpha=0.3, lw=0)
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
        return annotate_figure(figure, panels, describe_conditions(dataset, at))
