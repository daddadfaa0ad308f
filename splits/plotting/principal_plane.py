"""Where light goes in the plane of the beam: principal planes, collectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from splits.analysis.directions import merge_angular_bins, select_principal_plane
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.direction_axes import (
    MAX_INSET_LINES,
    QUANTITY_LABELS,
    SHORT_ANGLE_LABEL,
    VIEWING_ANGLE_LABEL,
    extract_plane,
    format_half_circle,
    get_incidence_deg,
    insert_zenith_gap,
    make_lines,
    select_line,
    select_point,
    to_plot_angle,
)
from splits.plotting.hemispheres import draw_dataset_maps, draw_maps, make_maps_note
from splits.plotting.interpretation_shifts import draw_shifts, find_default_dim
from splits.plotting.lines import PlotLines
from splits.plotting.panels import can_map_hemisphere
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Colour,
    OffscreenFigure,
    format_value,
    pick_colours,
    use_style,
)

MAX_MAPS = 4
"""Up to so many points of a grid have maps of the hemisphere beside their principal planes."""


def draw_principal_planes(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("brdf",),
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the principal plane as a polar plot and over the viewing angle, with error bands.

    Maps of the hemisphere stand beside those of few points whose directions lie all around.  Light
    that is transmitted goes down in the polar plot.  Where one value of the grid's only parameter
    is labelled ``default``, panels show how far the others lie from it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.goniophotometer`, or of an experiment with it.
    quantity : sequence of str
        Of `splits.plotting.direction_axes.QUANTITY_LABELS`, a row of panels each.
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional
        Of the second panel, and the outer radius of the first; of the default's panel where others
        are read against it.
    """
    dataset = select_point(dataset, at)
    plane = extract_plane(dataset)
    note = describe_conditions(dataset, at)
    lines = make_lines(plane, quantity[0])
    if dim := find_default_dim(plane, lines.dims):
        labels = [QUANTITY_LABELS[name] for name in quantity]
        note += "; viewing angles are positive forward"
        return draw_shifts(plane, quantity, dim, "angle", (SHORT_ANGLE_LABEL, labels), note, ylim)
    around = can_map_hemisphere(dataset.polar.values, dataset.azimuth.values)
    maps = len(lines.lines) if around and len(lines.lines) <= MAX_MAPS else 0
    with use_style():
        figure = OffscreenFigure(
            TWO_COLUMNS_INCHES, (2.2 + (1.8 if maps > 1 else 0.0)) * len(quantity)
        )
        per = 2 if maps > 1 else 1
        grid = figure.add_gridspec(len(quantity) * per, 1)
        planes = []
        for row, name in enumerate(quantity):
            places = grid[per * row].subgridspec(1, 3 if maps == 1 else 2)
            polar = figure.add_subplot(places[0], projection="polar")
            planes.append((name, polar, figure.add_subplot(places[1]), places))
        for name, polar, flat, _ in planes:
            _draw_plane(plane, name, polar, flat, lines, ylim)
        shown = []
        for row, (name, polar, flat, places) in enumerate(planes):
            shown += [polar, flat]
            if maps == 1:
                shown += draw_maps(figure, [places[2]], dataset, name, legend)
            elif maps:
                below = grid[per * row + 1].subgridspec(1, maps)
                cells = [below[i] for i in range(maps)]
                shown += draw_maps(figure, cells, dataset, name, legend)
        lines.add_legend(figure, [flat for _, _, flat, _ in planes], legend, MAX_INSET_LINES)
        return annotate_figure(figure, shown, note, make_maps_note(quantity) if maps else "")


def _draw_plane(
    plane: xr.Dataset,
    name: str,
    polar: Axes,
    flat: Axes,
    lines: PlotLines,
    ylim: tuple[float, float] | None,
) -> None:
    """Draw one quantity."""
    down = name == "btdf"
    dark = not (plane[name] > 0.0).any()
    for one in () if dark else lines.lines:
        line = select_line(plane, one.labels)
        angle = line.angle.values
        value, error = line[name].values, BAND_SIGMA * line[f"{name}_stderr"].values
        low = np.maximum(value - error, 0.0)
        turned = to_plot_angle(angle, down)
        polar.plot(turned, np.maximum(value, 0.0), label=one.label, **one.to_plot_style())
        polar.fill_between(turned, low, value + error, color=one.colour, alpha=0.3, lw=0)
        flat.plot(angle, value, label=one.label, **one.to_plot_style())
        flat.fill_between(angle, low, value + error, color=one.colour, alpha=0.3, lw=0)
    format_half_circle(polar, ylim[1] if ylim else None, down)
    if dark:
        _annotate_no_light(plane, name, polar, flat)
    else:
        _draw_beams(polar, plane, lines, down)
    # Outside the half circle, where the radii have their numbers.
    polar.text(
        0.5, 0.86 if down else 0.14, QUANTITY_LABELS[name], transform=polar.transAxes, ha="center",
        va="bottom" if down else "top",
    )  # fmt: skip
    flat.set(xlabel=VIEWING_ANGLE_LABEL, ylabel=QUANTITY_LABELS[name], ylim=ylim or (0.0, None))
    flat.set_xticks(np.arange(-90, 91, 30))
    flat.spines[["top", "right"]].set_visible(False)


def _annotate_no_light(plane: xr.Dataset, name: str, *panels: Axes) -> None:
    """Write into panels that no light went their way, and within what error."""
    text = "nothing transmitted" if name == "btdf" else "nothing reflected"
    bound = BAND_SIGMA * float(plane[f"{name}_stderr"].max())
    if bound > 0.0:
        text += f"\nwithin {format_value(float(f'{bound:.1g}'))}"
        text += " sr⁻¹" if "sr⁻¹" in QUANTITY_LABELS[name] else ""
    for axes in panels:
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])


def draw_bin_sizes(dataset: xr.Dataset, at: Mapping[str, float | str] | None = None) -> Figure:
    """Draw the principal plane as cells of several sizes see it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of a goniophotometer with cells, without a grid or at one point of it; one wavelength.
    at : mapping, optional
        Grid labels to hold fixed.
    """
    dataset = select_point(dataset, at)
    note = describe_conditions(dataset, at)
    dataset = dataset.isel(wavelength=0)
    counts = dataset.sizes["polar"], dataset.sizes["azimuth"]
    factors = [f for f in (9, 5, 3, 1) if not (counts[0] % f or counts[1] % (2 * f))]
    merged = [merge_angular_bins(dataset, factor).assign_attrs(dataset.attrs) for factor in factors]
    labels = [f"{counts[0] // factor} × {counts[1] // factor}" for factor in factors]
    with use_style():
        figure = OffscreenFigure(TWO_COLUMNS_INCHES, 4.2)
        grid = figure.add_gridspec(2, len(factors), height_ratios=(1.2, 1.0))
        axes = figure.add_subplot(grid[0, :])
        shades = pick_colours(len(factors))
        for factor, part, label, colour in zip(factors, merged, labels, shades, strict=True):
            plane = insert_zenith_gap(select_principal_plane(part))
            angle, value = plane.angle.values, plane.brdf.values
            error = BAND_SIGMA * plane.brdf_stderr.values
            # The larger the cells, the less noise: they lie on top.
            above = 2.0 + 0.1 * factor
            axes.fill_between(
                angle, np.maximum(value - error, 0.0), value + error, color=colour, alpha=0.25,
                lw=0, zorder=above - 0.05,
            )  # fmt: skip
            axes.plot(
                angle, value, "o-", color=colour, ms=1.2 + 0.25 * factor, lw=0.4 + 0.12 * factor,
                label=label, zorder=above,
            )  # fmt: skip
        axes.set(xlabel=VIEWING_ANGLE_LABEL, ylabel=QUANTITY_LABELS["brdf"], ylim=(0.0, None))
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(title="cells, polar × around", frameon=False)
        places = [grid[1, i] for i in range(len(factors))]
        maps = draw_dataset_maps(figure, places, merged, labels, "brdf")
        return annotate_figure(figure, [axes, *maps], note, make_maps_note(("brdf",)))


def _draw_beams(axes: Axes, plane: xr.Dataset, lines: PlotLines, downward: bool) -> None:
    """Draw where the light comes from, or where it would go straight on."""
    top = axes.get_ylim()[1]
    shades: dict[float, list[Colour]] = {}
    for one in lines.lines:
        shades.setdefault(get_incidence_deg(select_line(plane, one.labels)), []).append(one.colour)
    for incidence, used in shades.items():
        # Several beams have the colours of their lines.
        own = len(shades) > 1 and used.count(used[0]) == len(used)
        turned = to_plot_angle(np.full(2, incidence if downward else -incidence), downward)
        axes.plot(
            turned, [0.0, top], color=used[0] if own else "black", **_get_beam_style(downward)
        )
    axes.set_ylim(0.0, top)
    told = Line2D([], [], color="black" if len(shades) == 1 else "0.5", **_get_beam_style(downward))
    told.set_label("straight on" if downward else "towards the source")
    axes.legend(
        handles=[told], frameon=False, fontsize=SMALL_FONT_PT,
        loc="lower center" if downward else "upper center",
        bbox_to_anchor=(0.5, 0.92) if downward else (0.5, 0.08),
    )  # fmt: skip


def _get_beam_style(downward: bool) -> dict[str, Any]:
    mark: dict[str, Any] = (
        {} if downward else {"marker": "o", "ms": 3.5, "markevery": [-1], "clip_on": False}
    )
    return {"lw": 0.7, "ls": "-", **mark}
