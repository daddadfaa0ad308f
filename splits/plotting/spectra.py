"""Spectra: a quantity over wavelength, one line per point of the grid.

Measured against modelled spectra.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.core.escaping import escape_mathtext
from splits.io.netcdf import select_points
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.facets import draw_facets
from splits.plotting.interpretation_shifts import draw_shifts, find_default_dim
from splits.plotting.lines import PlotLines, place_legend_above
from splits.plotting.nodes import draw_node_ticks, find_coarse_nodes, make_nodes_note
from splits.plotting.panels import choose_panel_parameters
from splits.plotting.style import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)

MATERIAL_COLOURS = {
    "ice": "#1f6fb4",
    "water": "#c8553d",
    "quartz": "#666666",
    "hematite": "#7b3294",
    "goethite": "#c79100",
    "magnetite": "#111111",
    "kaolinite": "#7fb069",
}
"""Materials that figures of refractive indices show; mixtures follow from them."""
_MAX_LABEL_CHARS = 30
"""Letters that fit along an axis."""


def draw_spectra(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("reflectance",),
    wavelength_nm: tuple[float, float] | None = None,
    at: Mapping[str, float | str] | None = None,
    measured: pd.DataFrame | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw spectra with bands of two standard errors, of many points in several panels.

    Where one value of the grid's only parameter is labelled ``default``, panels show how far the
    others lie from it; then `ylim` is that of the default's panel, and there is no legend.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment.
    quantity : sequence of str
        One panel each.
    wavelength_nm : (low, high), optional
        Part of the spectrum to show.
    at : mapping, optional
        Grid labels to hold fixed.
    measured : pandas.DataFrame, optional
        Columns ``wavelength_nm``, ``reflectance`` and optionally its ``_min`` and ``_max``.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For more lines than can be shown, see `splits.plotting.panels.choose_panel_parameters`.
    """
    dataset = select_points(dataset, at or {})
    if wavelength_nm:
        dataset = dataset.sel(wavelength=slice(*wavelength_nm))
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    note = describe_conditions(dataset, at)
    if apart := choose_panel_parameters({d: dataset.sizes[d] for d in dims}, len(quantity), at):
        return draw_facets(dataset, quantity, apart, legend, ylim, note)
    dim = None if measured is not None else find_default_dim(dataset, dims)
    if dim:
        labels = ("wavelength (nm)", quantity)
        return draw_shifts(dataset, quantity, dim, "wavelength", labels, note, ylim)
    lines = PlotLines(dataset, dims)
    nodes = find_coarse_nodes(dataset)
    with use_style():
        figure, panels = make_subplots(
            len(quantity), 1, height=2.2 * len(quantity), squeeze=False, sharex=True
        )
        shown = []
        for axes, name in zip(panels[:, 0], quantity, strict=True):
            _draw_lines(axes, dataset, name, lines)
            if measured is not None and name in measured:
                shown = [_draw_measured(axes, measured, name)]
            axes.set_ylabel(_make_axis_label(dataset[name]))
            axes.set_ylim(ylim or (0.0, None))
            axes.margins(x=0.01)
            draw_node_ticks(axes, nodes)
            axes.spines[["top", "right"]].set_visible(False)
        panels[-1, 0].set_xlabel("wavelength (nm)")
        lines.add_legend(figure, list(panels[:, 0]), legend, extra_handles=shown)
        return annotate_figure(figure, panels.flat, note, make_nodes_note(nodes))


def _draw_lines(axes: Axes, dataset: xr.Dataset, name: str, lines: PlotLines) -> None:
    for line in lines.lines:
        part = dataset.sel(line.labels)
        x, y = part.wavelength.values, part[name].values
        error = BAND_SIGMA * part[f"{name}_stderr"].values
        axes.plot(x, y, label=line.label or "model", **line.to_plot_style())
        axes.fill_between(
            x, np.maximum(y - error, 0.0), y + error, color=line.colour, alpha=0.25, lw=0
        )


def _draw_measured(axes: Axes, table: pd.DataFrame, name: str) -> Artist:
    y = table[name]
    span = None
    if f"{name}_min" in table:
        span = np.stack([y - table[f"{name}_min"], table[f"{name}_max"] - y])
    return axes.errorbar(  # type: ignore[return-value]
        table["wavelength_nm"], y, span, fmt="s", color="black", ms=2.5, label="measured"
    )


def _make_axis_label(variable: xr.DataArray) -> str:
    """Return what an axis shows, on two lines if it is long."""
    words = escape_mathtext(str(variable.attrs.get("long_name", variable.name)))
    first, _, last = words.rpartition(" ")
    return f"{first}\n{last}" if first and len(words) > _MAX_LABEL_CHARS else words


def draw_refractive_indices(dataset: xr.Dataset) -> Figure:
    """Draw n (left axis) and k (right axis, logarithmic) of the materials of `MATERIAL_COLOURS`.

    Of a stack, a material that has the same index in several layers is shown once.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``n`` and ``k`` over wavelength and material.
    """
    with use_style():
        figure, left = make_subplots(height=2.6)
        right = left.twinx()
        nodes = find_coarse_nodes(dataset)
        for material, label, colour in _list_materials(dataset):
            part = dataset.sel(material=material)
            left.plot(part.wavelength, part.n, color=colour, label=label)
            if float(part.k.max()) > 0.0:
                right.plot(part.wavelength, part.k, color=colour, ls="--")
                _draw_table_rows(right, part, nodes, colour)
        right.set_yscale("log")
        left.set_xlabel("wavelength (nm)")
        left.set_ylabel("refractive index n (solid)")
        right.set_ylabel("extinction coefficient k (dashed)")
        left.margins(x=0.01)
        place_legend_above(figure, left.get_lines(), None)
        names = ", ".join(nodes)
        told = f"Dots: rows of coarse tables, between which k is interpolated: {names}."
        return annotate_figure(figure, [left], told if nodes else "")


def _list_materials(dataset: xr.Dataset) -> list[tuple[str, str, str]]:
    """Return name, label and colour of the materials to show; those of layers begin with these."""
    found: dict[str, list[str]] = {}
    for name in map(str, dataset.material.values):
        found.setdefault(name.rpartition(".")[2], []).append(name)
    shown = []
    for material, colour in MATERIAL_COLOURS.items():
        names = found.get(material, [])
        parts = [dataset.sel(material=name, drop=True) for name in names]
        same = all(part.equals(parts[0]) for part in parts)
        for name in names[:1] if same else names:
            label = material if same else name.removeprefix("layers.").replace(".", ": ")
            shown.append((name, label if same else f"layer {label}", colour))
    return shown


def _draw_table_rows(
    axes: Axes, part: xr.Dataset, nodes: dict[str, np.ndarray], colour: str
) -> None:
    """Draw a dot where a coarse table has a row."""
    for name, rows in nodes.items():
        if name.startswith(str(part.material.values)):
            k = np.exp(np.interp(rows, part.wavelength, np.log(part.k)))
            axes.plot(rows, k, ".", color=colour, ms=4)


def draw_measured_albedo(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw measured and modelled albedo, one panel per depth, and their difference below.

    Parameters
    ----------
    table : pandas.DataFrame
        See `splits.analysis.measured.letcher_bands`.
    note : str
        For the foot, see `splits.plotting.annotations.describe_conditions`.
    """
    depths = sorted(table.depth_m.unique(), reverse=True)
    with use_style():
        figure, panels = make_subplots(
            2, len(depths), width=TWO_COLUMNS_INCHES, height=3.9, sharex=True, sharey="row",
            gridspec_kw={"height_ratios": [2, 1]},
        )  # fmt: skip
        for column, depth in enumerate(depths):
            top, bottom = panels[:, column]
            part = table[table.depth_m == depth]
            groups = list(part.groupby("snow", sort=False))
            for (snow, rows), colour in zip(
                groups, pick_colours(len(groups), "medium"), strict=True
            ):
                x, error = rows.wavelength_nm, BAND_SIGMA * rows.stderr
                top.errorbar(x, rows.model, error, color=colour, label=format_value(snow))
                bottom.errorbar(x, rows.difference, error, color=colour)
            first = groups[0][1]
            top.plot(first.wavelength_nm, first.measured, "ks", ms=2.5, label="measured")
            bottom.axhline(0, color="black", lw=0.6)
            top.set_title(f"{1e3 * depth:g} mm" + (" over black" if depth < 0.1 else ""))
            top.set_ylim(0, 1.05)
            bottom.set_xlabel("wavelength (nm)")
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("albedo")
        panels[1, 0].set_ylabel("model − measured")
        panels[0, 1].legend(frameon=False)
        return annotate_figure(figure, panels.flat, note)
