"""Hemisphere maps of directional quantities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import LogLocator

from splits.core.validation import invalid
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.direction_axes import (
    MAX_POLAR_DEG,
    QUANTITY_LABELS,
    get_incidence_deg,
    make_lines,
    select_line,
    select_point,
)
from splits.plotting.panels import (
    MAX_AZIMUTH_GAP_DEG,
    MAX_PANELS,
    MIN_AZIMUTHS,
    MIN_POLAR_ANGLES,
    can_map_hemisphere,
    check_count,
)
from splits.plotting.style import (
    ONE_COLUMN_INCHES,
    TWO_COLUMNS_INCHES,
    OffscreenFigure,
    make_panel_title,
    use_style,
)

MAX_MAP_COLUMNS = 4
RING_ANGLES_DEG = (30.0, 60.0)
_LOG_SCALE_RATIO = 10.0
"""Ratio of values above which the colour scale is logarithmic."""
_MIN_RELATIVE_VALUE = 0.01
"""Lower end of a logarithmic colour scale, relative to the largest value."""
_MAP_HEIGHT_INCHES = 1.75
_MAX_ANGLE_STDERR_DEG = 20.0
"""Largest error (degrees) of an angle of linear polarization that is drawn."""
_LINE_LENGTH_DEG = 9.0
"""Length of its lines, in degrees of the polar angle."""
_MIN_AZIMUTH_STEPS = 180
"""Smallest number of azimuth steps for round borders of bins."""
_MARKER_STYLE: dict[str, Any] = {
    "ls": "none",
    "mfc": "white",
    "mec": "black",
    "mew": 0.7,
    "clip_on": False,
}


def draw_hemispheres(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("brdf",),
    select: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw a hemisphere map for every point of a grid.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` or of an experiment with it, over all azimuths.
    quantity : sequence of str
        Keys of `splits.plotting.direction_axes.QUANTITY_LABELS`; each has a block of maps with its
        own scale.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Name of a single varying parameter; that of the parameter by default.
    """
    dataset = select_point(dataset, select)
    if not can_map_hemisphere(dataset.polar.values, dataset.azimuth.values):
        allowed = (
            f"another kind, such as principal_plane: a map needs at least {MIN_POLAR_ANGLES} polar "
            f"angles and {MIN_AZIMUTHS} azimuths at most {MAX_AZIMUTH_GAP_DEG:g} degrees apart, "
            "all around"
        )
        hint = f"here are {dataset.sizes['polar']} and {dataset.sizes['azimuth']}"
        raise invalid("figure.kind", "hemisphere", allowed, hint)
    count = len(make_lines(dataset, quantity[0]).lines)
    check_count("maps", count * len(quantity), MAX_PANELS, select)
    columns = min(MAX_MAP_COLUMNS, count)
    rows = -(-count // columns)
    with use_style():
        width = ONE_COLUMN_INCHES if count == 1 else TWO_COLUMNS_INCHES
        block_height = 2.6 if count == 1 else 0.25 + _MAP_HEIGHT_INCHES * rows
        figure = OffscreenFigure(width, block_height * len(quantity))
        grid = figure.add_gridspec(rows * len(quantity), columns)
        panels = []
        for number, name in enumerate(quantity):
            grid_cells = [grid[number * rows + i // columns, i % columns] for i in range(count)]
            panels += draw_maps(figure, grid_cells, dataset, name, legend)
        return annotate_figure(
            figure, panels, describe_conditions(dataset, select, ""), make_maps_note(quantity)
        )


def make_maps_note(quantity: Sequence[str]) -> str:
    """Return the note that explains the maps."""
    largest = f"{_MAX_ANGLE_STDERR_DEG:g}°"
    lines = f"; lines: direction of polarization at some angles, errors below {largest}"
    lines = lines if "brdf_dolp" in quantity else ""
    transmitted = "diamond: straight on" if "btdf" in quantity else ""
    reflected = ["circle: towards the source", "diamond: mirror direction"]
    circles = " and ".join(f"{angle:g}°" for angle in RING_ANGLES_DEG)
    marks = (
        [transmitted]
        if tuple(quantity) == ("btdf",)
        else reflected + ([f"of BTDF {transmitted}"] if transmitted else [])
    )
    return (
        f"Maps: rings at {circles} from the normal, up to {MAX_POLAR_DEG:g}°; "
        f"{'; '.join(marks)}{lines}."
    )


def draw_maps(
    figure: Figure,
    grid_cells: Sequence[SubplotSpec],
    dataset: xr.Dataset,
    name: str,
    legend: str | None = None,
) -> list[Axes]:
    """Draw the maps of a quantity for every point of a grid, with a common scale.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    grid_cells : sequence of matplotlib.gridspec.SubplotSpec
        One per point.
    dataset : xarray.Dataset
        See `splits.plotting.direction_axes.select_point`.
    name : str
        Name of the quantity.
    legend : str, optional
        Name of a single varying parameter; that of the parameter by default.

    Returns
    -------
    list of matplotlib.axes.Axes
        Axes of the maps, in the order of the points.
    """
    shown = dataset.isel(polar=dataset.polar.values <= MAX_POLAR_DEG)
    points = make_lines(dataset, name).lines
    parts = [select_line(shown, point.labels) for point in points]
    titles = [make_panel_title(point.labels, legend) for point in points]
    return draw_dataset_maps(figure, grid_cells, parts, titles, name)


def draw_dataset_maps(
    figure: Figure,
    grid_cells: Sequence[SubplotSpec],
    parts: Sequence[xr.Dataset],
    titles: Sequence[str],
    name: str,
) -> list[Axes]:
    """Draw maps of datasets over ``polar`` and ``azimuth`` only, see `draw_maps`."""
    values = np.concatenate([part[name].values.ravel() for part in parts])
    is_degree = name == "brdf_dolp"
    norm = Normalize(0.0, float(values.max()) or 1.0) if is_degree else _make_colour_scale(values)
    panels = []
    for cell, part, title in zip(grid_cells, parts, titles, strict=True):
        axes = figure.add_subplot(cell, projection="polar")
        image = _draw_map(axes, part, name, norm)
        if is_degree:
            _draw_polarization_angles(axes, part)
        axes.set_title(title)
        panels.append(axes)
    label = QUANTITY_LABELS[name]
    colour_bar = figure.colorbar(image, ax=panels, label=label, pad=0.02, aspect=15, fraction=0.05)
    if isinstance(norm, LogNorm):
        colour_bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        colour_bar.ax.yaxis.set_major_formatter("{x:g}")
        colour_bar.minorticks_off()
    return panels


def _make_colour_scale(values: np.ndarray) -> Normalize:
    """Return a colour scale for values, logarithmic where they span a large factor."""
    positive = values[values > 0.0]
    if positive.size == 0:
        return Normalize(0.0, 1.0)
    low, high = float(np.quantile(positive, 0.01)), float(positive.max())
    if high > _LOG_SCALE_RATIO * low:
        return LogNorm(max(low, _MIN_RELATIVE_VALUE * high), high)
    return Normalize(low, high)


def _make_mesh(part: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the borders of bins in azimuth (radians) and polar angle (degrees), and their values.

    Wide bins are subdivided so that their borders are round.
    """
    part = part.sortby("azimuth").sortby("polar")
    azimuth, polar = part.azimuth.values, part.polar.values
    n_cuts = -(-_MIN_AZIMUTH_STEPS // azimuth.size)
    steps = np.diff(azimuth, append=azimuth[0] + 360.0)
    first = azimuth[0] - 0.5 * steps[-1]
    borders = np.append(first, azimuth + 0.5 * steps)
    azimuth_borders = np.interp(
        np.arange(n_cuts * steps.size + 1) / n_cuts, np.arange(borders.size), borders
    )
    middle = 0.5 * (polar[1:] + polar[:-1])
    step = polar[-1] - polar[-2] if polar.size > 1 else 90.0
    last = min(90.0, polar[-1] + 0.5 * step)
    values = part[name].transpose("polar", "azimuth").values
    polar_borders = np.concatenate([[0.0], middle, [last]])
    return np.radians(azimuth_borders), polar_borders, np.repeat(values, n_cuts, axis=1)


def _draw_map(axes: Axes, part: xr.Dataset, name: str, norm: Normalize) -> Any:
    """Draw one map, forward to the right, and the directions of the beam."""
    azimuth_borders, polar_borders, values = _make_mesh(part, name)
    axes.grid(False)
    image = axes.pcolormesh(
        azimuth_borders,
        polar_borders,
        np.clip(values, norm.vmin, norm.vmax),
        norm=norm,
        cmap="cividis",
        rasterized=True,
    )
    for ring in RING_ANGLES_DEG:
        axes.plot(
            azimuth_borders, np.full(azimuth_borders.size, ring), color="white", lw=0.5, alpha=0.7
        )
    incidence = get_incidence_deg(part)
    axes.plot([0.0], [incidence], "D", ms=3, **_MARKER_STYLE)
    if name != "btdf":
        axes.plot([np.pi], [incidence], "o", ms=4, **_MARKER_STYLE)
    axes.set_ylim(0.0, 90.0)
    axes.set(xticks=[], yticks=[])
    axes.set_xlabel("forward →", labelpad=1.0)
    if not (values > 0.0).any():
        axes.text(0.5, 0.5, "nothing", transform=axes.transAxes, ha="center", va="center",
                  color="white")  # fmt: skip
    return image


def _draw_polarization_angles(axes: Axes, part: xr.Dataset) -> None:
    """Draw the angle of linear polarization as lines, where its error is small.

    Seen from above, the angle increases anticlockwise from the radius of the map.
    """
    part = part.isel(
        polar=slice(None, None, -(-part.sizes["polar"] // 6)),
        azimuth=slice(None, None, -(-part.sizes["azimuth"] // 12)),
    ).transpose(..., "polar", "azimuth")
    radius, azimuth = np.meshgrid(part.polar.values, np.radians(part.azimuth.values), indexing="ij")
    shown = (part.brdf_aolp_stderr.values < _MAX_ANGLE_STDERR_DEG) & (radius > _LINE_LENGTH_DEG)
    radius, azimuth = radius[shown], azimuth[shown]
    angle = azimuth + np.radians(part.brdf_aolp.values[shown])
    ends = [
        radius * np.exp(1j * azimuth) + sign * 0.5 * _LINE_LENGTH_DEG * np.exp(1j * angle)
        for sign in (-1.0, 1.0)
    ]
    axes.plot(np.angle(ends), np.abs(ends), color="white", lw=0.8)
