"""Figures of spectra: lines, small multiples, refractive indices, measured albedo, seasons."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.measured import WAVELENGTH_COLUMN
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.media.snow_packs import count_missing_results
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Axes,
    Figure,
    annotate_figure,
    compute_axis_top,
    declare_figure,
    describe_conditions,
    draw_band,
    draw_curve,
    format_parameter,
    format_value,
    hide_empty_panels,
    make_axis_label,
    make_panel_title,
    make_subplots,
    pick_colours,
    select_evenly,
    start_at_zero,
)
from splits.plotting.lines import (
    PlotLines,
    draw_node_ticks,
    draw_shifts,
    find_coarse_nodes,
    find_default_dim,
    is_covering_line,
    make_nodes_note,
    place_legend_above,
)
from splits.plotting.settings import (
    MAX_LINES,
    Legend,
    Limits,
    Measured,
    Quantities,
    Selection,
    SpectralRange,
    choose_panel_parameters,
    choose_quantities,
)
from splits.retrieval.measurement import MAX_REFLECTANCE

MATERIAL_COLOURS = {
    "ice": "#1f6fb4",
    "water": "#c8553d",
    "quartz": "#666666",
    "hematite": "#7b3294",
    "goethite": "#c79100",
    "magnetite": "#111111",
    "kaolinite": "#7fb069",
}
"""Colours of the materials in figures of refractive indices; mixtures are not shown."""


def list_spectral_quantities(dataset: xr.Dataset) -> list[str]:
    """Return the quantities with errors over wavelength, reflectance first."""
    inner = {"side", "delay_s", "radius", "angle"}
    names = [
        str(name) for name, one in dataset.items()
        if f"{name}_stderr" in dataset and "wavelength" in one.dims and not inner & {*one.dims}
    ]  # fmt: skip
    return sorted(names, key=lambda name: name != "reflectance")


@declare_figure
def draw_spectra(
    dataset: xr.Dataset,
    quantity: Quantities | None = None,
    wavelength_nm: SpectralRange = None,
    select: Selection = None,
    measured: Measured = None,
    legend: Legend = None,
    ylim: Limits = None,
) -> Figure:
    """Draw spectra with bands of two standard errors, in several panels for many points.

    If a value of the only parameter is labelled ``default``, panels show the shifts of the others
    from it; `ylim` then applies to the panel of the default, and there is no legend.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment.
    quantity : sequence of str, optional
        Quantities, one panel each; by default the first one over wavelength.
    wavelength_nm : (low, high), optional
        Part of the spectrum to show.
    select : mapping, optional
        Grid labels to select.
    measured : pandas.DataFrame, optional
        Columns ``wavelength_nm``, ``reflectance`` and optionally its ``_min`` and ``_max``.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    ylim : (low, high), optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For too many lines, see `splits.plotting.settings.choose_panel_parameters`.
    """
    dataset = select_points(dataset, select or {})
    quantity = choose_quantities(dataset, quantity, list_spectral_quantities(dataset))
    if dataset.sizes["wavelength"] == 1:
        hint = "kind='points' shows single wavelengths over a grid"
        raise invalid("wavelength", dataset.wavelength.values.tolist(), "at least two", hint)
    if wavelength_nm:
        x = dataset.wavelength.values
        dataset = dataset.sel(wavelength=slice(*wavelength_nm))
        if not dataset.wavelength.size:
            allowed = f"with some of the wavelengths from {x[0]:g} to {x[-1]:g} nm"
            raise invalid("wavelength_nm", [*wavelength_nm], allowed)
    if measured is not None:
        check_measured(measured, quantity)
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    note = describe_conditions(dataset, select)
    if panel_dims := choose_panel_parameters(
        {d: dataset.sizes[d] for d in dims}, len(quantity), select
    ):
        if measured is not None:
            allowed = f"left out for a figure of more than {MAX_LINES} lines"
            raise invalid("measured", "given", allowed, "or fix more with select")
        return draw_small_multiples(dataset, quantity, panel_dims, legend, ylim, note)
    dim = None if measured is not None else find_default_dim(dataset, dims)
    if dim:
        labels = ("wavelength (nm)", quantity)
        return draw_shifts(dataset, quantity, dim, "wavelength", labels, note, ylim)
    lines = PlotLines(dataset, dims)
    nodes = find_coarse_nodes(dataset)
    figure, panels = make_subplots(
        len(quantity), 1, height=2.2 * len(quantity), squeeze=False, sharex=True
    )
    measured_handles: list[Any] = []
    x = dataset.wavelength.values
    for axes, name in zip(panels[:, 0], quantity, strict=True):
        for line in lines.lines:
            part = dataset.sel(line.labels)
            style = line.to_plot_style() | {"label": line.label or "model", "alpha": 0.25}
            draw_curve(axes, x, part[name].values, part[f"{name}_stderr"].values, 0.0, **style)
        if measured is not None and name in measured:
            y, limits = measured[name], None
            if f"{name}_min" in measured:
                limits = np.stack([y - measured[f"{name}_min"], measured[f"{name}_max"] - y])
            measured_handles = [
                axes.errorbar(
                    measured["wavelength_nm"], y, limits, fmt="s", color="black", ms=2.5,
                    label="measured",
                )
            ]  # fmt: skip
        axes.set_ylabel(make_axis_label(dataset[name]))
        start_at_zero(axes, name, ylim)
        axes.margins(x=0.01)
        draw_node_ticks(axes, nodes)
    panels[-1, 0].set_xlabel("wavelength (nm)")
    lines.add_legend(figure, list(panels[:, 0]), legend, extra_handles=measured_handles)
    return annotate_figure(figure, panels.flat, note, make_nodes_note(nodes))


def check_measured(measured: pd.DataFrame, quantity: Sequence[str]) -> None:
    """Reject measured values in per cent, and those without the quantities of the figure."""
    key = "measured"
    shown = [name for name in quantity if name in measured and measured[name].count()]
    if not shown:
        columns = f"{WAVELENGTH_COLUMN} and {' or '.join(quantity)}"
        raise invalid(key, list(measured), f"a table with columns {columns}")
    for name in shown:
        low, high = f"{name}_min", f"{name}_max"
        if (low in measured) != (high in measured):
            raise invalid(key, list(measured), f"with both {low} and {high}")
        rows = measured[[low, name, high] if low in measured else [name]].to_numpy()
        largest = float(np.nanmax(np.abs(rows), initial=0.0))
        if largest > MAX_REFLECTANCE:
            allowed, hint = f"at most {MAX_REFLECTANCE:g}", "fractions, not per cent"
            raise invalid(f"{key} ({name})", largest, allowed, hint)
        if (np.diff(rows, axis=1) < 0.0).any():
            raise invalid(key, name, f"with {low} <= {name} <= {high}")


@declare_figure
def draw_refractive_indices(dataset: xr.Dataset) -> Figure:
    """Draw n (left axis) and k (right axis, logarithmic) of the materials of `MATERIAL_COLOURS`.

    A material with the same index in several layers of a stack is shown once.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``n`` and ``k`` over wavelength and material.
    """
    figure, left = make_subplots(height=2.6)
    right = left.twinx()
    for axes in (left, right):
        axes.spines[:].set_visible(True)
    nodes = find_coarse_nodes(dataset)
    for material, label, colour in _list_materials(dataset):
        part = dataset.sel(material=material)
        left.plot(part.wavelength, part.n, color=colour, label=label)
        if float(part.k.max()) > 0.0:
            right.plot(part.wavelength, part.k, color=colour, ls="--")
            for rows in [rows for name, rows in nodes.items() if name.startswith(str(material))]:
                k = np.exp(np.interp(rows, part.wavelength, np.log(part.k)))
                right.plot(rows, k, ".", color=colour, ms=4)
    right.set_yscale("log")
    left.set(xlabel="wavelength (nm)", ylabel="refractive index n (solid)")
    right.set_ylabel("extinction coefficient k (dashed)")
    left.margins(x=0.01)
    place_legend_above(figure, left.get_lines(), None)
    names = ", ".join(nodes)
    note = f"Dots: rows of coarse tables, between which k is interpolated: {names}."
    return annotate_figure(figure, [left], note if nodes else "")


def _list_materials(dataset: xr.Dataset) -> list[tuple[str, str, str]]:
    """Return the name, label and colour of the materials to show."""
    names_by_material: dict[str, list[str]] = {}
    for name in map(str, dataset.material.values):
        names_by_material.setdefault(name.rpartition(".")[2], []).append(name)
    materials = []
    for material, colour in MATERIAL_COLOURS.items():
        names = names_by_material.get(material, [])
        parts = [dataset.sel(material=name, drop=True) for name in names]
        is_same = all(part.equals(parts[0]) for part in parts)
        for name in names[:1] if is_same else names:
            label = material if is_same else name.removeprefix("layers.").replace(".", ": ")
            materials.append((name, label if is_same else f"layer {label}", colour))
    return materials


def draw_small_multiples(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    panel_dims: Sequence[str],
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
    note: str = "",
) -> Figure:
    """Draw spectra with bands of two standard errors, a panel per value of some parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment over wavelength, one parameter whose values are lines, and
        `panel_dims`.
    quantity : sequence of str
        Quantities, each with a block of panels.
    panel_dims : sequence of str
        One or two parameters, see `splits.plotting.settings.choose_panel_parameters`.
    legend : str, optional
        Title of the legend or the colour bar; by default the first parameter.
    ylim : (low, high), optional
    note : str
        Note for the foot of the figure.
    """
    dims = [str(d) for d in dataset[quantity[0]].dims if d not in ("wavelength", *panel_dims)]
    lines = PlotLines(dataset, dims)
    # A parameter of up to 6 values fills a row.
    last = dataset.sizes[panel_dims[-1]]
    columns = last if len(panel_dims) == 2 and last <= 6 else 4
    panel_points = list(itertools.product(*(dataset[d].values for d in panel_dims)))
    columns = min(columns, len(panel_points))
    titles = [make_panel_title(dict(zip(panel_dims, p, strict=True))) for p in panel_points]
    panel_height = 1.25 + 0.11 * (max(title.count("\n") for title in titles) + 1)
    rows = -(-len(panel_points) // columns) * len(quantity)
    nodes = find_coarse_nodes(dataset)
    figure, panels = make_subplots(
        rows, columns, width=TWO_COLUMNS_INCHES, height=0.5 + panel_height * rows, sharex=True,
        squeeze=False,
    )  # fmt: skip
    blocks = np.split(panels, len(quantity))
    for panels_of_quantity, name in zip(blocks, quantity, strict=True):
        highest = float((dataset[name] + BAND_SIGMA * dataset[f"{name}_stderr"]).max())
        top = ylim or (0.0, compute_axis_top(highest, name))
        for axes, panel_point, title in zip(
            panels_of_quantity.flat, panel_points, titles, strict=False
        ):
            part = dataset.sel(dict(zip(panel_dims, panel_point, strict=True)))
            # Lines and bands are below 0, and one image per panel in SVG files.
            axes.set_rasterization_zorder(0.0)
            x, points = part.wavelength.values, part.transpose(*lines.dims, "wavelength")
            values, errors = (
                points[one].values.reshape(-1, x.size) for one in (name, f"{name}_stderr")
            )
            for line, y, error in zip(lines.lines, values, errors, strict=True):
                style = line.to_plot_style() | {"lw": 0.7, "zorder": line.zorder - 10.0}
                axes.plot(x, y, **style)
                draw_band(axes, x, y, error, 0.0, color=line.colour, alpha=0.25, zorder=-10.0)
            axes.margins(x=0.01)
            axes.tick_params(labelsize=SMALL_FONT_PT)
            draw_node_ticks(axes, nodes)
            axes.set(title=title, ylim=top)
            axes.label_outer()
        for axes in panels_of_quantity[:, 0]:
            axes.set_ylabel(name)
    hide_empty_panels(panels, "wavelength (nm)")
    lines.add_legend(figure, list(panels.flat), legend, max_inset_entries=0)
    return annotate_figure(figure, panels.flat, note, make_nodes_note(nodes))


# --------------------------------------------------------------------------------------------------
# Spectra and albedos of snowpacks over time.


@declare_figure
def draw_season(dataset: xr.Dataset, quantity: Quantities | None = None) -> Figure:
    """Draw band albedos, or spectra at some wavelengths, over time or another label of snowpacks.

    Lines join snowpacks that have an order: times, in any calendar, and numbers.  Snowpacks with
    other labels are points.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.albedo` or `splits.spectrophotometer` for `splits.SnowPacks`.
    quantity : sequence of str
        Quantities of spectra, a panel each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = (
        ("band_albedo",) if "band_albedo" in dataset
        else choose_quantities(dataset, quantity, list_spectral_quantities(dataset))
    )  # fmt: skip
    (label,) = dataset.quality_flag.dims
    figure, panels = make_subplots(
        len(names), 1, width=TWO_COLUMNS_INCHES, height=2.4 * len(names), squeeze=False,
        sharex=True,
    )  # fmt: skip
    x, has_order = _set_label_axis(panels[-1, 0], dataset.get_index(label))
    for axes, name in zip(panels[:, 0], names, strict=True):
        line_dim = str(dataset[name].dims[-1])
        # All bands, or up to 4 wavelengths with the first and the last.
        n_lines = dataset.sizes[line_dim]
        rows = select_evenly(n_lines, n_lines if line_dim == "band" else 4)
        for row, colour in zip(rows, pick_colours(len(rows), line_dim), strict=True):
            part = dataset.isel({line_dim: row})
            y, error = part[name].values, part[f"{name}_stderr"].values
            text = format_value(part[line_dim].values.item(), line_dim)
            if has_order:
                draw_curve(axes, x, y, error, alpha=0.25, color=colour, label=text)
            else:
                axes.errorbar(x, y, BAND_SIGMA * error, fmt="o", ms=2.5, color=colour, label=text)
        axes.set_ylabel("albedo" if name == "band_albedo" else make_axis_label(dataset[name]))
        # Snowpacks without a result are on the axis, too.
        axes.update_datalim([(one, 0.0) for one in np.atleast_1d(axes.convert_xunits(x))])
        axes.autoscale_view()
        start_at_zero(axes, name)
        axes.margins(x=0.01)
        title = "wavelength (nm)" if line_dim == "wavelength" else None
    panels[-1, 0].set_xlabel(format_parameter(str(label)))
    legend = panels[0, 0].legend(title=title, frameon=False)
    if is_covering_line(legend, panels[0, 0]):
        legend.remove()
        place_legend_above(figure, panels[0, 0].get_legend_handles_labels()[0], title)
    band = "bands" if has_order else "bars"
    counts = count_missing_results(dataset)
    gaps = f"Gaps: snowpacks without a result ({counts})." if counts else ""
    return annotate_figure(figure, panels.flat, describe_conditions(dataset, band=band), gaps)


def _set_label_axis(axes: Axes, index: pd.Index) -> tuple[np.ndarray, bool]:
    """Set the ticks of the labels of snowpacks; return positions, and whether they have an order.

    Dates of calendars that NumPy lacks, such as those without leap days, are at their days.
    """
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
    from matplotlib.ticker import MaxNLocator

    is_simple = not isinstance(index, pd.MultiIndex)
    if is_simple and index.dtype.kind in "fiu":
        return index.to_numpy(), True
    if is_simple and index.dtype.kind == "M":
        locator = AutoDateLocator()
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        return index.to_numpy(), True
    if isinstance(index, xr.CFTimeIndex):
        import cftime  # xarray has this index only where cftime is installed

        calendar, days = index.calendar, "days since 1970-01-01"
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        axes.xaxis.set_major_formatter(
            lambda day, _: cftime.num2date(day, days, calendar).strftime("%Y-%m-%d")
        )
        return np.asarray(cftime.date2num(index.to_numpy(), days, calendar), dtype=float), True
    # Of many labels, evenly spaced ones are shown.
    shown = select_evenly(index.size, 24)
    texts = [
        " · ".join(map(format_value, item if isinstance(item, tuple) else (item,)))
        for item in index[shown]
    ]
    axes.set_xticks(shown, texts, rotation=90, fontsize=SMALL_FONT_PT)
    return np.arange(index.size), False
