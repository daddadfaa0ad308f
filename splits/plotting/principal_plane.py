"""Figures of principal planes, of angular bins of several sizes, and of polarization."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.directions import merge_angular_bins, select_principal_plane
from splits.core.inputs import get_incident_stokes
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.directions import (
    MAX_INSET_LINES,
    MAX_POLAR_DEG,
    QUANTITY_LABELS,
    SHORT_ANGLE_LABEL,
    VIEWING_ANGLE_LABEL,
    choose_directional,
    describe_bins,
    draw_dataset_maps,
    draw_maps,
    extract_plane,
    format_half_circle,
    get_incidence_deg,
    insert_zenith_gap,
    keep_incidence,
    make_lines,
    make_maps_note,
    select_line,
    to_plot_angle,
)
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Axes,
    Colour,
    Figure,
    annotate_figure,
    declare_figure,
    describe_conditions,
    draw_band,
    draw_curve,
    format_value,
    make_figure,
    make_panel_title,
    make_subplots,
    pick_colours,
    start_at_zero,
)
from splits.plotting.lines import (
    MAX_INSET_ENTRIES,
    PlotLines,
    draw_shifts,
    find_default_dim,
    make_handle,
)
from splits.plotting.settings import (
    Legend,
    Limits,
    Quantities,
    Selection,
    can_map_hemisphere,
    select_one_point,
)


@declare_figure
def draw_principal_planes(
    dataset: xr.Dataset,
    quantity: Quantities | None = None,
    select: Selection = None,
    legend: Legend = None,
    ylim: Limits = None,
) -> Figure:
    """Draw the principal plane as a polar plot and over the viewing angle, with error bands.

    Many lines over several parameters have a row of panels for every value of one of them, the
    last one with few values.
    Hemisphere maps are added for few points with directions over all azimuths.  Transmitted light
    points down in the polar plot.  If a value of the only parameter is labelled ``default``, panels
    show the shifts of the others from it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer`, of `splits.select_principal_plane`, or of an
        experiment.
    quantity : sequence of str, optional
        Keys of `splits.plotting.directions.QUANTITY_LABELS`, each with a row of panels.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    ylim : (low, high), optional
        Limits of the second panel and outer radius of the first; for shifts, limits of the panel
        of the default.
    """
    dataset = keep_incidence(select_points(dataset, select or {}), select)
    quantity = choose_directional(dataset, quantity)
    plane = extract_plane(dataset)
    note = describe_conditions(dataset, select)
    lines = make_lines(plane, quantity[0])
    if dim := find_default_dim(plane, lines.dims):
        labels = [QUANTITY_LABELS[name] for name in quantity]
        note += "; viewing angles are positive forward"
        return draw_shifts(plane, quantity, dim, "angle", (SHORT_ANGLE_LABEL, labels), note, ylim)
    # The parameter with a row of panels for every value, "" if one row shows all lines.
    varying, panel_dim = [one for one in lines.dims if plane.sizes[one] > 1], ""
    if len(varying) >= 2 and len(lines.lines) > MAX_INSET_ENTRIES:
        panel_dim = next((one for one in reversed(varying) if plane.sizes[one] <= 4), "")
    parts = [(plane, "")]
    if panel_dim:
        lines = make_lines(plane.isel({panel_dim: 0}, drop=True), quantity[0])
        points = [{panel_dim: value} for value in plane[panel_dim].values]
        parts = [(plane.sel(point), make_panel_title(point)) for point in points]
    has_all_azimuths = "azimuth_deg" in dataset.dims and can_map_hemisphere(
        dataset.polar_deg.values, dataset.azimuth_deg.values
    )
    is_mapped = has_all_azimuths and len(lines.lines) <= 4 and not panel_dim
    n_maps = len(lines.lines) if is_mapped else 0
    blocks = [(name, *part) for name in quantity for part in parts]
    figure = make_figure(TWO_COLUMNS_INCHES, (2.2 + (1.8 if n_maps > 1 else 0.0)) * len(blocks))
    rows_per_quantity = 2 if n_maps > 1 else 1
    grid = figure.add_gridspec(len(blocks) * rows_per_quantity, 1)
    planes = []
    for row, (name, part, title) in enumerate(blocks):
        plane_cells = grid[rows_per_quantity * row].subgridspec(1, 3 if n_maps == 1 else 2)
        polar = figure.add_subplot(plane_cells[0], projection="polar")
        flat = figure.add_subplot(plane_cells[1])
        _draw_plane(part, name, polar, flat, lines, ylim)
        flat.set_title(title)
        planes.append((name, polar, flat, plane_cells))
    axes_list = []
    for row, (name, polar, flat, plane_cells) in enumerate(planes):
        axes_list += [polar, flat]
        if n_maps == 1:
            axes_list += draw_maps(figure, [plane_cells[2]], dataset, name, legend)
        elif n_maps:
            map_row = grid[rows_per_quantity * row + 1].subgridspec(1, n_maps)
            map_cells = [map_row[i] for i in range(n_maps)]
            axes_list += draw_maps(figure, map_cells, dataset, name, legend)
    lines.add_legend(figure, [flat for _, _, flat, _ in planes], legend, MAX_INSET_LINES)
    maps_note = make_maps_note(quantity) if n_maps else ""
    return annotate_figure(figure, axes_list, note, describe_bins(dataset), maps_note)


def _draw_plane(
    plane: xr.Dataset, name: str, polar: Axes, flat: Axes, lines: PlotLines, ylim: Limits
) -> None:
    """Draw the principal plane of one quantity."""
    is_downward = name == "btdf"
    has_no_light = not (plane[name] > 0.0).any()
    for grid_line in () if has_no_light else lines.lines:
        line = select_line(plane, grid_line.labels)
        angle = line.angle.values
        value, error = line[name].values, line[f"{name}_stderr"].values
        plot_angle = to_plot_angle(angle, is_downward)
        style = grid_line.to_plot_style() | {"label": grid_line.label}
        polar.plot(plot_angle, np.maximum(value, 0.0), **style)
        draw_band(polar, plot_angle, value, error, 0.0, color=grid_line.colour, alpha=0.3)
        draw_curve(flat, angle, value, error, 0.0, **style)
    start_at_zero(flat, name, ylim)
    format_half_circle(polar, flat.get_ylim()[1], is_downward)
    if has_no_light:
        _annotate_no_light(plane, name, polar, flat)
    else:
        _draw_beams(polar, plane, lines, is_downward)
    # Outside the half circle, at the labels of the radii.
    polar.text(
        0.5, 0.86 if is_downward else 0.14, QUANTITY_LABELS[name], transform=polar.transAxes,
        ha="center", va="bottom" if is_downward else "top",
    )  # fmt: skip
    flat.set(xlabel=VIEWING_ANGLE_LABEL, ylabel=QUANTITY_LABELS[name])
    flat.set_xticks(np.arange(-90, 91, 30))


def _annotate_no_light(plane: xr.Dataset, name: str, *panels: Axes) -> None:
    """Write into panels that there is no light, with the error bound."""
    text = "nothing transmitted" if name == "btdf" else "nothing reflected"
    bound = BAND_SIGMA * float(plane[f"{name}_stderr"].max())
    if bound > 0.0:
        text += f"\nwithin {format_value(float(f'{bound:.1g}'))}"
        text += " sr⁻¹" if "sr⁻¹" in QUANTITY_LABELS[name] else ""
    for axes in panels:
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])


@declare_figure
def draw_bin_sizes(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw the principal plane for angular bins of several sizes.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of a goniophotometer with bins at one wavelength.
    select : mapping, optional
        Grid labels to select.
    """
    dataset = keep_incidence(select_one_point(dataset, select, "bins"), select)
    note = describe_conditions(dataset, select)
    if dataset.attrs.get("estimator") != "bins":
        raise invalid("estimator", dataset.attrs.get("estimator"), "bins for the kind 'bins'")
    dataset = dataset.isel(wavelength=0)
    n_bins = dataset.sizes["polar_deg"], dataset.sizes["azimuth_deg"]
    factors = [n for n in (9, 5, 3, 1) if n_bins[0] % n == 0 and n_bins[1] % (2 * n) == 0]
    merged = [merge_angular_bins(dataset, factor).assign_attrs(dataset.attrs) for factor in factors]
    labels = [f"{n_bins[0] // factor} × {n_bins[1] // factor}" for factor in factors]
    figure = make_figure(TWO_COLUMNS_INCHES, 4.2)
    grid = figure.add_gridspec(2, len(factors), height_ratios=(1.2, 1.0))
    axes = figure.add_subplot(grid[0, :])
    colours = pick_colours(len(factors))
    for factor, part, label, colour in zip(factors, merged, labels, colours, strict=True):
        plane = insert_zenith_gap(select_principal_plane(part))
        angle, value = plane.angle.values, plane.brdf.values
        # Larger bins have less noise and are drawn on top.
        zorder = 2.0 + 0.1 * factor
        draw_band(
            axes, angle, value, plane.brdf_stderr.values, 0.0, color=colour, alpha=0.25,
            zorder=zorder - 0.05,
        )  # fmt: skip
        axes.plot(
            angle, value, "o-", color=colour, ms=1.2 + 0.25 * factor, lw=0.4 + 0.12 * factor,
            label=label, zorder=zorder,
        )  # fmt: skip
    axes.set(xlabel=VIEWING_ANGLE_LABEL, ylabel=QUANTITY_LABELS["brdf"])
    start_at_zero(axes, "brdf")
    axes.set_xticks(np.arange(-90, 91, 30))
    axes.legend(title="bins, polar × azimuth", frameon=False)
    grid_cells = [grid[1, i] for i in range(len(factors))]
    titles = [f"bins: {label}" for label in labels]
    maps = draw_dataset_maps(figure, grid_cells, merged, titles, "brdf")
    return annotate_figure(
        figure, [axes, *maps], note, describe_bins(dataset), make_maps_note(("brdf",))
    )


def _draw_beams(axes: Axes, plane: xr.Dataset, lines: PlotLines, downward: bool) -> None:
    """Draw the direction of the source, or that of direct transmission."""
    top = axes.get_ylim()[1]
    style: dict[str, Any] = {"lw": 0.7, "ls": "-"}
    if not downward:
        style |= {"marker": "o", "ms": 3.5, "markevery": [-1], "clip_on": False}
    colours_by_incidence: dict[float, list[Colour]] = {}
    for grid_line in lines.lines:
        colours_by_incidence.setdefault(
            get_incidence_deg(select_line(plane, grid_line.labels)), []
        ).append(grid_line.colour)
    for incidence, used in colours_by_incidence.items():
        # Several beams have the colours of their lines.
        use_own_colour = len(colours_by_incidence) > 1 and used.count(used[0]) == len(used)
        plot_angle = to_plot_angle(np.full(2, incidence if downward else -incidence), downward)
        axes.plot(plot_angle, [0.0, top], color=used[0] if use_own_colour else "black", **style)
    axes.set_ylim(0.0, top)
    label = "straight on" if downward else "towards the source"
    colour = "black" if len(colours_by_incidence) == 1 else "0.5"
    axes.legend(
        handles=[make_handle(label, color=colour, **style)], frameon=False, fontsize=SMALL_FONT_PT,
        loc="lower center" if downward else "upper center",
        bbox_to_anchor=(0.5, 0.92) if downward else (0.5, 0.08),
    )  # fmt: skip


@declare_figure
def draw_polarization(
    dataset: xr.Dataset, select: Selection = None, legend: Legend = None
) -> Figure:
    """Draw the BRDF and its degree of linear polarization in the principal plane.

    The degree has a sign, −Q/I, where U is 0 by symmetry: without U and V of the incident light.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` with Stokes parameters, or of an experiment with it.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    """
    dataset = select_points(dataset, select or {})
    if "brdf_dolp" not in dataset:
        hint = "stokes, and polarized layers of particles, with next_event or bins"
        raise invalid("kind", "polarization", "left out without polarization", hint)
    plane = extract_plane(dataset)
    lines = make_lines(plane, "brdf")
    is_symmetric = not any(get_incident_stokes(dataset.attrs)[2:])
    figure, (left, right) = make_subplots(1, 2, width=TWO_COLUMNS_INCHES, height=2.6)
    for grid_line in lines.lines:
        line = select_line(plane, grid_line.labels)
        angle = line.angle.values
        value, error = line.brdf.values, line.brdf_stderr.values
        # −Q/I has no bias; without light, neither is a number.
        light = line.brdf.where(line.brdf > 0.0)
        degree = -line.brdf_q / light if is_symmetric else line.brdf_dolp.where(light > 0.0)
        style = grid_line.to_plot_style() | {"label": grid_line.label}
        draw_curve(left, angle, value, error, **style)
        draw_curve(right, angle, degree.values, line.brdf_dolp_stderr.values, **style)
    left.set_ylabel(QUANTITY_LABELS["brdf"])
    start_at_zero(left, "brdf")
    right.set_ylabel("degree of polarization" + (", −Q/I" if is_symmetric else ""))
    right.axhline(0.0, color="0.6", lw=0.6)
    for axes in (left, right):
        axes.set(xlabel=VIEWING_ANGLE_LABEL)
        axes.set_xlim(-MAX_POLAR_DEG - 5.0, MAX_POLAR_DEG + 5.0)
        axes.set_xticks(np.arange(-90, 91, 30))
    lines.add_legend(figure, [left], legend, MAX_INSET_LINES)
    return annotate_figure(
        figure, [left, right], describe_conditions(dataset, select), describe_bins(dataset)
    )
