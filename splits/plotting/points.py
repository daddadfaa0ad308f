"""Figures of values at points of a grid: error bars, summaries of tables, colour swatches."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.colour import make_colour_table
from splits.core.escaping import escape_mathtext
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.grammar import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Axes,
    Figure,
    add_notes,
    annotate_figure,
    declare_figure,
    describe_conditions,
    format_parameter,
    format_point,
    format_value,
    make_subplots,
    pick_colours,
    select_evenly,
)
from splits.plotting.lines import (
    INDEPENDENCE_NOTE,
    PlotLines,
    compute_shift,
    find_default_dim,
    format_names,
    place_legend_beside,
)
from splits.plotting.principal_plane import draw_principal_planes
from splits.plotting.settings import (
    DEFAULT_LABEL,
    MAX_ROWS,
    Legend,
    Quantities,
    Selection,
    check_count,
    choose_quantities,
)
from splits.plotting.spectra import draw_small_multiples, draw_spectra, list_spectral_quantities
from splits.tables.axes import AZIMUTH, INCIDENCE, VIEW_AXES, VIEW_QUANTITIES


@declare_figure
def draw_points(
    dataset: xr.Dataset,
    quantity: Quantities | None = None,
    select: Selection = None,
    legend: Legend = None,
) -> Figure:
    """Draw quantities at the points of a grid, a panel each with one series per wavelength.

    If a value of the only parameter is labelled ``default``, the others are shown as shifts from
    it.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment.
    quantity : sequence of str, optional
        By default the first one over wavelength; also lengths without errors.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Label of the points; by default the parameters of the grid.
    """
    dataset = select_points(dataset, select or {})
    lengths = [name for name in ("mean_grain_distance",) if name in dataset]
    quantity = choose_quantities(dataset, quantity, list_spectral_quantities(dataset) + lengths)
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    points = itertools.product(*(dataset[d].values for d in dims))
    names = [format_point(dict(zip(dims, values, strict=True))) for values in points]
    check_count("points", len(names), MAX_ROWS, select)
    dim = find_default_dim(dataset, dims)
    series = PlotLines(dataset, ["wavelength"])
    figure, panels = make_subplots(
        1, len(quantity), width=ONE_COLUMN_INCHES if len(quantity) == 1 else TWO_COLUMNS_INCHES,
        height=0.7 + 0.17 * max(len(names), 4), sharey=True, squeeze=False,
    )  # fmt: skip
    for axes, name in zip(panels[0], quantity, strict=True):
        long_name = escape_mathtext(str(dataset[name].attrs.get("long_name", name)))
        if "wavelength" in dataset[name].dims:
            _draw_series(axes, dataset, name, series, dim)
            axes.set_xlabel(_make_axis_label(dataset, name, long_name, dim))
        else:
            # Lengths have no errors.
            values = 1e3 * dataset[name].values.ravel()
            axes.plot(values, range(values.size), "o", color=pick_colours(1)[0])
            for y, x in enumerate(values):
                axes.annotate(
                    f"{x:.3f}", (x, y), xytext=(5, 0), textcoords="offset points", va="center",
                    fontsize=SMALL_FONT_PT,
                )  # fmt: skip
            axes.set_xlim(0, 1.2 * values.max())
            axes.set_xlabel(f"{long_name} (mm)")
        axes.grid(axis="x", alpha=0.3)
        axes.set_ylim(len(names) - 0.4, -0.6)
    first = panels[0, 0]
    first.set_yticks(range(len(names)), names)
    first.set_ylabel(legend or "\n".join(map(format_parameter, dims)))
    has_spectra = any("wavelength" in dataset[name].dims for name in quantity)
    handles = max((axes.get_legend_handles_labels()[0] for axes in panels[0]), key=len)
    if series.has_colour_bar and handles:
        series.add_legend(figure, list(panels[0]))
    elif len(handles) > 1:
        place_legend_beside(figure, handles, format_names(series.dims))
    shift_note = f"Shifts: {INDEPENDENCE_NOTE}." if dim and has_spectra else ""
    band = "bars" if has_spectra else ""
    return annotate_figure(
        figure, panels[0], describe_conditions(dataset, select, band), shift_note
    )


def _make_axis_label(dataset: xr.Dataset, name: str, long_name: str, dim: str | None) -> str:
    """Return the label of an axis; for shifts with the values of the default."""
    if dim is None:
        return long_name
    values = dataset[name].sel({dim: DEFAULT_LABEL}).values.ravel()
    x = dataset.wavelength.values
    if values.size > 4:
        stated = f"{values.min():.3f}–{values.max():.3f}"
    else:
        stated = ", ".join(f"{v:.3f} ({w:g} nm)" for v, w in zip(values, x, strict=True))
    return f"{long_name}, shift from the default\ndefault: {stated}"


def _draw_series(
    axes: Axes, dataset: xr.Dataset, name: str, series: PlotLines, dim: str | None
) -> None:
    """Draw the values of all points at every wavelength, or their shifts."""
    value, error = dataset[name], dataset[f"{name}_stderr"]
    if dim:
        value, error = compute_shift(dataset, name, dim)
        others = value[dim] != DEFAULT_LABEL
        value, error = value.where(others, 0.0), error.where(others, 0.0)
        axes.axvline(0.0, color="black", lw=0.6, zorder=1.0)
    n_series = len(series.lines)
    for number, line in enumerate(series.lines):
        x = value.sel(line.labels).values.ravel()
        # The series are spread over 0.6 of a row.
        y = np.arange(x.size) + 0.6 * ((number + 0.5) / n_series - 0.5)
        axes.errorbar(
            x, y, xerr=BAND_SIGMA * error.sel(line.labels).values.ravel(),
            fmt="o", ms=2.5, color=line.colour, elinewidth=0.8, label=line.label,
        )  # fmt: skip


MAX_SUMMARY_LINES = 6
"""Largest number of values of the axis whose spectra are lines."""


@declare_figure
def draw_summary(
    dataset: xr.Dataset,
    quantity: Quantities | None = None,
    select: Selection = None,
    legend: Legend = None,
) -> Figure:
    """Draw spectra of a table: lines along its longest axis, panels along the next two.

    A table of reflectance or anisotropy factors over directions is drawn in the principal plane
    instead, with lines along its angles of incidence, at wavelengths where snow is bright, medium
    and dark.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.build_table`.
    quantity : sequence of str, optional
        By default the first one over wavelength.
    select : mapping, optional
        Nodes at which axes are fixed.  Remaining axes, and directions of observation, are fixed at
        their middle node.
    legend : str, optional
        Title of the legend.
    """
    select = select or {}
    quantity = choose_quantities(dataset, quantity, list_spectral_quantities(dataset))
    largest = max((dataset[name] for name in quantity), key=lambda one: one.ndim)
    axes = [str(d) for d in largest.dims if d != "wavelength"]
    part = dataset[[f"{name}{suffix}" for name in quantity for suffix in ("", "_stderr")]]
    part = part.sel(select)
    free = sorted((n for n in axes if n not in select), key=lambda n: -dataset.sizes[n])
    views = [name for name in free if name in VIEW_AXES and dataset.sizes[name] > 1]
    is_directional = all(name in VIEW_QUANTITIES for name in quantity)
    # Under beams, and with both sides of the principal plane.
    is_beam = INCIDENCE not in dataset.dims or dataset[INCIDENCE].dtype.kind in "fi"
    is_directional = is_directional and is_beam and len(views) == len(VIEW_AXES)
    if is_directional and np.isin([0.0, 180.0], dataset[AZIMUTH]).all():
        return _draw_views(dataset.sel(select), quantity, legend)
    free = [name for name in free if name not in VIEW_AXES and dataset.sizes[name] > 1]
    lines, panel_dims, rest = free[:1], free[1:3], free[3:] + views
    single = [n for n in axes if n not in select and dataset.sizes[n] == 1]
    # Rows and columns of panels, of which the shorter axis has the rows.
    panel_dims = panel_dims[::-1]
    counts = [MAX_SUMMARY_LINES, *((3, 4) if len(panel_dims) == 2 else (12,))]
    part = part.isel({n: (dataset.sizes[n] - 1) // 2 for n in (*rest, *single)})
    part = part.isel(
        {
            n: select_evenly(dataset.sizes[n], count)
            for n, count in zip([*lines, *panel_dims], counts, strict=False)
        }
    )
    fixed = [n for n in (*select, *rest) if n in part.coords]
    shown = part.drop_vars([n for n in (*fixed, *single) if n in part.coords])
    if shown.sizes["wavelength"] == 1:
        return draw_points(shown, quantity, legend=legend)
    if panel_dims:
        note = _describe_nodes(part, fixed)
        return draw_small_multiples(shown, quantity, panel_dims, legend, note=note)
    return draw_spectra(shown, quantity, legend=legend)


def _describe_nodes(part: xr.Dataset, names: Sequence[str]) -> str:
    """Return the note on the nodes at which a table is shown."""
    nodes = [f"{format_parameter(name)} {format_value(part[name].item(), name)}" for name in names]
    return f"at {' · '.join(nodes)}" if nodes else ""


def _draw_views(dataset: xr.Dataset, quantity: Sequence[str], legend: str | None) -> Figure:
    """Draw the principal plane of a table over directions, by angle of incidence."""
    axes = dataset[quantity[0]].dims
    measure = dataset.get("reflectance", dataset[quantity[0]])
    brightness = measure.mean([d for d in measure.dims if d != "wavelength"]).values
    levels = np.array([0.9, 0.5, 0.1]) * brightness.max()
    rows = {int(np.abs(brightness - level).argmin()) for level in levels}
    fixed = [str(d) for d in axes if d not in (INCIDENCE, *VIEW_AXES, "wavelength")]
    shown: dict[str, Any] = {n: (dataset.sizes[n] - 1) // 2 for n in fixed}
    shown["wavelength"] = sorted(rows)
    if INCIDENCE in axes:
        shown[INCIDENCE] = select_evenly(dataset.sizes[INCIDENCE], MAX_SUMMARY_LINES)
    names = [f"{name}{suffix}" for name in quantity for suffix in ("", "_stderr")]
    part = dataset[names].isel(shown)
    figure = draw_principal_planes(part.drop_vars(fixed), tuple(quantity), legend=legend)
    add_notes(figure, _describe_nodes(part, fixed))
    return figure


@declare_figure
def draw_swatches(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw a patch of colour for every point of a grid of one or two parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` over one grid parameter (columns), at most one more (rows), wavelength.
    select : mapping, optional
        Grid labels to select.

    Raises
    ------
    ValueError
        For a grid with more parameters.
    """
    dataset = select_points(dataset, select or {})
    dims = [str(d) for d in dataset.reflectance.dims if d != "wavelength"]
    if not 1 <= len(dims) <= 2:
        raise invalid("grid", dims, "one or two parameters for figure.kind = 'swatches'")
    columns = dataset.sizes[dims[0]]
    rows = dataset.sizes[dims[1]] if len(dims) == 2 else 1
    check_count("columns of colours", columns, 16, select)
    check_count("rows of colours", rows, MAX_ROWS, select)
    table = make_colour_table(dataset)
    # The grid's first parameter varies slowest in the table.
    patches = table[["red", "green", "blue"]].to_numpy().reshape(columns, rows, 3)
    light = table["L"].to_numpy().reshape(columns, rows)
    figure, axes = make_subplots(
        width=ONE_COLUMN_INCHES if columns <= 3 else TWO_COLUMNS_INCHES, height=0.5 + 0.4 * rows
    )
    # Patches of more columns are too narrow for their numbers.
    is_wide = columns <= 9
    axes.imshow(np.swapaxes(patches, 0, 1), aspect="auto", interpolation="nearest")
    for i, j in np.ndindex(light.shape if is_wide else (0, 0)):
        axes.text(
            i, j, f"{table['srgb'].iloc[i * rows + j]}\nL* {light[i, j]:.1f}",
            color="black" if light[i, j] > 50.0 else "white", fontsize=SMALL_FONT_PT,
            ha="center", va="center",
        )  # fmt: skip
    names = [format_value(v, dims[0]) for v in dataset[dims[0]].values]
    axes.set_xticks(range(columns), names, rotation=0 if is_wide else 90)
    if len(dims) == 2:
        axes.set_yticks(range(rows), [format_value(v, dims[1]) for v in dataset[dims[1]].values])
        axes.set_ylabel(format_parameter(dims[1]))
    else:
        axes.set_yticks([])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return annotate_figure(figure, [axes], describe_conditions(dataset, select, ""))
