"""Figures over directions: axes, hemisphere maps, and BRDFs as three-dimensional surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from splits.analysis.directions import select_principal_plane
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.grammar import (
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Axes,
    Figure,
    annotate_figure,
    declare_figure,
    describe_conditions,
    draw_band,
    make_figure,
    make_panel_title,
)
from splits.plotting.lines import PlotLines
from splits.plotting.settings import (
    MAX_AZIMUTH_GAP_DEG,
    MAX_PANELS,
    MIN_AZIMUTHS,
    MIN_POLAR_ANGLES,
    Legend,
    Quantities,
    Selection,
    can_map_hemisphere,
    check_count,
    choose_quantities,
    select_one_point,
)

if TYPE_CHECKING:
    from matplotlib.colors import Normalize
    from matplotlib.gridspec import SubplotSpec

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


def keep_incidence(dataset: xr.Dataset, select: Mapping[str, float | str] | None) -> xr.Dataset:
    """Return a dataset with the selected angle of incidence as an attribute."""
    incidence = (select or {}).get("incidence_deg")
    return dataset if incidence is None else dataset.assign_attrs(incidence_deg=float(incidence))


def choose_directional(dataset: xr.Dataset, given: Sequence[str] | None) -> tuple[str, ...]:
    """Return the given quantities over directions, by default the first one."""
    return choose_quantities(dataset, given, [name for name in QUANTITY_LABELS if name in dataset])


def extract_plane(dataset: xr.Dataset) -> xr.Dataset:
    """Return the principal plane up to `MAX_POLAR_DEG`, with a gap where bins have no value.

    The dataset may be that of a plane.
    """
    plane = dataset if "angle" in dataset.dims else select_principal_plane(dataset)
    plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_POLAR_DEG)
    return insert_zenith_gap(plane) if dataset.attrs.get("estimator") == "bins" else plane


def describe_bins(dataset: xr.Dataset) -> str:
    """Return the note that explains the gap around the normal; empty without angular bins."""
    if dataset.attrs.get("estimator") != "bins":
        return ""
    first = f"{float(dataset.polar_deg.min()):.3g}°"
    return f"Lines join the centres of angular bins; the first are at {first} from the normal."


def insert_zenith_gap(plane: xr.Dataset) -> xr.Dataset:
    """Return a plane with a missing value at the zenith, so that its halves are not joined."""
    if 0.0 in plane.angle.values:
        return plane
    return plane.reindex(angle=np.sort(np.append(plane.angle.values, 0.0)))


def make_lines(dataset: xr.Dataset, quantity: str) -> PlotLines:
    """Return the lines of a quantity over directions; a single wavelength has no label."""
    directions = ("angle", "polar_deg", "azimuth_deg")
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
    from matplotlib.ticker import MaxNLocator

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


RING_ANGLES_DEG = (30.0, 60.0)
_MAX_ANGLE_STDERR_DEG = 20.0
"""Largest error (degrees) of an angle of linear polarization that is drawn."""
_LINE_LENGTH_DEG = 9.0
"""Length of its lines, in degrees of the polar angle."""


@declare_figure
def draw_hemispheres(
    dataset: xr.Dataset,
    quantity: Quantities | None = None,
    select: Selection = None,
    legend: Legend = None,
) -> Figure:
    """Draw a hemisphere map for every point of a grid.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` or of an experiment with it, over all azimuths.
    quantity : sequence of str, optional
        Keys of `splits.plotting.directions.QUANTITY_LABELS`; each has a block of maps with its
        own scale.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Name of a single varying parameter; that of the parameter by default.
    """
    dataset = keep_incidence(select_points(dataset, select or {}), select)
    quantity = choose_directional(dataset, quantity)
    if not can_map_hemisphere(dataset.polar_deg.values, dataset.azimuth_deg.values):
        allowed = (
            f"another kind, such as principal_plane: a map needs at least {MIN_POLAR_ANGLES} polar "
            f"angles and {MIN_AZIMUTHS} azimuths at most {MAX_AZIMUTH_GAP_DEG:g} degrees apart, "
            "all around"
        )
        hint = f"here are {dataset.sizes['polar_deg']} and {dataset.sizes['azimuth_deg']}"
        raise invalid("kind", "hemisphere", allowed, hint)
    count = len(make_lines(dataset, quantity[0]).lines)
    check_count("maps", count * len(quantity), MAX_PANELS, select)
    columns = min(4, count)
    rows = -(-count // columns)
    width = ONE_COLUMN_INCHES if count == 1 else TWO_COLUMNS_INCHES
    block_height = 2.6 if count == 1 else 0.25 + 1.75 * rows
    figure = make_figure(width, block_height * len(quantity))
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
    lines = (
        "; lines: direction of polarization at some angles, errors below "
        f"{_MAX_ANGLE_STDERR_DEG:g}°"
        if "brdf_dolp" in quantity
        else ""
    )
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
        See `splits.plotting.directions.select_point`.
    name : str
        Name of the quantity.
    legend : str, optional
        Name of a single varying parameter; that of the parameter by default.

    Returns
    -------
    list of matplotlib.axes.Axes
        Axes of the maps, in the order of the points.
    """
    shown = dataset.isel(polar_deg=dataset.polar_deg.values <= MAX_POLAR_DEG)
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
    """Draw maps of datasets over ``polar_deg`` and ``azimuth_deg`` only, see `draw_maps`."""
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.ticker import LogLocator

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
    from matplotlib.colors import LogNorm, Normalize

    positive = values[values > 0.0]
    if positive.size == 0:
        return Normalize(0.0, 1.0)
    low, high = float(np.quantile(positive, 0.01)), float(positive.max())
    return LogNorm(max(low, 0.01 * high), high) if high > 10.0 * low else Normalize(low, high)


def _make_mesh(part: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the borders of bins in azimuth (radians) and polar angle (degrees), and their values.

    Wide bins are subdivided so that their borders are round.
    """
    part = part.sortby("azimuth_deg").sortby("polar_deg")
    azimuth, polar = part.azimuth_deg.values, part.polar_deg.values
    # At least 180 steps of azimuth.
    n_cuts = -(-180 // azimuth.size)
    steps = np.diff(azimuth, append=azimuth[0] + 360.0)
    first = azimuth[0] - 0.5 * steps[-1]
    borders = np.append(first, azimuth + 0.5 * steps)
    azimuth_borders = np.interp(
        np.arange(n_cuts * steps.size + 1) / n_cuts, np.arange(borders.size), borders
    )
    middle = 0.5 * (polar[1:] + polar[:-1])
    step = polar[-1] - polar[-2] if polar.size > 1 else 90.0
    last = min(90.0, polar[-1] + 0.5 * step)
    values = part[name].transpose("polar_deg", "azimuth_deg").values
    polar_borders = np.concatenate([[0.0], middle, [last]])
    return np.radians(azimuth_borders), polar_borders, np.repeat(values, n_cuts, axis=1)


def _draw_map(axes: Axes, part: xr.Dataset, name: str, norm: Normalize) -> Any:
    """Draw one map, forward to the right, and the directions of the beam."""
    azimuth_borders, polar_borders, values = _make_mesh(part, name)
    axes.grid(False)
    image = axes.pcolormesh(
        azimuth_borders, polar_borders, np.clip(values, norm.vmin, norm.vmax), norm=norm,
        cmap="cividis", rasterized=True,
    )  # fmt: skip
    for ring in RING_ANGLES_DEG:
        axes.plot(
            azimuth_borders, np.full(azimuth_borders.size, ring), color="white", lw=0.5, alpha=0.7
        )
    incidence = get_incidence_deg(part)
    marker: dict[str, Any] = {
        "ls": "none", "mfc": "white", "mec": "black", "mew": 0.7, "clip_on": False,
    }  # fmt: skip
    axes.plot([0.0], [incidence], "D", ms=3, **marker)
    if name != "btdf":
        axes.plot([np.pi], [incidence], "o", ms=4, **marker)
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
        polar_deg=slice(None, None, -(-part.sizes["polar_deg"] // 6)),
        azimuth_deg=slice(None, None, -(-part.sizes["azimuth_deg"] // 12)),
    ).transpose(..., "polar_deg", "azimuth_deg")
    radius, azimuth = np.meshgrid(
        part.polar_deg.values, np.radians(part.azimuth_deg.values), indexing="ij"
    )
    shown = (part.brdf_aolp_stderr.values < _MAX_ANGLE_STDERR_DEG) & (radius > _LINE_LENGTH_DEG)
    radius, azimuth = radius[shown], azimuth[shown]
    angle = azimuth + np.radians(part.brdf_aolp.values[shown])
    ends = [
        radius * np.exp(1j * azimuth) + sign * 0.5 * _LINE_LENGTH_DEG * np.exp(1j * angle)
        for sign in (-1.0, 1.0)
    ]
    axes.plot(np.angle(ends), np.abs(ends), color="white", lw=0.8)


@declare_figure
def draw_lobes(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw the BRDF of every point of a grid as a surface, and its principal plane below.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment with a goniophotometer.
    select : mapping, optional
        Grid labels to select.
    """
    from matplotlib.colors import to_rgb

    dataset = keep_incidence(select_one_point(dataset, select, "lobes", max_free=1), select)
    dataset = dataset.isel(polar_deg=dataset.polar_deg.values <= MAX_POLAR_DEG)
    periodic = dataset.pad(azimuth_deg=(0, 1), mode="wrap")
    azimuth = np.radians(
        np.append(dataset.azimuth_deg.values, dataset.azimuth_deg.values[0] + 360.0)
    )
    plane = extract_plane(dataset)
    lines = make_lines(plane, "brdf").lines
    check_count("surfaces", len(lines), MAX_PANELS, select)
    # Axes need a finite range even for a BRDF of 0.
    top = 1.05 * float(dataset.brdf.max()) or 1.0
    columns = min(3, len(lines))
    rows = -(-len(lines) // columns)
    width = ONE_COLUMN_INCHES if columns == 1 else TWO_COLUMNS_INCHES
    figure = make_figure(width, 0.3 + 2.8 * rows)
    surfaces, planes = [], []
    for number, grid_line in enumerate(lines):
        row, column = divmod(number, columns)
        position = 2 * row * columns + column + 1
        axes = figure.add_subplot(2 * rows, columns, position, projection="3d")
        lobe = select_line(periodic, grid_line.labels)
        polar = np.radians(lobe.polar_deg.values)[:, np.newaxis]
        radius = lobe.brdf.transpose("polar_deg", "azimuth_deg").values
        axes.plot_surface(
            radius * np.sin(polar) * np.cos(azimuth),
            radius * np.sin(polar) * np.sin(azimuth),
            radius * np.cos(polar) * np.ones_like(azimuth),
            # Lighter, so that it remains visible when shaded.
            color=[0.6 * c + 0.4 for c in to_rgb(grid_line.colour)],
            rcount=40, ccount=80, lw=0, ec="none", antialiased=False,
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
        value, error = line.brdf.values, line.brdf_stderr.values
        flat.plot(angle, np.maximum(value, 0.0), color=grid_line.colour)
        draw_band(flat, angle, value, error, 0.0, color=grid_line.colour, alpha=0.3)
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
